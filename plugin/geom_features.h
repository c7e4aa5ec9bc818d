// Points of rigid geoms that are sharp or small: they may fall between the vertices of a patch.
//
// Corners and edges of boxes, rims of cylinders, hull vertices of meshes, and the balls in a row of a capsule. Points
// that are close have one contact.

#ifndef MJFRAMES_PLUGIN_GEOM_FEATURES_H_
#define MJFRAMES_PLUGIN_GEOM_FEATURES_H_

#include <mujoco/mujoco.h>

#include <memory>
#include <vector>

#include "constants.h"
#include "hull.h"
#include "linear.h"
#include "patch.h"

namespace mjframes {

// Features begin … end of a geom.
struct FeatureCluster {
  size_t begin, end;
};

// Points in a geom's axes [m], cluster after cluster; no more clusters than with points.
struct FeatureClusters {
  int count = 0;
  FeatureCluster cluster[kMaxFeatureClusters];
};

// Those of a mesh, by the octants of its axes.
struct MeshFeatures {
  explicit MeshFeatures(const Hull& hull);

  std::vector<Vec3> points;
  FeatureClusters clusters;
};

// What a mesh that geoms use collides as.
struct CollisionMesh {
  CollisionMesh(const mjModel* m, int mesh) : hull(m, mesh), features(hull) {}

  Hull hull;
  MeshFeatures features;
};

// By mesh; null where the model keeps no hull, because nothing collides with it.
using CollisionMeshes = std::vector<std::shared_ptr<const CollisionMesh>>;

// Those of the model, shared with whoever has the same.
CollisionMeshes FindCollisionMeshes(const mjModel* m);

// The features of one geom, by its size now; none for planes, height fields, SDF plugins, and round geoms
// (round_touch.h).
class Features {
 public:
  Features(const mjModel* m, const CollisionMeshes& meshes, int geom);
  Features(const Features&) = delete;

  // Of the balls around the points [m].
  static double Radius(const mjModel* m, int geom);

  const Vec3* points = nullptr;
  FeatureClusters clusters;

 private:
  static constexpr int kMost = 44;  // of geoms other than meshes: a box's

  void Add(const Vec3& p, int cluster);
  void SetBox(const mjtNum* half);
  void AddCylinder(double radius, double half);
  void AddCapsule(double radius, double half);

  int count_ = 0;
  int cluster_[kMost];
  Vec3 added_[kMost], sorted_[kMost];
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_GEOM_FEATURES_H_
