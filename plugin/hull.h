// Signed distance to the convex hull of a mesh, which is what MuJoCo collides a mesh as.
//
// Inside: the largest distance to a face plane. Outside: the distance to the nearest triangle; only faces that see the
// point can hold it, and a face whose plane is farther than the best so far cannot.

#ifndef MJFRAMES_PLUGIN_HULL_H_
#define MJFRAMES_PLUGIN_HULL_H_

#include <mujoco/mujoco.h>

#include <array>
#include <memory>
#include <vector>

#include "linear.h"

namespace mjframes {

class Hull {
 public:
  // The hull of mesh `mesh`; null where the model keeps none.
  static std::unique_ptr<const Hull> Create(const mjModel* m, int mesh);

  // Distance [m] from p, in the mesh's axes, negative inside; `normal` out of the hull there. Above `reach` only that
  // is sure of the distance, that it is above.
  double Distance(const Vec3& p, double reach, Vec3* normal) const;

  const std::vector<Vec3>& vertices() const { return vertices_; }

 private:
  std::vector<Vec3> vertices_;
  std::vector<std::array<int, 3>> faces_;
  std::vector<double> nx_, ny_, nz_, offset_;  // planes of the faces: n · p = offset, n outwards
};

// The hulls of the meshes that geoms use, by mesh; null where the model keeps none, because nothing collides with it.
std::vector<std::unique_ptr<const Hull>> CollisionHulls(const mjModel* m);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_HULL_H_
