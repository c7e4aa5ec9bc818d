#include "soft.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <string>

#include "options.h"
#include "patch_field.h"
#include "reader.h"
#include "touch.h"

namespace mjframes {
namespace {

constexpr double kSameMass = 1e-4;  // [-] of a body's mass: the model's masses have six digits

constexpr const char* kAttributes[] = {
    "version",  //
    "law",
    "mode",
    "alpha",
    "beta",
    "carrier_size",   // number of points that ride on each of the instance's bodies
    "carrier_point",  // which ones, body by body    (k)
    "point_offset",   // in the body's axes [m]      (k × 3)
    "point_rest",     // [m]                         (k × 3)
    "point_mass",     // [kg]                        (k)
    "point_branch",   // of the tree                 (k)
    "region_size",
    "region_point",
    "region_gradient",
    "region_fallback",
    "frame_size",
    "frame_gradient",  // of each frame's own points [1/m]  (k × 3)
    "region_stiffness",
    "law_constants",      // of each material            (materials × 3)
    "quadrature_count",   // of each region
    "quadrature_volume",  // [m³]
    "quadrature_material",
    "quadrature_gradient",  // ∇W_j, point by point [1/m]
    "cell_count",           // of each region
    "cell_volume",          // [m³]
    "cell_material",
    "cell_slope",   // E_q, cell by cell [1/m]
    "region_mass",  // consistent minus lumped mass, lower triangles [kg]
    "region_enlargement",
    "contact_radius",  // [m]
    "patch_size",
    "patch_clusters",
    "patch_cluster_size",
    "patch_point",
    "patch_weight",
    "patch_offset",     // s − Σ_j W_j(s) x̄_j [m]; left out where it is zero
    "lattice_spacing",  // [m]
    "lattice_axes",
    "lattice_origin",
    "lattice_shape",
    "lattice_node",
    "lattice_distance",
    "lattice_patch",
    "lattice_count",
    "lattice_point",
    "lattice_weight",
    "lattice_sphere",
    "asset",  // which built body it is: views of material points ask for its voxels
};

int g_slot = -1;  // of this plugin in MuJoCo's registry; written once, at load

// The kinematic trees whose inertia this plugin's instances change.
std::vector<bool> ChangedTrees(const mjModel* m, int slot) {
  std::vector<bool> changed(m->ntree, false);
  for (int body = 1; body < m->nbody; body++) {
    const int instance = m->body_plugin[body], tree = m->body_treeid[body];
    if (instance >= 0 && tree >= 0 && m->plugin[instance] == slot && ChangesInertia(m, instance)) changed[tree] = true;
  }
  return changed;
}

// force −= K u, K by pairs of points. Neighbours among the pairs share their first point.
void SubtractProduct(const std::vector<PointPair>& pairs, const double* __restrict K, const Vec3* __restrict u,
                     Vec3* __restrict force) {
  int at = 0;
  Vec3 sum{};
  for (const auto& [j, k, node_pair, flip] : pairs) {
    if (j != at) {
      force[at] = force[at] - sum;
      sum = {};
      at = j;
    }
    const Vec3 uj = u[j], uk = u[k];
    for (int r = 0; r < 3; r++) sum[r] += K[3 * r] * uk[0] + K[3 * r + 1] * uk[1] + K[3 * r + 2] * uk[2];
    if (j != k) {
      for (int r = 0; r < 3; r++) force[k][r] -= K[r] * uj[0] + K[3 + r] * uj[1] + K[6 + r] * uj[2];
    }
    K += 9;
  }
  force[at] = force[at] - sum;
}

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

}  // namespace

std::unique_ptr<SoftBody> SoftBody::Create(const mjModel* m, int instance) {
  Reader reader(m, instance);
  std::unique_ptr<SoftBody> body(new SoftBody());
  body->model_ = SoftModel::Find(m, instance, &reader);
  if (body->model_) body->Start(m, instance, &reader);
  if (!reader.ok()) {
    mju_warning("mjframes: soft body '%s': %s.", m->names + m->name_pluginadr[instance], reader.error().c_str());
    return nullptr;
  }
  return body;
}

void SoftBody::Start(const mjModel* m, int instance, Reader* reader) {
  changes_inertia_ = ChangesInertia(m, instance);
  if (const char* wrong = WrongOption(m, model_->implicit, changes_inertia_)) reader->Fail(wrong);
  kinematics_ = model_->kinematics;
  reader->Check(
      !(m->opt.enableflags & mjENBL_SLEEP) || !kinematics_.MissesWaking(m),
      "it is attached to bodies of several kinematic trees, or to a mocap body, and MuJoCo would not wake one "
      "with the other: give the root body of each tree sleep=\"never\", or disable sleep");
  if (!model_->patches.empty()) {
    CheckHeightFields(m, model_->patches.front().geom, reader);
    CheckFlexes(m, model_->patches.front().geom, reader);
    for (size_t i = 0; i < model_->patches.size(); i++) {
      states_.push_back(std::make_unique<PatchState>(*this, static_cast<int>(i)));
    }
    meshes_ = FindCollisionMeshes(m);
  }
  const int slot = m->plugin[instance];
  starts_inertia_ = changes_inertia_;
  bool factors = changes_inertia_;
  last_ = true;
  for (int other = 0; other < m->nplugin; other++) {
    if (m->plugin[other] != slot || other == instance) continue;
    if (other > instance) last_ = false;
    if (!ChangesInertia(m, other)) continue;
    (other < instance ? starts_inertia_ : factors) = false;
  }
  if (factors) factor_ = std::make_unique<InertiaFactor>(m, ChangedTrees(m, slot));
  const size_t pairs = kinematics_.pairs().size();
  force_.resize(kinematics_.points().size());
  velocity_.resize(force_.size());
  moved_.resize(force_.size());
  stiffness_.resize(9 * pairs);
  added_mass_.resize(pairs);
  if (model_->enlarges) held_.resize(9 * pairs);
  quadrature_scratch_ = std::make_unique<QuadratureScratch>(model_->quadrature);
  batch_scratch_ = std::make_unique<BatchScratch>(model_->batches);
  if (last_) contact_scratch_ = std::make_unique<ContactScratch>(m);
  mass_ = model_->mass;
  mass_difference_ = model_->mass_difference;
  mass_scale_.resize(kinematics_.points().size(), 1.0);
}

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

int SoftBody::FindPatch(int geom) const {
  // patches are in the order of their geoms
  const auto found = std::lower_bound(model_->patches.begin(), model_->patches.end(), geom,
                                      [](const Patch& patch, int value) { return patch.geom < value; });
  return found != model_->patches.end() && found->geom == geom ? static_cast<int>(found - model_->patches.begin()) : -1;
}

void SoftBody::Compute(const mjModel* m, mjData* d) {
  const bool awake = !kinematics_.Asleep(m, d);
  if (awake) {
    ScaleMass(m);
    kinematics_.Gather(m, d);
    AddElasticity();
    if (model_->implicit) kinematics_.StiffenTurns(force_, d);
    AddDamping(model_->implicit ? m->opt.timestep + model_->beta : model_->beta);
    AddMassBias(m, d);
    kinematics_.StoreForce(force_, d);
  }
  // compute may run again on the same position: start from the rigid inertia each time
  if (starts_inertia_ && AnyAdds(m, d)) mj_makeM(m, d);
  if (changes_inertia_ && awake) StoreInertia(m, d);
  if (factor_) factor_->Factor(m, d);
  if (last_) WriteConstraintRows(m, d, contact_scratch_.get());
}

void SoftBody::CheckOptions(const mjModel* m, const mjData* d) {
  bool touches = false;
  for (int instance = 0; last_ && instance < m->nplugin; instance++) {
    const SoftBody* body = GetSoftBody(m, d, instance);
    if (!body) continue;
    touches = touches || !body->patches().empty();
    const char* wrong = told_ ? nullptr : WrongOption(m, body->model_->implicit, body->changes_inertia_);
    if (!wrong) continue;
    mju_warning("mjframes: soft body '%s': %s.", m->names + m->name_pluginadr[instance], wrong);
    told_ = true;
  }
  if (touches && m->opt.sdf_initpoints < kMaxTouches && !told_few_) {
    mju_warning(
        "mjframes: option sdf_initpoints is %d, and MuJoCo gives a patch of a soft body no more contacts with a "
        "geom: leave it at 40, or at %d at least.",
        m->opt.sdf_initpoints, kMaxTouches);
    told_few_ = true;
  }
}

// Whether an instance adds to d->M what it does not replace.
bool SoftBody::AnyAdds(const mjModel* m, const mjData* d) {
  for (int instance = 0; instance < m->nplugin; instance++) {
    const SoftBody* body = GetSoftBody(m, d, instance);
    if (body && body->changes_inertia_ && !body->kinematics_.replaces()) return true;
  }
  return false;
}

// d->M += Jᵀ ((h² + h β) K + h α M) J, the stiffness of turns, and the part of the mass that MuJoCo does not know of.
void SoftBody::StoreInertia(const mjModel* m, mjData* d) {
  const double h = m->opt.timestep;
  for (size_t i = 0; i < mass_.size(); i++) {
    added_mass_[i] = (model_->implicit ? h * model_->alpha * mass_[i] : 0) + mass_difference_[i];
  }
  kinematics_.StoreInertia(held_.empty() ? stiffness_.data() : held_.data(),
                           model_->implicit ? h * (h + model_->beta) : 0, added_mass_.data(), m, d);
}

void SoftBody::AddElasticity() {
  const bool stiffness = model_->implicit || model_->beta > 0;
  std::fill(force_.begin(), force_.end(), Vec3{});
  std::fill(stiffness_.begin(), stiffness_.end(), 0.0);
  std::fill(held_.begin(), held_.end(), 0.0);
  double* held = held_.empty() ? nullptr : held_.data();
  AddBatches(model_->batches, kinematics_.x().data(), batch_scratch_.get(), force_.data(),
             stiffness ? stiffness_.data() : nullptr, held);
  AddQuadrature(model_->quadrature, kinematics_.x().data(), quadrature_scratch_.get(), force_.data(),
                stiffness ? stiffness_.data() : nullptr);
  if (model_->quadrature.empty() || held_.empty()) return;
  std::transform(stiffness_.begin(), stiffness_.end(), held_.begin(),
                 [this](double k) { return model_->enlargement * k; });
}

// f −= rate K v + α M v; rate: h of the implicit step and Rayleigh's β
void SoftBody::AddDamping(double rate) {
  const std::vector<Vec3>& v = kinematics_.v();
  // K is blind to a common velocity, but not to the last digit of a stiff K times a fast one
  Vec3 common{};
  for (const Vec3& some : v) common = common + (1.0 / v.size()) * some;
  for (size_t j = 0; j < v.size(); j++) moved_[j] = rate * (v[j] - common);
  SubtractProduct(kinematics_.pairs(), stiffness_.data(), moved_.data(), force_.data());
  if (model_->alpha == 0) return;
  for (size_t i = 0; i < kinematics_.pairs().size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    const double drag = model_->alpha * mass_[i];
    force_[pair.j] = force_[pair.j] - drag * v[pair.k];
    if (pair.j != pair.k) force_[pair.k] = force_[pair.k] - drag * v[pair.j];
  }
}

// f −= D dJ/dt qvel, which MuJoCo has for the masses that it knows of
void SoftBody::AddMassBias(const mjModel* m, const mjData* d) {
  const Vec3* a = model_->has_difference ? kinematics_.BiasAccelerations(m, d) : nullptr;
  if (!a) return;
  for (size_t i = 0; i < kinematics_.pairs().size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    const double difference = mass_difference_[i];
    force_[pair.j] = force_[pair.j] - difference * a[pair.k];
    if (pair.j != pair.k) force_[pair.k] = force_[pair.k] - difference * a[pair.j];
  }
}

const Region& SoftBody::FindRegion(int number) const {
  return *std::find_if(model_->regions.begin(), model_->regions.end(),
                       [number](const Region& r) { return r.number == number; });
}

double SoftBody::ElasticEnergy() {
  double energy = 0;
  Mat3 R = kIdentity;  // neighbouring regions turn alike, so each starts its rotation from the one before
  for (const Region& region : model_->regions) {
    R = RegionRotation(region, kinematics_.x().data(), R);
    energy += RegionEnergy(region, kinematics_.x().data(), R);
  }
  for (const QuadratureRegion& region : model_->quadrature) {
    energy += QuadratureEnergy(region, kinematics_.x().data(), quadrature_scratch_.get());
  }
  return energy;
}

double SoftBody::KineticEnergy(const mjModel* m, const mjData* d) {
  ScaleMass(m);
  for (size_t j = 0; j < velocity_.size(); j++) velocity_[j] = kinematics_.WorldVelocity(m, d, static_cast<int>(j));
  double energy = 0;
  for (size_t i = 0; i < mass_.size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    energy += (pair.j == pair.k ? 0.5 : 1) * mass_[i] * Dot(velocity_[pair.j], velocity_[pair.k]);
  }
  return energy;
}

bool IsSoftBody(const mjModel* m, int instance) { return instance >= 0 && m->plugin[instance] == g_slot; }

SoftBody* GetSoftBody(const mjModel* m, const mjData* d, int instance) {
  if (!IsSoftBody(m, instance)) return nullptr;
  return reinterpret_cast<SoftBody*>(d->plugin_data[instance]);
}

int SoftBodyHeldBy(const mjModel* m, int holder) {
  for (int body = holder + 1; body < m->nbody; body++) {
    const int instance = m->body_plugin[body];
    if (m->body_parentid[body] == holder && m->body_jntnum[body] > 0 && IsSoftBody(m, instance)) {
      return instance;
    }
  }
  return -1;
}

void RegisterPlugin() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = kPluginName;
  plugin.capabilityflags = mjPLUGIN_PASSIVE;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.nstate = +[](const mjModel*, int) { return 0; };
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    std::unique_ptr<SoftBody> body = SoftBody::Create(m, instance);
    if (!body) return -1;
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(body.release());
    return 0;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<SoftBody*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum*, void*, int) {};
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int) {
    reinterpret_cast<SoftBody*>(d->plugin_data[instance])->Compute(m, d);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    reinterpret_cast<SoftBody*>(d->plugin_data[instance])->CheckOptions(m, d);
  };
  g_slot = mjp_registerPlugin(&plugin);
}

}  // namespace mjframes
