// d->qLD, d->qLDiagInv: M = Lᵀ D L of whole kinematic trees, as mj_factorM has it, to rounding.
//
// Degrees of freedom in a row, each the only one between the ones before and after it, are eliminated together
// (elimination.h). Rows are as in d->M: of the degrees of freedom on the path to the root, the outermost first.

#ifndef MJFRAMES_PLUGIN_FACTOR_H_
#define MJFRAMES_PLUGIN_FACTOR_H_

#include <mujoco/mujoco.h>

#include <vector>

namespace mjframes {

class InertiaFactor {
 public:
  // For the kinematic trees marked in `trees` (one a tree of the model).
  InertiaFactor(const mjModel* m, const std::vector<bool>& trees);

  // Factors those trees' part of d->M, where they are awake; that of the others stays as it is. False where d->M is not
  // positive definite.
  bool Factor(const mjModel* m, mjData* d);

 private:
  // Degrees of freedom `first` … `first + size − 1`.
  struct Chain {
    int first, size;
  };

  std::vector<Chain> chains_;   // the last one first
  std::vector<int> start_;      // of each row in rows_                                              (nv)
  std::vector<double> rows_;    // each with room for whole tiles
  std::vector<double> scaled_;  // U / D of a chain, path by path                                  (p × above)
  std::vector<double*> path_;   // the rows above a chain
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_FACTOR_H_
