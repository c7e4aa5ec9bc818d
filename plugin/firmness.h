// How firm a contact is beside the flesh that it presses.
//
// MuJoCo's spring of a contact, of stiffness k imp / R, goes with the mass, and would hide the flesh of what is light.
// Where the flesh gives way by c [m/N], a contact that is not to bounce has the stiffness
//
//   K = n/c · min(1, (T₀/T)²)
//
// at least, T from solref. R, which acts as a mass 1/R, stays. With k imp = K R, an implicit step of that spring and
// critical damping would have 1/R = h² K + h C. So K is no more than what 1/R is enough for, with C = 2 √(K M) and
// M = (1 − imp)/imp · 1/R, which the contact moves: K ≤ (1/√(1 − imp) − 1)² M/h².
//
// What touches brings the mass 1/R along at the speed of the gap, and flesh would throw its energy back. So it is
// damped more than critically, b = ζ √(K R), but in no less than a step, 1/h; or as MuJoCo does, if that is more.

#ifndef MJFRAMES_PLUGIN_FIRMNESS_H_
#define MJFRAMES_PLUGIN_FIRMNESS_H_

#include <mujoco/mujoco.h>

namespace mjframes {

// Of a contact, along its normal.
struct Firmness {
  int rows;          // that push along the normal, from the first one on
  double k;          // [1/s²]
  double stiffness;  // k imp / R of these rows [N/m]
};

// What the spring of a contact is to be; b of its rows is set, their k not yet. R is complete. flesh: c [m/N].
Firmness MakeFirm(const mjModel* m, mjData* d, const mjContact& contact, double flesh);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_FIRMNESS_H_
