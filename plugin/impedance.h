// R of constraint rows, for the effective inertia A in d->M.
//
// R is (1 − imp)/imp times the inverse inertia that a row sees. MuJoCo took that of bodies without elasticity before
// the plugin added to d->M; here it is J A⁻¹ Jᵀ. Without that soft bodies hang and stand as deep as their single points
// of mass would.

#ifndef MJFRAMES_PLUGIN_IMPEDANCE_H_
#define MJFRAMES_PLUGIN_IMPEDANCE_H_

#include <mujoco/mujoco.h>

#include <vector>

namespace mjframes {

class Kinematics;

// Memory for the rows of one model; allocated once.
class Impedance {
 public:
  explicit Impedance(const mjModel* m);

  // Before all others: what d->M is now. Degrees of freedom are those of bodies without elasticity until marked.
  void Start(const mjModel* m, const mjData* d);
  void Mark(const Kinematics& kinematics);

  // Whether the contact moves marked degrees of freedom.
  bool Concerns(const mjModel* m, const mjData* d, const mjContact& contact) const;

  // The rows of a contact, from that of its normal. Done again it gives the same.
  void ScaleContact(const mjModel* m, mjData* d, const mjContact& contact);

  // Those rows of equalities, friction loss and limits that concern marked degrees of freedom.
  void ScaleOthers(const mjModel* m, mjData* d);

 private:
  bool RowConcerns(const mjModel* m, const mjData* d, int i) const;
  double InverseInertia(const mjModel* m, mjData* d);
  bool SolvePaths(const mjModel* m, const mjData* d);

  std::vector<double> row_, half_;    // J and D^(−½) L^(−ᵀ) Jᵀ             (nv)
  std::vector<double> path_;          // of these, on one path of a tree    (≤ nv)
  std::vector<double> sqrt_inverse_;  // D^(−½)                             (nv)
  std::vector<char> marked_;          //                                    (nv)
};

// How many constraint rows a contact has.
int RowCount(const mjModel* m, const mjContact& contact);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_IMPEDANCE_H_
