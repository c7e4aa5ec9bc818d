// What constraint rows see of the effective inertia: Y = D^(−½) L^(−ᵀ) Jᵀ with M = Lᵀ D L, so that J M⁻¹ Jᵀ = Yᵀ Y.
//
// A few rows that depend on the same degrees of freedom are solved for together, side by side. Index letters: r row of
// a group; k degree of freedom that it depends on.

#ifndef MJFRAMES_PLUGIN_ROW_INERTIA_H_
#define MJFRAMES_PLUGIN_ROW_INERTIA_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "simd.h"

namespace mjframes {

struct RowGroup {
  int row, rows;  // so many rows, kLanes at most, from this one on
  bool marked;    // whether they move degrees of freedom that are marked
  bool paths;     // whether those they depend on are one path from the root in each tree
  int size;       // so many: those that have entries, and all above them
  int* dof;       // which, ascending                                        (size)
  double* y;      // Y, zero beyond `rows`                                   (size × kLanes)
};

class RowInertia {
 public:
  // marked: of the degrees of freedom (nv).
  RowInertia(const mjModel* m, std::vector<char> marked);

  // After d->M is complete and factored.
  void Start(const mjModel* m, const mjData* d);

  // Finds the degrees of freedom that `rows` rows from `row` on depend on, for Solve. dof and y are null.
  RowGroup Find(const mjModel* m, const mjData* d, int row, int rows);

  // Fills y of the group found last; its `dof` and `y` have room for what they hold.
  void Solve(const mjModel* m, const mjData* d, RowGroup* group);

  const std::vector<double>& sqrt_inverse() const { return sqrt_inverse_; }

 private:
  std::vector<char> marked_, depends_;  //                          (nv)
  std::vector<int> dof_, place_;        // of the group found last  (nv)
  std::vector<double> sqrt_inverse_;    // D^(−½)                   (nv)
};

// Y_pᵀ Y_q, row r of p in out[r].
void MultiplyGroups(const mjModel* m, const RowGroup& p, const RowGroup& q, Lanes* out);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_ROW_INERTIA_H_
