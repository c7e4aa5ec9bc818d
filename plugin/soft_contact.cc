#include "soft_contact.h"

#include <algorithm>

#include "patch_field.h"

namespace mjframes {

SoftContact::SoftContact(const mjModel* m, const ContactModel& model, const Kinematics& kinematics) : model_(model) {
  size_t patches = 0;  // of the scene
  for (int geom = 0; geom < m->ngeom; geom++) patches += SoftInstanceOf(m, geom) >= 0;
  const bool pairs = patches > model.patches.size();
  for (size_t i = 0; i < model.patches.size(); i++) {
    states_.push_back(std::make_unique<PatchState>(model, kinematics, static_cast<int>(i), pairs));
  }
  if (!model.patches.empty()) meshes_ = FindCollisionMeshes(m);
}

int SoftContact::FindPatch(int geom) const {
  // patches are in the order of their geoms
  const std::vector<Patch>& patches = model_.patches;
  const auto found = std::lower_bound(patches.begin(), patches.end(), geom,
                                      [](const Patch& patch, int value) { return patch.geom < value; });
  return found != patches.end() && found->geom == geom ? static_cast<int>(found - patches.begin()) : -1;
}

}  // namespace mjframes
