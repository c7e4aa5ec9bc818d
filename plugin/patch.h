// What a patch answers for, and a box around it wherever it is.
//
// The weights of any material point p̄ of the patch are close to affine in p̄: W_j(p̄) = a_j + g_j · (p̄ − p̄₀) + e_j with
// small e_j. Since Σ_j e_j = 0 and Σ_j e_j x̄_j = 0, with c = Σ_j a_j x_j and B = Σ_j x_j g_jᵀ
//
//   x(p̄) = c + B (p̄ − p̄₀) + Σ_j e_j d_j,   d_j = x_j − c − B (x̄_j − p̄₀)
//
// and d_j = 0 where the patch moves affinely: so bounds of p̄ − p̄₀ and of e_j, taken once, bound x closely.

#ifndef MJFRAMES_PLUGIN_PATCH_H_
#define MJFRAMES_PLUGIN_PATCH_H_

#include <mujoco/mujoco.h>

#include <cmath>
#include <cstdint>
#include <vector>

#include "constants.h"
#include "dents.h"
#include "distance_field.h"
#include "linear.h"

namespace mjframes {

class Kinematics;
struct ContactModel;

// Along the world's axes.
struct AlignedBox {
  Vec3 centre, half;

  bool Contains(const Vec3& p, double margin) const {
    for (int i = 0; i < 3; i++) {
      if (!(std::abs(p[i] - centre[i]) <= half[i] + margin)) return false;
    }
    return true;
  }

  bool Apart(const AlignedBox& other, double margin) const {
    for (int i = 0; i < 3; i++) {
      if (std::abs(other.centre[i] - centre[i]) > half[i] + other.half[i] + margin) return true;
    }
    return false;
  }
};

// Where a patch is now.
struct PatchPose {
  AlignedBox box;  // around the centres of the vertices and the material
  // ξ ≈ guess + slope (x − centre of the box), off by `error` at most for points of the patch [cubes].
  Vec3 guess;
  Mat3 slope;
  double error;
  double stretch;  // lengths of the patch have grown by no more, but for what moves it otherwise than affinely
};

// A patch's vertices and the material below them. Its contact rows have the control points on the path from the root to
// its geom's body and those that do not move; weights of others, rare and small, are left out and the rest scaled to
// sum 1.
struct PatchVolume {
  static PatchVolume Create(const mjModel* m, const ContactModel& contact, const Kinematics& kinematics, int patch);

  // x: where the control points are in the world, by control point [m].
  PatchPose Pose(const DistanceField& field, const Vec3* x) const;

  // How far apart its vertices are, which are neighbours, and whether it has material between them. rest: RestVertices.
  void SetCover(const ContactModel& contact, const std::vector<Vec3>& rest, int patch);

  // Σ_j x_j g_jᵀ, of positions or velocities of the control points.
  Mat3 SlopeOf(const Vec3* x) const;

  // Whether rows have all control points that move a cube.
  bool IsWhole(const int* nodes) const {
    for (int corner = 0; corner < 8; corner++) {
      if (!whole[nodes[corner]]) return false;
    }
    return true;
  }

  // Whether material of this patch may be within `error` of ξ [cubes]; error ≤ kTrusted.
  bool Near(const DistanceField& field, const Vec3& xi, double error) const;

  std::vector<uint8_t> in_rows;  // whether rows have the control point          (k)
  int first_vertex = 0;          // of the patch in DistanceField::vertex
  std::vector<int32_t> point;    // control points that move any of it             (p)
  std::vector<double> mean;      // a_j                                            (p)
  std::vector<Vec3> slope;       // g_j [1/m]                                      (p)
  std::vector<Vec3> offset;      // x̄_j − p̄₀ [m]                                   (p)
  std::vector<double> residual;  // largest |e_j|                                  (p)
  Vec3 origin{};                 // p̄₀ [m]
  std::vector<uint8_t> steps;    // of each node: to the nearest of the patch, in cubes along the axes
  std::vector<uint8_t> whole;    // of each node: whether rows have all control points that move it
  Vec3 half{};                   // largest |p̄ − p̄₀| along each axis [m]
  std::vector<int32_t> walk;     // the patch's vertices, cluster by cluster, each beside the one before
  bool solid = false;            // whether nodes of the field are inside
  // Of each cluster, the mean of its vertices' unit normals, along the lattice's axes; 0 where it is not flat. Empty
  // without a lattice.
  std::vector<Vec3> facing;
  std::vector<uint8_t> round;  // of each cluster, whether it is smooth and convex and not flat; empty without a lattice
  // At rest [m]: no place of its surface is farther from the nearest of its vertices (0 without a lattice), and if it
  // is not solid, none of these from the nearest other one of the body; that is the reach at least.
  double cover = 0, spread = 0;
  // From each vertex to the nearest other one of the patch, at rest; root mean square [m].
  double spacing = 0;
};

// The contact vertices that hang on one body, in clusters; never written after creation, so threads may read it.
struct Patch {
  int geom = -1;
  int vertices = 0;              // number of vertices n, cluster after cluster
  std::vector<int32_t> cluster;  // number of vertices of each cluster          (≤ kMaxClusters)
  std::vector<Dent> dent;        // below each vertex; none where contacts make none          (n)
  std::vector<int32_t> factor;   // of the materials' that its softness follows               (n)
  std::vector<int32_t> point;    // control points, ancestors first             (p)
  std::vector<double> weight;    // W_j(s), one row of n a point                (p × n)
  std::vector<double> offset;    // s − Σ_j W_j(s) x̄_j [m], by component; empty where the frames give none (3 × n)
  PatchVolume volume;            // the material below

  // The cluster that a vertex is in.
  size_t ClusterOf(int vertex) const {
    size_t c = 0;
    for (int end = cluster[0]; c + 1 < cluster.size() && vertex >= end; end += cluster[c]) c++;
    return c;
  }
};

// What of a soft body touches; never changes.
struct ContactModel {
  double reach = 0;  // what is higher than its cluster's deepest by this or more has no share in the contact [m]
  double round_spacing = 0;  // of the vertices of round clusters: the same for all patches [m]
  std::vector<Patch> patches;
  // Whether the deformed volume is known: not with point frames, whose patches touch rigid geoms with their vertices
  // only.
  bool has_volume = false;
  DistanceField field;

  bool makes_dents() const { return !patches.empty() && !patches[0].dent.empty(); }

  // What small is to the body [m]: a cube of the lattice, if it has one.
  double resolution() const { return has_volume ? field.spacing : reach; }
};

// From each vertex of a round cluster to the nearest other one of the body, root mean square [m]; 0 without any.
double RoundSpacing(const ContactModel& contact, const std::vector<Vec3>& rest);

// Where the vertices of all patches are at rest, one patch after the other [m].
std::vector<Vec3> RestVertices(const ContactModel& contact, const Kinematics& kinematics);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PATCH_H_
