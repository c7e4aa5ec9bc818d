// mjframes.soft: all soft bodies of one mjData, and their step inside mj_step.
//
// The control points ride on MuJoCo bodies that are nested along the elimination tree of the stiffness matrix, so that
// all of K fits the sparsity of d->M (kinematics.h). Each step
//
//   qfrc_passive += Jᵀ (f − (h + β) K v − α M v − D dJ/dt qvel)
//   d->M         += Jᵀ ((h² + h β) K + h α M + D) J,   then factored
//
// where D is what the mass M of the material has beyond the points' masses, which are what MuJoCo knows of, and
// MuJoCo's own solver finishes the linearly implicit Euler step (7) with contacts and all. In explicit mode the first
// line has β K v for (h + β) K v, and the second D alone. In the second K includes what forces on rigid frames add to
// the stiffness of their rotation (inertia.cc).
//
// MuJoCo calls a plugin once for each instance, that is soft body, from mj_passive: after the rigid inertia and the
// constraints exist, before the solver. The first instance's world steps all; calls for the others do nothing. Contacts
// are found earlier, where MuJoCo collides geoms (contact.h).

#ifndef MJFRAMES_PLUGIN_WORLD_H_
#define MJFRAMES_PLUGIN_WORLD_H_

#include <mujoco/mujoco.h>

#include <memory>
#include <vector>

#include "contact.h"
#include "factor.h"
#include "soft_body.h"
#include "warm_start.h"

namespace mjframes {

inline constexpr char kPluginName[] = "mjframes.soft";

class World {
 public:
  // The soft bodies of the model, validated; on failure warns in one sentence and returns null.
  static std::unique_ptr<World> Create(const mjModel* m);

  // Forces, inertia, its factors, constraint rows.
  void Step(const mjModel* m, mjData* d);

  // Warns, once, of options that were made wrong since the data was created.
  void CheckOptions(const mjModel* m);

  // The soft body behind a plugin instance, null if that is another plugin's.
  SoftBody* Body(int instance) const { return of_instance_[instance]; }

 private:
  World(const mjModel* m, std::vector<std::unique_ptr<SoftBody>> bodies);

  std::vector<bool> ChangedTrees(const mjModel* m) const;
  std::vector<char> ChangedDofs(const mjModel* m) const;
  template <typename Visit>
  void ForTendons(const mjData* d, const Visit& visit) const;

  std::vector<std::unique_ptr<SoftBody>> bodies_;  // in the order of their instances
  std::vector<SoftBody*> of_instance_;             // by plugin instance
  std::vector<int> tendons_;                       // plugin instances of the scene's chambers and fibres
  bool adds_ = false;                              // whether any adds to d->M what it does not replace
  bool touches_ = false;                           // whether any has patches
  bool dents_ = false;                             // whether contacts of any make dents
  InertiaFactor factor_;
  ContactScratch contact_rows_;
  ConstraintRows rows_;
  bool told_ = false, told_few_ = false, told_number_ = false;  // what CheckOptions has to say
  bool told_memory_ = false;
};

// The soft body behind plugin instance `instance`, or null if that is another plugin's.
SoftBody* GetSoftBody(const mjData* d, int instance);

// Whether plugin instance `instance` of the model is a soft body's.
bool IsSoftBody(const mjModel* m, int instance);

// The plugin instance of the soft body whose moving frames hang on body `holder`, −1 for none.
int SoftBodyHeldBy(const mjModel* m, int holder);

void RegisterWorld();

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_WORLD_H_
