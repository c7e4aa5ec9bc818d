// Law `corotational`: a region as a corotated superelement (design: y_j = Rᵀ x_j − x̄_j, energy ½ yᵀ K_e y).
//
//   f = −R Pᵀ K_e y,   K = R Pᵀ K_e P Rᵀ,   P = I − Z (A Z)⁻¹ A
//
// For λ = 0 (see region_response.cc) f is the exact gradient of the energy, ∂R/∂x included, so it carries no net force
// and no net torque; K is its Gauss–Newton stiffness: positive semi-definite, blind to rotations of the current shape.

#ifndef MJFRAMES_PLUGIN_COROTATIONAL_H_
#define MJFRAMES_PLUGIN_COROTATIONAL_H_

#include <cstdint>
#include <vector>

#include "linear.h"

namespace mjframes {

// One region: the control points that move it and how stiffly (m points).
struct Region {
  std::vector<int32_t> point;     // control points, ancestors first        (m)
  std::vector<Vec3> rest;         // x̄_j minus their mean [m]               (m)
  std::vector<Vec3> gradient;     // ḡ_j: mean gradient of W_j [1/m]        (m)
  std::vector<double> stiffness;  // K_e [N/m]                              (3m × 3m)
  std::vector<int32_t> pair;      // pair of points of each block (j, k ≤ j) (m(m+1)/2)
  double inverse_extent;          // 1 / Σ_j |x̄_j|² [1/m²]
  double enlargement;             // of its stiffness where d->M cannot hold all of it, else 1 [-]
  int number;                     // in the configuration

  int size() const { return static_cast<int>(point.size()); }
};

// Rotation of the region's mean deformation gradient. x: all control points of the body [m].
Mat3 RegionRotation(const Region& region, const Vec3* x, const Mat3& guess);

// ½ yᵀ K_e y [J]
double RegionEnergy(const Region& region, const Vec3* x, const Mat3& R);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_COROTATIONAL_H_
