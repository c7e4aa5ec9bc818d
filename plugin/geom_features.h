// Points of rigid geoms that are sharp or small: they may fall between the vertices of a patch.
//
// Corners and edges of boxes, rims of cylinders, hull vertices of meshes, and balls: a sphere is one, a capsule a row.
// An ellipsoid's is its support point against the soft surface. Points that are close share one contact.

#ifndef MJFRAMES_PLUGIN_GEOM_FEATURES_H_
#define MJFRAMES_PLUGIN_GEOM_FEATURES_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "distance.h"
#include "linear.h"
#include "patch_volume.h"

namespace mjframes {

inline constexpr int kMaxFeatureClusters = 8;

struct Feature {
  Vec3 position;  // in the geom's axes [m]
  int cluster;    // < kMaxFeatureClusters
};

// Features begin … end of a geom, and a box around them in the geom's axes.
struct FeatureCluster {
  size_t begin, end;
  AlignedBox box;
};

// The features of one geom.
struct Features {
  double radius = 0;                     // of the balls around the points [m]
  bool round = false;                    // an ellipsoid: the one point follows the soft surface's normal
  std::vector<Feature> points;           // cluster after cluster
  std::vector<FeatureCluster> clusters;  // those that are not empty
};

// Of every geom of the model; none for planes, height fields and SDF plugins.
std::vector<Features> GeomFeatures(const mjModel* m, const Hulls& hulls);

// The point of an ellipsoid of half axes `size`, in its own axes, that is farthest along `direction` [m].
Vec3 EllipsoidSupport(const mjtNum* size, const Vec3& direction);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_GEOM_FEATURES_H_
