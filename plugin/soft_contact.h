// What of a soft body touches: its patches, each with the vertices of its surface and the material below them.

#ifndef MJFRAMES_PLUGIN_SOFT_CONTACT_H_
#define MJFRAMES_PLUGIN_SOFT_CONTACT_H_

#include <mujoco/mujoco.h>

#include <memory>
#include <vector>

#include "geom_features.h"
#include "kinematics.h"
#include "meetings.h"
#include "patch.h"
#include "surface_state.h"

namespace mjframes {

class SoftContact {
 public:
  // Makes what one mjData needs; the model and the kinematics are to outlive it.
  SoftContact(const mjModel* m, const ContactModel& model, const Kinematics& kinematics);

  // Number of the patch of a geom, −1 if it has none.
  int FindPatch(int geom) const { return patch_of_[geom]; }

  const ContactModel& model() const { return model_; }
  SurfaceState* state() const { return state_.get(); }
  const CollisionMeshes& meshes() const { return meshes_; }  // of the scene
  // Null where the deformed volume is not known.
  Meetings* meetings() const { return meetings_.get(); }

 private:
  const ContactModel& model_;
  std::vector<int> patch_of_;  // by geom
  std::unique_ptr<SurfaceState> state_;
  CollisionMeshes meshes_;
  std::unique_ptr<Meetings> meetings_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SOFT_CONTACT_H_
