// One soft body of one mjData: its elasticity, its kinematics, its contact and its mass. world.h says when what is
// called. Index letters: j, k control point; e region; s surface vertex. Everything is in the soft body's own axes
// [SI].

#ifndef MJFRAMES_PLUGIN_SOFT_BODY_H_
#define MJFRAMES_PLUGIN_SOFT_BODY_H_

#include <mujoco/mujoco.h>

#include <memory>
#include <optional>
#include <vector>

#include "elasticity.h"
#include "kinematics.h"
#include "linear.h"
#include "scaling.h"
#include "soft_contact.h"
#include "soft_model.h"
#include "step_correction.h"

namespace mjframes {

class SoftBody {
 public:
  // Validates plugin instance `instance` of the model; on failure warns in one sentence and returns null.
  static std::unique_ptr<SoftBody> Create(const mjModel* m, int instance);

  // Stages of World::Step, in their order; `force` is that on the control points.
  void Locate(const mjModel* m, const mjData* d);       // x, v, and the masses and scaling of today
  void AddElasticity(const mjData* d);                  // force = f, and K
  void AddDamping(double h);                            // force −= (h + β) K v + α M v, in explicit mode β K v
  void AddMassBias(const mjModel* m, const mjData* d);  // force −= D dJ/dt qvel
  void StoreForce(mjData* d) { kinematics_.StoreForce(force_, d); }  // qfrc_passive += Jᵀ force
  // d->M += Jᵀ ((h² + h β) K + h α M + D) J, D only if consistent.
  void StoreInertia(const mjModel* m, mjData* d, bool consistent);

  // Whether the step has to be looked at, since points may move so fast against each other, or against what stops some
  // of them, if it is constrained; after AddDamping.
  bool IsFast(double h, bool constrained);
  // Corrects the step that the accelerations a (nv) make, if it makes energy: qfrc_passive += Jᵀ of what is new, and
  // whether d->M has to be stored again is in `firmer`. False where nothing had to be done. last: no further look
  // comes.
  bool Correct(const mjModel* m, mjData* d, const double* a, bool last, bool* firmer);

  // After Locate [J].
  double ElasticEnergy() { return elasticity_.Energy(kinematics_.x().data()); }
  // R of each region of the law `corotational`, or with cells.
  const std::vector<Mat3>& RegionRotations() { return RegionRotationsAt(kinematics_.x().data()); }
  const std::vector<Mat3>& RegionRotationsAt(const Vec3* x) { return elasticity_.Rotations(x); }
  double KineticEnergy(const mjModel* m, const mjData* d);

  double mass() const { return total_mass_; }  // of today [kg]
  int instance() const { return instance_; }
  const SoftModel& model() const { return *model_; }
  const Scaling& scaling() const { return scaling_reader_.latest(); }
  const Elasticity& elasticity() const { return elasticity_; }
  const Kinematics& kinematics() const { return kinematics_; }
  const SoftContact& contact() const { return contact_; }

 private:
  SoftBody(const mjModel* m, int instance, std::shared_ptr<const SoftModel> model, const ScalingReader& scaling);

  void ScaleMass(const mjModel* m);
  double TotalMass() const;
  void SubtractMass(const std::vector<double>& mass, double scale, const Vec3* u);

  int instance_;  // of the plugin
  std::shared_ptr<const SoftModel> model_;
  Kinematics kinematics_;
  Elasticity elasticity_;
  SoftContact contact_;
  ScalingReader scaling_reader_;

  std::optional<StepCorrection> correction_;  // none for bodies whose steps are taken as they are

  // of this step
  std::vector<Vec3> force_;                     // on the control points
  std::vector<Vec3> moved_;                     // rate times the velocities without their mean, see AddDamping [m]
  bool told_mass_ = false;                      // that a mass is not positive
  std::vector<double> mass_scale_;              // of each point, √ of its body's mass to the one it was built with [-]
  std::vector<double> mass_, mass_difference_;  // those of the model, with the masses of today [kg]
  double total_mass_ = 0;                       // [kg]
  std::vector<double> added_mass_;              // of each pair: h α m + mass difference
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SOFT_BODY_H_
