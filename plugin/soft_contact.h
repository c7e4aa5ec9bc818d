// What of a soft body touches: its patches, each with the vertices of its surface and the material below them.

#ifndef MJFRAMES_PLUGIN_SOFT_CONTACT_H_
#define MJFRAMES_PLUGIN_SOFT_CONTACT_H_

#include <mujoco/mujoco.h>

#include <memory>
#include <vector>

#include "geom_features.h"
#include "kinematics.h"
#include "patch.h"
#include "patch_state.h"

namespace mjframes {

class SoftContact {
 public:
  // Makes what one mjData needs; the model and the kinematics are to outlive it.
  SoftContact(const mjModel* m, const ContactModel& model, const Kinematics& kinematics);

  // Number of the patch of a geom, −1 if it has none.
  int FindPatch(int geom) const;

  const ContactModel& model() const { return model_; }
  const std::vector<std::unique_ptr<PatchState>>& states() const { return states_; }  // by patch
  const CollisionMeshes& meshes() const { return meshes_; }                           // of the scene

 private:
  const ContactModel& model_;
  std::vector<std::unique_ptr<PatchState>> states_;
  CollisionMeshes meshes_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SOFT_CONTACT_H_
