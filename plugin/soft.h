// mjframes.soft: a soft body made of frames, inside mj_step.
//
// The control points ride on MuJoCo bodies that are nested along the elimination tree of the stiffness matrix, so that
// all of K fits the sparsity of d->M (kinematics.h). Each step
//
//   qfrc_passive += Jᵀ (f_elastic − (h + β) K v − α M v − D dJ/dt qvel)
//   d->M         += Jᵀ ((h² + h β) K + h α M + D) J,   then factored
//
// where D is what the mass M of the material has beyond the points' masses, which are what MuJoCo knows of, and
// MuJoCo's own solver finishes the linearly implicit Euler step (7) with contacts and all. In explicit mode the first
// line has β K v for (h + β) K v, and the second D alone. In the second K includes what forces on rigid frames add to
// the stiffness of their rotation (inertia.cc). Index letters: j, k control point; e region; s surface vertex.
// Everything is in the soft body's own axes [SI].

#ifndef MJFRAMES_PLUGIN_SOFT_H_
#define MJFRAMES_PLUGIN_SOFT_H_

#include <mujoco/mujoco.h>

#include <memory>
#include <vector>

#include "contact.h"
#include "corotational.h"
#include "factor.h"
#include "geom_features.h"
#include "kinematics.h"
#include "lattice.h"
#include "linear.h"
#include "patch_state.h"
#include "patch_volume.h"
#include "quadrature.h"
#include "region_batch.h"
#include "soft_model.h"

namespace mjframes {

inline constexpr char kPluginName[] = "mjframes.soft";

class SoftBody {
 public:
  // Validates instance `instance` of the model; on failure warns in one sentence and returns null.
  static std::unique_ptr<SoftBody> Create(const mjModel* m, int instance);

  // Adds this step's forces and effective inertia; the model's last soft body then writes all constraint rows.
  void Compute(const mjModel* m, mjData* d);

  // At the end of a step, whether Compute was called in it or not: warns, once, of options that were made wrong since
  // the data was created. The model's last soft body does so for all.
  void CheckOptions(const mjModel* m, const mjData* d);

  // For sensors, outside Compute: positions and velocities as d has them now, and after that the energies [J].
  void Gather(const mjModel* m, const mjData* d) { kinematics_.Gather(m, d); }
  double ElasticEnergy();
  double KineticEnergy(const mjModel* m, const mjData* d);

  // Number of the patch of a geom, −1 if it has none.
  int FindPatch(int geom) const;
  bool changes_inertia() const { return changes_inertia_; }
  double contact_radius() const { return model_->contact_radius; }
  // What small is to the body [m]: a cell of the lattice, if it has one.
  double cell() const { return has_volume() ? lattice().spacing : contact_radius(); }
  const Kinematics& kinematics() const { return kinematics_; }
  const std::vector<Patch>& patches() const { return model_->patches; }
  const std::vector<PatchVolume>& volumes() const { return model_->volumes; }
  const std::vector<std::unique_ptr<PatchState>>& states() const { return states_; }
  // Whether the deformed volume is known: not with point frames, whose patches touch rigid geoms with their vertices
  // only.
  bool has_volume() const { return model_->has_volume; }
  const Lattice& lattice() const { return model_->lattice; }
  const CollisionMeshes& meshes() const { return meshes_; }
  // The region of this number in the configuration, which has to be there; not of a law at quadrature points.
  const Region& FindRegion(int number) const;

 private:
  SoftBody() = default;

  void Start(const mjModel* m, int instance, Reader* reader);
  void ScaleMass(const mjModel* m);
  void AddElasticity();
  void AddDamping(double rate);
  void AddMassBias(const mjModel* m, const mjData* d);
  static bool AnyAdds(const mjModel* m, const mjData* d);
  void StoreInertia(const mjModel* m, mjData* d, bool consistent);
  void FactorInertia(const mjModel* m, mjData* d);

  std::shared_ptr<const SoftModel> model_;
  bool changes_inertia_ = true;
  bool starts_inertia_ = false;            // first of the model's instances that change it
  std::unique_ptr<InertiaFactor> factor_;  // the last one's, for all
  bool last_ = false;                      // of all instances
  bool told_ = false, told_few_ = false;   // what CheckOptions has to say
  bool told_mass_ = false;                 // what ScaleMass has to say
  CollisionMeshes meshes_;                 // of the scene

  // of this step; one SoftBody belongs to one mjData
  Kinematics kinematics_;
  std::vector<std::unique_ptr<PatchState>> states_;  // by patch
  std::vector<Vec3> force_;                          // on the control points
  std::vector<Vec3> moved_;                          // rate times the velocities without their mean, see AddDamping [m]
  std::vector<Vec3> velocity_;                       // of the control points in the world, for sensors
  std::vector<double> stiffness_;                    // K, 3×3 row-major block a pair
  std::vector<double> held_;        // K enlarged for d->M, which cannot hold all of it; empty where it can
  std::vector<double> mass_scale_;  // of each point, √ of its body's mass to the one that it was built with [-]
  std::vector<double> mass_, mass_difference_;  // those of the model, with the masses of today [kg]
  std::vector<double> added_mass_;              // of each pair: h α m + mass difference
  std::unique_ptr<BatchScratch> batch_scratch_;
  std::unique_ptr<QuadratureScratch> quadrature_scratch_;
  std::unique_ptr<ContactScratch> contact_scratch_;
};

// The soft body behind plugin instance `instance` of the model, or null if that is another plugin's.
SoftBody* GetSoftBody(const mjModel* m, const mjData* d, int instance);

// Whether plugin instance `instance` of the model is a soft body's.
bool IsSoftBody(const mjModel* m, int instance);

// The plugin instance of the soft body whose moving frames hang on body `holder`, −1 for none.
int SoftBodyHeldBy(const mjModel* m, int holder);

void RegisterPlugin();

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SOFT_H_
