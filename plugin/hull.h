// Signed distance to the convex hull of a mesh, which is what MuJoCo collides a mesh as.
//
// Inside: the largest distance to a face plane. Outside: the distance to the nearest triangle; only faces that see the
// point can have it, and a face whose plane is farther than the best so far cannot. Hulls of many faces are searched by
// a tree of them: bounds of a branch's triangles and of its planes tell what it cannot have.

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
  // The hull of mesh `mesh`, of which the model has to keep one.
  Hull(const mjModel* m, int mesh);

  // Of these triangles, whose planes have all vertices on one side.
  Hull(std::vector<Vec3> vertices, const std::vector<std::array<int, 3>>& faces);

  // Distance [m] from p, in the mesh's axes, negative inside; `normal` out of the hull there. Above `reach` only that
  // is sure of the distance, that it is above.
  double Distance(const Vec3& p, double reach, Vec3* normal) const;

  // The same by looking at every face.
  double DistanceByAll(const Vec3& p, double reach, Vec3* normal) const;

  // Its vertices; where they are many, those that are farthest along some of as many directions all around: sharp ones
  // are, and on what is round they are as close as it takes.
  std::vector<Vec3> Corners() const;

 private:
  // Faces begin … end of `order_`, halved between the branch after this one and `second` if there are too many for a
  // leaf.
  struct Branch {
    int begin, end, second;
    Vec3 low, high;      // of the triangles
    Vec3 n_low, n_high;  // of the planes' normals
    double offset_low;   // and offsets
  };

  void AddBranch(int begin, int end);
  double Plane(int f, const Vec3& p) const { return nx_[f] * p[0] + ny_[f] * p[1] + nz_[f] * p[2] - offset_[f]; }
  // No plane of the branch's faces is farther below p.
  static double HighestPlane(const Branch& branch, const Vec3& p);
  // Looks whether a face that sees p is nearer than *best.
  void Nearer(int f, const Vec3& p, double* best, int* found, Vec3* normal) const;

  std::vector<Vec3> vertices_;
  std::vector<std::array<int, 3>> faces_;
  std::vector<double> nx_, ny_, nz_, offset_;  // planes of the faces: n · p = offset, n outwards
  std::vector<int> order_;                     // faces that are near each other side by side
  std::vector<Branch> branches_;               // the whole hull first; none if it has few faces
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_HULL_H_
