// A region as a corotated superelement: y_j = Rᵀ x_j − x̄_j, and R is the rotation of least energy,
//
//   W = min over R of ½ yᵀ K_e y + κ/2 |skew Rᵀ F|²,   F = Σ_j x_j ḡ_jᵀ
//
// At rest K_e does not know R, κ does: R is close to the rotation that is closest to F. κ follows from K_e (FillLane).
// As the least of functions of x that are smooth, W is continuous in every state, and its gradient is that of the one
// that is least, at the same R: with w = ∂W/∂y, H the Hessian at fixed R, κ included, and (Z a)_j = a × z_j, U = H Z,
//
//   f = −R w,   stiffness = R Pᵀ H P Rᵀ,   P = 1 − Z Ω,   Ω = C⁻¹ (U − [a × w_j])ᵀ
//
// Ω tells how R turns as the points move; C is the curvature of W in such turns, Zᵀ U where nothing is strained. Where
// the two differ much, Ω is that of Zᵀ U without w, and the stiffness is twice that; with cells Ω always is. Zᵀ w = 0,
// so that f carries no net force and no net torque. The stiffness is positive semi-definite, blind to rotations of the
// current shape, and what the region has beside what its turning adds.
//
// A region of one frame may evaluate a hyperelastic law in its cells. With y = Rᵀ x − x̄ of its control points,
//
//   W = ½ yᵀ K_e y + Σ_q V_q ψ(F_q),   F_q = I + E_q y
//
// in place of ½ yᵀ K_e y. K_e is what the law leaves of the stiffness at rest, Σ_q V_q E_qᵀ C E_q + K_e
// (mjframes/whole_body/cells.py). K has Σ_q V_q E_qᵀ H_q E_q more, H_q = ∂P/∂F projected (hessian.h).
//
// A region of one frame without cells gets stiffer where it is pressed, by ψ of pressed.h: W has ψ(E y) more, and H has
// Eᵀ (∂²ψ/∂ε²) E. The paper's regions do not.
//
// Index letters: j, k control point of the region; p frame; q cell; r, s rows of F; a, b its columns; lane region.

#ifndef MJFRAMES_PLUGIN_COROTATIONAL_H_
#define MJFRAMES_PLUGIN_COROTATIONAL_H_

#include <cstdint>
#include <vector>

#include "constants.h"
#include "laws/laws.h"
#include "linear.h"
#include "shares.h"
#include "simd.h"
#include "turn.h"

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
  std::vector<int32_t> point;     // control points                          (m)
  std::vector<Vec3> rest;         // x̄_j minus their mean [m]                (m)
  std::vector<Vec3> gradient;     // ḡ_j [1/m]                               (m)
  bool solid;                     // whether ḡ shows all of F: its points do not lie in a plane at rest
  bool stiffens;                  // whether it gets stiffer where it is pressed (pressed.h)
  std::vector<double> stiffness;  // K_e [N/m]                               (3m × 3m)
  Shares shares;                  // what each material has of it; none where there is one alone
  std::vector<int32_t> pair;      // pair of points of each block (j, k ≤ j) (m(m+1)/2)
  Law law;                        // of the cells
  std::vector<Cell> cells;        // none for the law `corotational`
  double enlargement;             // of its stiffness where d->M has no room for all of it, else 1 [-]
  int number;                     // in the attributes

  int size() const { return static_cast<int>(point.size()); }
};

// Eight regions side by side, one a lane: their force and stiffness, as above. Regions of about the same number of
// points are in one batch; where one has fewer than the largest, points without stiffness fill it up. Every array has
// eight lanes an entry.
struct RegionBatch {
  // What factors of the materials change.
  struct Moduli {
    std::vector<double> stiffness;        // K_e's blocks (j, k ≤ j) with those of κ, row major     (m(m+1)/2 × 9)
    std::vector<LawParameters> material;  // of each cell                                            (q × 8)
    std::vector<double> pressed;          // c of pressed.h [J], 0 for regions without ψ
    std::vector<double> compliance;       // C⁻¹ of pressed.h [1/J], row by row                       (6 × 6)
  };
  std::vector<int> region;       // which of the body's, none for lanes at the end without one
  int size;                      // m, of the largest
  std::vector<int32_t> point;    // control points                                            (m)
  std::vector<double> present;   // 1, or 0 for points that fill up                           (m)
  std::vector<double> rest;      // as in Region                                              (m × 3)
  std::vector<double> gradient;  // as in Region                                              (m × 3)
  std::vector<int32_t> pair;     // as in Region, −1 for blocks that fill up                  (m(m+1)/2)
  Law law;                       // of the cells
  int cells;                     // q, of the region with most; those that fill up have no volume
  std::vector<double> volume;    // of each cell                                              (q)
  std::vector<double> slope;     // E_q, by point: row 3r + a for F_ra                (q × m × 9 × 3)
  // m, of the largest of each four lanes
  int sizes[kWideLanes / kLanes] = {};
  double inverse_size[kWideLanes], enlargement[kWideLanes];
  double solid[kWideLanes];   // 1 or 0, as in Region
  double celled[kWideLanes];  // 1 or 0: whether the region has cells
  Moduli moduli;              // as built
};

// All regions, largest first; neighbours next to each other.
std::vector<RegionBatch> BatchesOf(const std::vector<Region>& regions);

// Gives a lane K_e of its region (3m × 3m), and the cells' materials with factors of their moduli.
void FillLane(const Region& region, const double* stiffness, const double* factors, int lane,
              RegionBatch::Moduli* moduli);

// Scratch memory for the largest batch of a body; allocated once.
struct BatchScratch {
  explicit BatchScratch(const std::vector<RegionBatch>& batches);
  std::vector<double> z;       // Rᵀ x_j centred                          (m × 3 × 8)
  std::vector<double> before;  // z at other places                       (m × 3 × 8)
  std::vector<double> start;   // K y for the R that the search starts at (m × 3 × 8)
  // Σ_k K_jk,ab z_k,s there, entry 9a + 3b + s; where regions are pressed, then with x̄_k in place of z_k
  std::vector<double> moment;       //                                         (m × 27 × 8)
  std::vector<double> product;      // w = ∂W/∂y and U, column by column       (m × 12 × 8)
  std::vector<double> follow;       // Ω and Y, row major                      (m × 18 × 8)
  std::vector<double> stress;       // V_q P_q                                (q × 9 × 8)
  std::vector<double> curved;       // V_q H_q E_q, as a batch's slope         (q × m × 9 × 3 × 8)
  double rotation[9 * kWideLanes];  // of the batch before, from which the next one starts
  Turn turn;                        // of one region
};

// What of all regions is asked for: each is added to where it is given.
struct Wanted {
  Vec3* force = nullptr;        // of each control point [N]
  double* stiffness = nullptr;  // one row-major 3×3 block a pair of control points [N/m]
  double* enlarged = nullptr;   // the same, each region's times its enlargement
  double* energy = nullptr;     // W [J]
  Mat3* rotation = nullptr;     // R of each region, by its number; not added
  const Vec3* ahead = nullptr;  // places of all points [m], whose force is meant (step_correction.h)
};

// moduli: one a batch, null for those as built. x: all control points [m].
void AddBatches(const std::vector<RegionBatch>& batches, const RegionBatch::Moduli* moduli, const Vec3* x,
                BatchScratch* scratch, const Wanted& wanted);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_COROTATIONAL_H_
