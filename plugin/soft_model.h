// What of a soft body never changes, from its configuration and the model's tree of bodies.

#ifndef MJFRAMES_PLUGIN_SOFT_MODEL_H_
#define MJFRAMES_PLUGIN_SOFT_MODEL_H_

#include <mujoco/mujoco.h>

#include <memory>
#include <vector>

#include "contact.h"
#include "corotational.h"
#include "kinematics.h"
#include "lattice.h"
#include "patch_volume.h"
#include "quadrature.h"
#include "reader.h"
#include "region_batch.h"

namespace mjframes {

struct SoftModel {
  // That of the instance, the same for all who ask while anyone holds it. What is wrong is told to `reader`, and then
  // there is none.
  static std::shared_ptr<const SoftModel> Find(const mjModel* m, int instance, Reader* reader);

  bool implicit = true;
  double alpha = 0, beta = 0;                // Rayleigh damping [1/s], [s]
  double contact_radius = 0;                 // [m]
  Kinematics kinematics;                     // before any step
  std::vector<Region> regions;               // of the law `corotational`, or with cells
  std::vector<RegionBatch> batches;          // the same, side by side
  std::vector<QuadratureRegion> quadrature;  // of another law at quadrature points
  double enlargement = 1;                    // of its stiffness where d->M cannot hold all of it [-]
  bool enlarges = false;                     // whether d->M holds another stiffness than K
  std::vector<Patch> patches;
  bool has_volume = false;
  std::vector<PatchVolume> volumes;  // by patch
  Lattice lattice;
  std::vector<double> mass;  // of each pair of points [kg]
  bool has_difference = false;
  std::vector<double> mass_difference;  // how much of it MuJoCo does not know of: consistent minus lumped mass [kg]

 private:
  static std::unique_ptr<const SoftModel> Read(const mjModel* m, int instance, Reader* reader);
  void AssignMass();
};

// Whether an instance changes MuJoCo's inertia: explicit bodies with lumped masses leave it as it is.
bool ChangesInertia(const mjModel* m, int instance);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SOFT_MODEL_H_
