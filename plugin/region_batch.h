// Eight corotated superelements side by side: force and stiffness of corotational.h, one region a lane.
//
//   f_j = −R (w_j + h_j × s),   w = K_e y,   s = (A Z)⁻ᵀ Zᵀ w
//   K_jk = (2 − θ) R (K_e,jk − G_j [h_k]× − ([h_j]×)ᵀ G_kᵀ) Rᵀ,   G_j = (U_j − ½ N_jᵀ (Zᵀ U)) (A Z)⁻¹,   U = K_e Z
//
// where with cells w is the energy's slope and U = H Z, H in place of K_e (cells.h). (Z a)_j = a × z_j, A_j = [h_j]×
// and N_j = (A Z)⁻¹ [h_j]×. Regions of about the same number of points share a batch; where one has fewer than the
// largest, points without stiffness fill it up. Index letters: j, k control point of the region; lane region.

#ifndef MJFRAMES_PLUGIN_REGION_BATCH_H_
#define MJFRAMES_PLUGIN_REGION_BATCH_H_

#include <cstdint>
#include <vector>

#include "corotational.h"
#include "linear.h"
#include "simd.h"

namespace mjframes {

// Eight regions; every array holds eight lanes an entry.
struct RegionBatch {
  int size;                             // m, of the largest
  std::vector<int32_t> point;           // control points                                            (m)
  std::vector<double> present;          // 1, or 0 for points that fill up                           (m)
  std::vector<double> shows;            // 1 for the points that show how the region turns, else 0   (m)
  std::vector<double> rest;             // as in Region                                              (m × 3)
  std::vector<double> gradient;         // as in Region                                              (m × 3)
  std::vector<double> fallback;         // as in Region, 0 for those without; empty if all are           (m × 3)
  std::vector<double> own;              // as in Region; empty with fallback                         (m × 3)
  std::vector<double> ends;             // 1 at the last point of a frame with such gradients, else 0 (m)
  std::vector<double> stiffness;        // K_e's blocks (j, k ≤ j), row major                        (m(m+1)/2 × 9)
  std::vector<int32_t> pair;            // as in Region, −1 for blocks that fill up                  (m(m+1)/2)
  Law law;                              // of the cells
  int cells;                            // q, of the region with most; those that fill up have no volume
  std::vector<double> volume;           // of each cell                                              (q)
  std::vector<LawParameters> material;  //                                                     (q × 8)
  std::vector<double> slope;            // E_q, by point: row 3r + a for F_ra                (q × m × 9 × 3)
  double inverse_size[kWideLanes], enlargement[kWideLanes];
  double falls_back[kWideLanes];  // 1 for regions with a fallback, else 0
};

// All regions, largest first; neighbours next to each other.
std::vector<RegionBatch> BatchesOf(const std::vector<Region>& regions);

// Scratch memory for the largest batch of a body; allocated once.
struct BatchScratch {
  explicit BatchScratch(const std::vector<RegionBatch>& batches);
  std::vector<double> z;            // Rᵀ x_j centred                     (m × 3 × 8)
  std::vector<double> gradient;     // θ ḡ_j + (1 − θ) ĝ_j, where θ < 1    (m × 3 × 8)
  std::vector<double> h;            // of A_j                             (m × 3 × 8)
  std::vector<double> product;      // K_e [y | Z], column by column      (m × 12 × 8)
  std::vector<double> g;            // G_j, row major                     (m × 9 × 8)
  std::vector<double> share;        // V_q H_q E_q, as a batch's slope    (q × m × 9 × 3 × 8)
  double rotation[9 * kWideLanes];  // of the batch before, from which the next one starts
};

// The sum of the regions' elastic forces is added to `force`, and, where they are given, that of their stiffnesses to
// `stiffness` and enlarged to `held`, one row-major 3×3 block a pair of control points. x: all control points [m].
void AddBatches(const std::vector<RegionBatch>& batches, const Vec3* x, BatchScratch* scratch, Vec3* force,
                double* stiffness, double* held);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_REGION_BATCH_H_
