// Law `corotational`: a region as a corotated superelement (design: y_j = Rᵀ x_j − x̄_j, energy ½ yᵀ K_e y).
//
//   f = −R Pᵀ K_e y,   K = R Pᵀ K_e P Rᵀ,   P = I − Z (A Z)⁻¹ A
//
// For λ = 0 (see .cc) f is the exact gradient of the energy, ∂R/∂x included, so it carries no net force and no
// net torque; K is its Gauss–Newton stiffness: positive semi-definite, blind to rotations of the current shape.

#ifndef MJFRAMES_PLUGIN_COROTATIONAL_H_
#define MJFRAMES_PLUGIN_COROTATIONAL_H_

#include <cstdint>
#include <vector>

#include "lanes.h"
#include "linear.h"

namespace mjframes {

// One region: the control points that move it and how stiffly (m points).
struct Region {
  std::vector<int32_t> point;     // control points, ancestors first        (m)
  std::vector<Vec3> rest;         // x̄_j minus their mean [m]               (m)
  std::vector<Vec3> gradient;     // ḡ_j: mean gradient of W_j [1/m]        (m)
  std::vector<double> stiffness;  // K_e [N/m], rows padded to whole lanes  (3m × 3m)
  std::vector<double> blocks;     // K_e again, see BlockOffset             (packed)
  std::vector<int32_t> pair;      // pair of points of each block (j, k ≤ j)                        (m(m+1)/2)
  double inverse_extent;          // 1 / Σ_j |x̄_j|² [1/m²]
  double enlargement;             // of its stiffness where d->M cannot hold all of it, else 1 [-]
  int number;                     // in the configuration, which is not their order here
  bool starts, ends;  // a run of regions with the same points: their blocks are summed before they are added

  int size() const { return static_cast<int>(point.size()); }
};

// Blocks of one row j stand together, component by component, so that loops over k are contiguous:
// entry (a, b) of block (j, k) is at BlockOffset(j) + (3a + b) stride(j) + k.
constexpr int BlockStride(int j) { return PadToLanes(j + 1); }
int BlockOffset(int j);

// Scratch memory for the largest region of a body; allocated once.
struct RegionScratch {
  explicit RegionScratch(int max_points);
  std::vector<double> rhs, product;  // [y | Z] and K_e [y | Z], 4 columns     (3m padded × 4)
  std::vector<Vec3> z, h;            // z_j = Rᵀ x_j centred; h_j (A_j = [h_j]×) (m)
  std::vector<double> n, v;          // N and V by component                    (9 × m padded)
  std::vector<double> blocks;        // Σ R Pᵀ K_e P Rᵀ of a run of regions, laid out as Region::blocks
};

// Rotation of the region's mean deformation gradient. x: all control points of the body [m].
Mat3 RegionRotation(const Region& region, const Vec3* x, const Mat3& guess);

// ½ yᵀ K_e y [J]
double RegionEnergy(const Region& region, const Vec3* x, const Mat3& R, RegionScratch* scratch);

// Adds the region's elastic force to `force` and, where they are given, its stiffness to `stiffness` and enlarged to
// `held`, one row-major 3×3 block a pair of control points; of a run of regions once it ends.
void AddRegion(const Region& region, const Vec3* x, const Mat3& R, RegionScratch* scratch, Vec3* force,
               double* stiffness, double* held);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_COROTATIONAL_H_
