// Constraint rows of the effective inertia: their R, and where MuJoCo's solver starts, which is at the solution.
//
// MuJoCo's solver minimizes ½ (a − a₀)ᵀ M (a − a₀) + Σ_i s_i(J_i a − aref_i) over the accelerations a of all degrees of
// freedom. With a = a₀ + M⁻¹ Jᵀ g it is a problem in the forces g of the rows, which soft bodies have far fewer of:
//
//   jar = jar₀ + A g,   A = J M⁻¹ Jᵀ,   g_i = −s_i'(jar_i) = clamp(−D_i jar_i, least_i, largest_i)
//
// Given which rows are not clamped it is linear. Newton's method finds these, and a goes to d->qacc_warmstart. MuJoCo
// then finds that nothing is left to do; where something is, as what a callback adds later, it does that. Islands where
// the solution of the step before still is one are left as they are. Elliptic cones are not of this kind, and are left
// to MuJoCo.
// Index letters: i, j constraint row; k degree of freedom.

#ifndef MJFRAMES_PLUGIN_WARM_START_H_
#define MJFRAMES_PLUGIN_WARM_START_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "dents.h"
#include "row_inertia.h"

namespace mjframes {

// Whether mj_inverse is at work, which no solver follows. It finds no islands, and marks the stack; where islands are
// disabled the mark may be another caller's, whose solver then starts where it did the last time. To be asked before
// the stack is marked here.
bool IsInverse(const mjData* d);

// Whether the solver that comes is of the kind that this one is, and starts at d->qacc_warmstart.
bool Starts(const mjModel* m, const mjData* d);

// The accelerations a (nv) that the step is going to have, after ConstraintRows::Finish: of islands that are not taken
// MuJoCo's solver finds them, and where it cannot they are NaN.  starts: as there.
void Foresee(const mjModel* m, mjData* d, bool starts, double* a);

class ConstraintRows {
 public:
  // marked: whether each degree of freedom is a soft body's that changes d->M (nv).
  ConstraintRows(const mjModel* m, std::vector<char> marked);

  // Sets R of the rows that soft bodies are in, for d->M, which has to be complete and factored, and the springs of
  // contacts that make dents, and writes d->qacc_warmstart. dents, lies: of each contact, null where there are none.
  // starts: what Starts said before anyone marked mjData's stack. False where mjData has no memory for the dents.
  bool Finish(const mjModel* m, mjData* d, const ContactDents* dents, const double* lies, bool starts);

 private:
  RowInertia inertia_;
  std::vector<int> dof_;   // of a group that is not kept          (nv)
  std::vector<double> y_;  //                                      (nv × kLanes)
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_WARM_START_H_
