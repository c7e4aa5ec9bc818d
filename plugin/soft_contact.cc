#include "soft_contact.h"

#include "patch_field.h"

namespace mjframes {

SoftContact::SoftContact(const mjModel* m, const ContactModel& model, const Kinematics& kinematics)
    : model_(model), patch_of_(m->ngeom, -1) {
  size_t patches = 0;  // of the scene
  for (int geom = 0; geom < m->ngeom; geom++) patches += SoftInstanceOf(m, geom) >= 0;
  const bool pairs = patches > model.patches.size();
  for (size_t i = 0; i < model.patches.size(); i++) patch_of_[model.patches[i].geom] = static_cast<int>(i);
  state_ = std::make_unique<SurfaceState>(model, kinematics, pairs, pairs || m->nflex > 0);
  if (!model.patches.empty()) meshes_ = FindCollisionMeshes(m);
  if (model.has_volume) meetings_ = std::make_unique<Meetings>(model, meshes_, pairs, m->ngeom - patches, state_.get());
}

}  // namespace mjframes
