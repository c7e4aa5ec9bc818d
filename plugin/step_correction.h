// A step that would make energy, corrected before it is taken.
//
// Points move by h v' along straight lines, v' = v + h a, and what turns in a step by an angle is stretched by half its
// square. Where the step would make energy so, it is looked at again before it is taken. With δ = h v', what the points
// will move by, the elastic force of the step is f + c − (1 + s + β/h) K δ, and
//
//   gain = W(x + δ) − W(x) + ½ h (v + v')·(f + c − (1 + s + β/h) K δ)
//
// is what W gains beside what that force takes from the kinetic energy. If it is positive,
//
//   c = (1 + s) (f̂ − f + K δ),   f̂ = −Σ_e R_e P_eᵀ ŵ_e
//
// is added to the force, with ŵ = ∂W/∂y at x + δ, in the axes of each region there; of laws at quadrature points, f̂ is
// P of the force there (quadrature.h). It is Newton's next step to an end where the force is that of the end, and
// damped as what s times its change would do. P and R are those of x, so that momentum and angular momentum stay. Where
// c makes it better but not well, s grows. Where it makes it worse, s grows and the search starts from c = 0 again:
// from a step in which little but turns is left. Of all steps that were looked at the one that makes least is taken.
// Bodies at rest and slow ones never come here; nor do rigid frames, which turn without a stretch.

#ifndef MJFRAMES_PLUGIN_STEP_CORRECTION_H_
#define MJFRAMES_PLUGIN_STEP_CORRECTION_H_

#include <vector>

#include "elasticity.h"
#include "kinematics.h"
#include "linear.h"

namespace mjframes {

// Index letter: j control point.
class StepCorrection {
 public:
  // Of one body, whose parts live as long.
  StepCorrection(Kinematics* kinematics, Elasticity* elasticity);

  // Begins a step. elastic: f of all points [N].
  void Start(const std::vector<Vec3>& elastic);

  // Whether the step has to be looked at, since points may move so fast against each other, or against what stops some
  // of them, if it is constrained. force: on the points, damping included [N].
  bool IsFast(double h, bool constrained, const std::vector<Vec3>& force);

  // Looks at the step that the accelerations a (nv) make. If it makes energy, `change` becomes what is to be added to
  // the force on the points for the next look [N]; false where nothing is. last: no further look comes. mass: of each
  // pair of points [kg].
  bool Improve(double h, double beta, const std::vector<double>& mass, const double* a, bool last,
               std::vector<Vec3>* change);

  // s
  double firmness() const { return now_.firmness; }

 private:
  struct Trial {
    std::vector<Vec3> force;  // c [N]
    double firmness;          // s
    double made;              // its gain, to the elastic and kinetic energy there is
  };

  bool IsFar(const std::vector<Vec3>& moved) const;
  double GainOf(double h, double beta, const std::vector<double>& mass);
  void AimAtEnd();

  Kinematics* kinematics_;
  Elasticity* elasticity_;
  double extent_;  // root of the mean squared distance of the points from their middle, at rest [m]

  // of this step
  std::vector<Vec3> elastic_;                // f
  double energy_ = 0;                        // W, from the first look on [J]
  Trial now_, best_;                         // made: of the look before, infinite where that does not count
  bool settled_ = false;                     // on the best
  std::vector<Vec3> kick_, move_, ahead_;    // h a [m/s], δ but for its mean, x + that [m]
  std::vector<Vec3> force_, next_, damped_;  // memory
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_STEP_CORRECTION_H_
