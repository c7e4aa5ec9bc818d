// A region as a corotated superelement (design: y_j = Rᵀ x_j − x̄_j, energy ½ yᵀ K_e y).
//
//   f = −R Pᵀ K_e y,   K = (2 − θ) R Pᵀ K_e P Rᵀ,   P = I − Z (A Z)⁻¹ A
//
// R is the proper rotation closest to F = Σ_j x_j g_jᵀ. For λ = 0 (see corotational_response.cc) and θ = 1 f is the
// exact gradient of the energy, ∂R/∂x included, so it carries no net force and no net torque; K is its Gauss–Newton
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
// A region of one frame may evaluate a hyperelastic law in its cells. With y = Rᵀ x − x̄ of its control points,
//
//   W = ½ yᵀ K_e y + Σ_q V_q ψ(F_q),   F_q = I + E_q y
//
// K_e is what the law leaves of the stiffness at rest, Σ_q V_q E_qᵀ C E_q + K_e (mjframes/whole_body/cells.py). A step
// needs the slope of W in y, and H with H_q = ∂P/∂F projected (hessian.h), in place of K_e y and K_e:
//
//   K_e y + Σ_q V_q E_qᵀ P_q,   H = K_e + Σ_q V_q E_qᵀ H_q E_q
//
// Index letters: j, k control point of the region; q cell; r, s rows of F; a, b its columns; lane region.

#ifndef MJFRAMES_PLUGIN_COROTATIONAL_H_
#define MJFRAMES_PLUGIN_COROTATIONAL_H_

#include <cstdint>
#include <vector>

#include "constants.h"
#include "laws/laws.h"
#include "linear.h"
#include "shares.h"
#include "simd.h"

namespace mjframes {

// One cell of a region with m points.
struct Cell {
  double volume;              // V_q [m³]
  LawParameters material;     //
  int factor;                 // which one its moduli follow
  std::vector<double> slope;  // E_q [1/m], row 3r + a for F_ra (9 × 3m)
};

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
  Shares shares;                   // what each material has of it; none where there is one alone
  std::vector<int32_t> pair;       // pair of points of each block (j, k ≤ j) (m(m+1)/2)
  Law law;                         // of the cells
  std::vector<Cell> cells;         // none for the law `corotational`
  double enlargement;              // of its stiffness where d->M has no room for all of it, else 1 [-]
  int number;                      // in the attributes

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

// ½ yᵀ K_e y and the cells' energy [J], with this K_e (3m × 3m) and factors of the cells' moduli, the region's own
// where none are given.
double RegionEnergy(const Region& region, const Vec3* x, const Mat3& R, const double* stiffness, const double* factors);

// Eight regions side by side, one a lane: their force and stiffness.
//
//   f_j = −R (w_j + h_j × s),   w = K_e y,   s = (A Z)⁻ᵀ Zᵀ w
//   K_jk = (2 − θ) R (K_e,jk − G_j [h_k]× − ([h_j]×)ᵀ G_kᵀ) Rᵀ,   G_j = (U_j − ½ N_jᵀ (Zᵀ U)) (A Z)⁻¹,   U = K_e Z
//
// where with cells w is the energy's slope and U = H Z, H in place of K_e (corotational.h). (Z a)_j = a × z_j, A_j =
// [h_j]× and N_j = (A Z)⁻¹ [h_j]×. Regions of about the same number of points are in one batch; where one has fewer
// than the largest, points without stiffness fill it up. Every array has eight lanes an entry.
struct RegionBatch {
  // What factors of the materials change.
  struct Moduli {
    std::vector<double> stiffness;        // K_e's blocks (j, k ≤ j), row major                      (m(m+1)/2 × 9)
    std::vector<LawParameters> material;  // of each cell                                            (q × 8)
  };
  std::vector<int> region;       // which of the body's, none for lanes at the end without one
  int size;                      // m, of the largest
  std::vector<int32_t> point;    // control points                                            (m)
  std::vector<double> present;   // 1, or 0 for points that fill up                           (m)
  std::vector<double> shows;     // 1 for the points that show how the region turns, else 0   (m)
  std::vector<double> rest;      // as in Region                                              (m × 3)
  std::vector<double> gradient;  // as in Region                                              (m × 3)
  std::vector<double> fallback;  // as in Region, 0 for those without; empty if all are           (m × 3)
  std::vector<double> own;       // as in Region; empty with fallback                         (m × 3)
  std::vector<double> ends;      // 1 at the last point of a frame with such gradients, else 0 (m)
  std::vector<int32_t> pair;     // as in Region, −1 for blocks that fill up                  (m(m+1)/2)
  Law law;                       // of the cells
  int cells;                     // q, of the region with most; those that fill up have no volume
  std::vector<double> volume;    // of each cell                                              (q)
  std::vector<double> slope;     // E_q, by point: row 3r + a for F_ra                (q × m × 9 × 3)
  // m, of the largest of each four lanes
  int sizes[kWideLanes / kLanes] = {};
  double inverse_size[kWideLanes], enlargement[kWideLanes];
  double falls_back[kWideLanes];  // 1 for regions with a fallback, else 0
  Moduli moduli;                  // as built
};

// All regions, largest first; neighbours next to each other.
std::vector<RegionBatch> BatchesOf(const std::vector<Region>& regions);

// Gives a lane K_e of its region (3m × 3m), and the cells' materials with factors of their moduli.
void FillLane(const Region& region, const double* stiffness, const double* factors, int lane,
              RegionBatch::Moduli* moduli);

// Scratch memory for the largest batch of a body; allocated once.
struct BatchScratch {
  explicit BatchScratch(const std::vector<RegionBatch>& batches);
  std::vector<double> z;            // Rᵀ x_j centred                     (m × 3 × 8)
  std::vector<double> gradient;     // θ ḡ_j + (1 − θ) ĝ_j, where θ < 1    (m × 3 × 8)
  std::vector<double> h;            // of A_j                             (m × 3 × 8)
  std::vector<double> product;      // K_e [y | Z], column by column      (m × 12 × 8)
  std::vector<double> g;            // G_j, row major                     (m × 9 × 8)
  std::vector<double> curved;       // V_q H_q E_q, as a batch's slope    (q × m × 9 × 3 × 8)
  double rotation[9 * kWideLanes];  // of the batch before, from which the next one starts
};

// The sum of the regions' elastic forces is added to `force`, and, where they are given, that of their stiffnesses to
// `stiffness` and enlarged to `enlarged`, one row-major 3×3 block a pair of control points. moduli: one a batch, null
// for those as built. x: all control points [m].
void AddBatches(const std::vector<RegionBatch>& batches, const RegionBatch::Moduli* moduli, const Vec3* x,
                BatchScratch* scratch, Vec3* force, double* stiffness, double* enlarged);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_COROTATIONAL_H_
