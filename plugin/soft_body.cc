#include "soft_body.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "options.h"
#include "parse.h"
#include "reader.h"

namespace mjframes {
namespace {

constexpr double kSameMass = 1e-4;  // [-] of a body's mass: the model's masses have six digits

bool CanCollide(const mjModel* m, int a, int b) {
  return (m->geom_contype[a] & m->geom_conaffinity[b]) || (m->geom_contype[b] & m->geom_conaffinity[a]);
}

// MuJoCo 4.0.0 lets height fields have no contact with any SDF geom.
void CheckHeightFields(const mjModel* m, int patch, Reader* reader) {
  for (int geom = 0; geom < m->ngeom; geom++) {
    if (m->geom_type[geom] != mjGEOM_HFIELD || !CanCollide(m, geom, patch)) continue;
    if (mj_maxContact(m, geom, patch, -1) > 0) return;
    reader->Fail(std::string("this MuJoCo (") + mj_versionString() +
                 ") gives soft bodies no contact with height field '" + (m->names + m->name_geomadr[geom]) +
                 "': make it a mesh, use MuJoCo 3.17.0, or set its contype and conaffinity so that they do not meet");
    return;
  }
}

// MuJoCo collides flexes of triangles with SDF geoms, and no others.
void CheckFlexes(const mjModel* m, int patch, Reader* reader) {
  for (int flex = 0; flex < m->nflex; flex++) {
    const bool collides =
        (m->flex_contype[flex] & m->geom_conaffinity[patch]) || (m->geom_contype[patch] & m->flex_conaffinity[flex]);
    if (!collides || m->flex_dim[flex] == 2) continue;
    reader->Fail(std::string("MuJoCo gives soft bodies contact with flexes of dim 2 only, not with '") +
                 (m->names + m->name_flexadr[flex]) + "': set its contype and conaffinity so that they do not meet");
    return;
  }
}

// What of the scene the body cannot work with.
void CheckScene(const mjModel* m, const SoftModel& model, Reader* reader) {
  if (const char* wrong = WrongOption(m, model.implicit, model.changes_inertia)) reader->Fail(wrong);
  reader->Check(
      !(m->opt.enableflags & mjENBL_SLEEP) || !model.kinematics.MissesWaking(m),
      "it is attached to bodies of several kinematic trees, or to a mocap body, and MuJoCo would not wake one "
      "with the other: give the root body of each tree sleep=\"never\", or disable sleep");
  if (model.contact.patches.empty()) return;
  CheckHeightFields(m, model.contact.patches.front().geom, reader);
  CheckFlexes(m, model.contact.patches.front().geom, reader);
}

}  // namespace

std::unique_ptr<SoftBody> SoftBody::Create(const mjModel* m, int instance) {
  Reader reader(m, instance);
  std::shared_ptr<const SoftModel> model = FindModel(m, instance, &reader);
  if (model) CheckScene(m, *model, &reader);
  if (reader.ok()) return std::unique_ptr<SoftBody>(new SoftBody(m, instance, std::move(model)));
  mju_warning("mjframes: soft body '%s': %s.", m->names + m->name_pluginadr[instance], reader.error().c_str());
  return nullptr;
}

SoftBody::SoftBody(const mjModel* m, int instance, std::shared_ptr<const SoftModel> model)
    : instance_(instance),
      model_(std::move(model)),
      kinematics_(model_->kinematics),
      elasticity_(model_->elastic, kinematics_.pairs()),
      contact_(m, model_->contact, kinematics_),
      force_(kinematics_.points().size()),
      moved_(force_.size()),
      mass_scale_(force_.size(), 1.0),
      mass_(model_->mass),
      mass_difference_(model_->mass_difference),
      added_mass_(mass_.size()) {}

// Masses may be changed in the model at any time. √(s_j s_k) M_jk stays positive definite, and right where s is common.
void SoftBody::ScaleMass(const mjModel* m) {
  bool same = true;
  for (size_t j = 0; j < mass_scale_.size(); j++) {
    const ControlPoint& point = kinematics_.points()[j];
    const double ratio = m->body_mass[point.body] / point.carried;
    const double scale = std::abs(ratio - 1) > kSameMass ? std::sqrt(ratio) : 1.0;
    same = same && scale == mass_scale_[j];
    mass_scale_[j] = scale;
  }
  if (same) return;
  for (size_t i = 0; i < mass_.size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    const double scale = mass_scale_[pair.j] * mass_scale_[pair.k];
    mass_[i] = scale * model_->mass[i];
    mass_difference_[i] = scale * model_->mass_difference[i];
  }
}

void SoftBody::Locate(const mjModel* m, const mjData* d) {
  ScaleMass(m);
  kinematics_.Gather(m, d);
}

void SoftBody::AddElasticity(const mjData* d) {
  elasticity_.Evaluate(kinematics_.x().data(), model_->implicit || model_->beta > 0, &force_);
  if (model_->implicit) kinematics_.StiffenTurns(force_, d);
}

void SoftBody::AddDamping(double h) {
  const double rate = model_->implicit ? h + model_->beta : model_->beta;
  const std::vector<Vec3>& v = kinematics_.v();
  // K is blind to a common velocity, but not to the last digit of a stiff K times a fast one
  Vec3 common{};
  for (const Vec3& some : v) common = common + (1.0 / v.size()) * some;
  for (size_t j = 0; j < v.size(); j++) moved_[j] = rate * (v[j] - common);
  elasticity_.SubtractProduct(moved_.data(), force_.data());
  if (model_->alpha == 0) return;
  SubtractMass(mass_, model_->alpha, v.data());
}

// MuJoCo has it for the masses that it knows of.
void SoftBody::AddMassBias(const mjModel* m, const mjData* d) {
  const Vec3* a = model_->has_difference ? kinematics_.BiasAccelerations(m, d) : nullptr;
  if (a) SubtractMass(mass_difference_, 1, a);
}

// force −= scale M u, M by pairs of points.
void SoftBody::SubtractMass(const std::vector<double>& mass, double scale, const Vec3* u) {
  for (size_t i = 0; i < mass.size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    const double some = scale * mass[i];
    force_[pair.j] = force_[pair.j] - some * u[pair.k];
    if (pair.j != pair.k) force_[pair.k] = force_[pair.k] - some * u[pair.j];
  }
}

void SoftBody::StoreInertia(const mjModel* m, mjData* d) {
  const double h = m->opt.timestep;
  for (size_t i = 0; i < mass_.size(); i++) {
    added_mass_[i] = (model_->implicit ? h * model_->alpha * mass_[i] : 0) + mass_difference_[i];
  }
  kinematics_.StoreInertia(elasticity_.StiffnessForInertia(), model_->implicit ? h * (h + model_->beta) : 0,
                           added_mass_.data(), m, d);
}

double SoftBody::KineticEnergy(const mjModel* m, const mjData* d) {
  std::vector<Vec3>& velocity = moved_;  // in the world; AddDamping does not need what it has left there
  for (size_t j = 0; j < velocity.size(); j++) velocity[j] = kinematics_.WorldVelocity(m, d, static_cast<int>(j));
  double energy = 0;
  for (size_t i = 0; i < mass_.size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    energy += (pair.j == pair.k ? 0.5 : 1) * mass_[i] * Dot(velocity[pair.j], velocity[pair.k]);
  }
  return energy;
}

}  // namespace mjframes
