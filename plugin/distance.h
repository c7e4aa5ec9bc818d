// Signed distance from a point to MuJoCo's geoms, with the outward normal there.

#ifndef MJFRAMES_PLUGIN_DISTANCE_H_
#define MJFRAMES_PLUGIN_DISTANCE_H_

#include <mujoco/mujoco.h>

#include "linear.h"

namespace mjframes {

// A geom placed in the world, ready for many queries. Types without a closed form go through MuJoCo's own
// signed distance (meshes need an octree, SDF plugins bring theirs); `valid` is false where it has none.
struct GeomQuery {
  GeomQuery(const mjModel* m, const mjData* d, int geom);

  // Distance [m] from world point p to the surface, negative inside.
  double Distance(const Vec3& p) const;

  // Unit vector out of the geom at p, in the world: the gradient of the distance.
  Vec3 Normal(const Vec3& p) const;

  bool valid;

 private:
  double Evaluate(const Vec3& p, Vec3* normal) const;

  const mjModel* model;
  const mjData* data;
  int type;
  Vec3 size;
  Vec3 position;
  Mat3 orientation;  // world from geom
  int sdf_id;        // plugin instance or mesh of an SDF geom
  const mjpPlugin* plugin;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_DISTANCE_H_
