// How firm a contact is beside the flesh that it presses.
//
// MuJoCo's spring of a contact, of stiffness k imp / R, goes with the mass, and would hide the flesh of what is light.
// Where the flesh gives way by c [m/N], a contact that is not to bounce has the stiffness
//
//   K = n/c · min(1, (T₀/T)²)
//
// at least, T from solref. R, which acts as a mass 1/R, stays. An implicit step of a spring with critical damping,
// f = −K (x + h v') − C v', would have the rows
//
//   1/R = h² K + h C,   b = (h K + C) R,   k imp = K R,   C = 2 √(K M)
//
// where M = (1 − imp)/imp · 1/R is what the contact moves. So K is no more than what 1/R is enough for,
// (1/√(1 − imp) − 1)² M/h², and b is as much, or MuJoCo's if that is more. So much firmer a spring would throw out what
// is deep in it. It drives apart with all its force as fast as MuJoCo's own spring would, and no faster than twice
// that.

#ifndef MJFRAMES_PLUGIN_FIRMNESS_H_
#define MJFRAMES_PLUGIN_FIRMNESS_H_

#include <mujoco/mujoco.h>

namespace mjframes {

// Of a contact, along its normal.
struct Firmness {
  int rows;          // that push along the normal, from the first one on
  double k;          // [1/s²]
  double stiffness;  // k imp / R of these rows [N/m]
  double outward;    // up to what rate it drives apart with all its force [m/s]; infinity where it is to bounce
};

// What the spring of a contact is to be; b of its rows is set, their k not yet. R is complete. flesh: c [m/N].
Firmness MakeFirm(const mjModel* m, mjData* d, const mjContact& contact, double flesh);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_FIRMNESS_H_
