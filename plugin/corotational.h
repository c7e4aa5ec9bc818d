// A region as a corotated superelement (design: y_j = Rᵀ x_j − x̄_j, energy ½ yᵀ K_e y).
//
//   f = −R Pᵀ K_e y,   K = (2 − θ) R Pᵀ K_e P Rᵀ,   P = I − Z (A Z)⁻¹ A
//
// R is the proper rotation closest to F = Σ_j x_j g_jᵀ. For λ = 0 (see region_response.cc) and θ = 1 f is the exact
// gradient of the energy, ∂R/∂x included, so it carries no net force and no net torque; K is its Gauss–Newton
// stiffness: positive semi-definite, blind to rotations of the current shape.
//
// The gradients g are the region's own, ḡ, unless it is what one frame, the child, adds to other frames, its parents,
// and they disagree. Given the parents' rotation the energy is a convex quadratic of the child's points, so that a
// child that was turned over or inside out finds back: ĝ, of the parents' points alone, takes over as far as the region
// or one of its frames p disagrees with R₀, the rotation that ḡ gives:
//
//   g = θ ḡ + (1 − θ) ĝ,   θ = smoothstep((e − kOpposed) / (kAgreeing − kOpposed))
//   e = min λ_min(sym(R₀ᵀ F)) over F₀ = Σ_j x_j ḡ_jᵀ and F_p = Σ_j x_j g°_jᵀ;  1 at rest
//
// How x changes θ is left out of f and K, as it is for λ. Where θ < 1 K is larger than the Gauss–Newton stiffness:
// steps of half the length do not overshoot while the regions turn.
//
// A hyperelastic law adds its own energy, in cells of the region (cells.h).

#ifndef MJFRAMES_PLUGIN_COROTATIONAL_H_
#define MJFRAMES_PLUGIN_COROTATIONAL_H_

#include <cstdint>
#include <vector>

#include "cells.h"
#include "linear.h"
#include "simd.h"

namespace mjframes {

// [-] of e, above which θ is 1: frames turned by less than 66° against their region and nowhere shortened below 0.4.
inline constexpr double kAgreeing = 0.4;
// [-] of e, below which θ is 0. Positive, so that ĝ has taken over before a frame is flat and can be turned over.
inline constexpr double kOpposed = 0.1;

// One region: the control points that move it and how stiffly (m points).
struct Region {
  std::vector<int32_t> point;      // control points, ancestors first         (m)
  std::vector<Vec3> rest;          // x̄_j minus their mean [m]                (m)
  std::vector<Vec3> gradient;      // ḡ_j [1/m]                               (m)
  std::vector<Vec3> fallback;      // ĝ_j [1/m]; empty where it has none      (m)
  std::vector<Vec3> own;           // g°_j of each point's frame [1/m]; empty with fallback (m)
  std::vector<int32_t> frame_end;  // one after the last point of each frame that has g°
  int shows;                       // as many points, the first ones, show how it turns where F does not: its parents'
                                   // where it has a fallback, else all
  std::vector<double> stiffness;   // K_e [N/m]                               (3m × 3m)
  std::vector<int32_t> pair;       // pair of points of each block (j, k ≤ j) (m(m+1)/2)
  Law law;                         // of the cells
  std::vector<Cell> cells;         // none for the law `corotational`
  double enlargement;              // of its stiffness where d->M cannot hold all of it, else 1 [-]
  int number;                      // in the configuration

  int size() const { return static_cast<int>(point.size()); }
};

// θ for e ≤ kAgreeing, or for several side by side.
template <typename V>
MJFRAMES_INLINE V TrustOf(const V& e) {
  V t = (e - kOpposed) / (kAgreeing - kOpposed);
  t = t < 0.0 ? V{} : t;
  return t * t * (3.0 - 2.0 * t);
}

// R. x: all control points of the body [m].
Mat3 RegionRotation(const Region& region, const Vec3* x, const Mat3& guess);

// ½ yᵀ K_e y and the cells' energy [J]
double RegionEnergy(const Region& region, const Vec3* x, const Mat3& R);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_COROTATIONAL_H_
