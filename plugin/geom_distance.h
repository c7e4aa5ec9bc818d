// Signed distance from a point to MuJoCo's geoms, with the outward normal there.

#ifndef MJFRAMES_PLUGIN_GEOM_DISTANCE_H_
#define MJFRAMES_PLUGIN_GEOM_DISTANCE_H_

#include <mujoco/mujoco.h>

#include <memory>
#include <vector>

#include "geom_features.h"
#include "linear.h"
#include "patch.h"

namespace mjframes {

// A geom placed in the world, ready for many queries. Types without a closed form go through MuJoCo's own
// signed distance: SDF plugins bring theirs, meshes an octree. A mesh without one is its convex hull.
struct GeomQuery {
  // reach: distances above it may be any above it.
  GeomQuery(const mjModel* m, const mjData* d, const CollisionMeshes& meshes, int geom, double reach);

  // Distance [m] from the world's points begin … end of n to the surface, negative inside: out[s] for s among them.
  // points: by component, as Skinned has them.
  void Distances(const double* points, int n, int begin, int end, double* out) const;

  // That of p in the world, and the unit vector out of the geom there, the gradient of the distance; it may be null.
  double Distance(const Vec3& p, Vec3* normal) const;

  // That vector.
  Vec3 Normal(const Vec3& p) const {
    Vec3 normal;
    Distance(p, &normal);
    return normal;
  }

  // At most the distance of any point in the box: that of a sphere and of a box around the geom.
  double LowerBound(const AlignedBox& box) const;

  // Whether it has a size, unlike a plane and, as patches see it, a height field.
  bool bounded() const { return bound > 0; }

  bool valid;  // false where MuJoCo has no such distance

 private:
  void SetExtent();

  const mjModel* model;
  const mjData* data;
  int type;
  Vec3 size;
  Vec3 position;
  Mat3 orientation;  // world from geom
  int sdf_id;        // plugin instance or mesh of an SDF geom
  const mjpPlugin* plugin;
  const Hull* hull;
  double reach;
  double bound;         // radius of a sphere around it [m]; 0 for planes and height fields
  Vec3 middle, extent;  // of a box around it, in its axes [m]
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_GEOM_DISTANCE_H_
