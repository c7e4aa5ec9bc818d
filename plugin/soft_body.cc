#include "soft_body.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "attributes.h"
#include "constants.h"
#include "parse.h"
#include "requirements.h"

namespace mjframes {
namespace {

// Where points show all of how a region turns, and d->M gets K itself.
bool Corrects(const ElasticModel& elastic) {
  return !elastic.enlarges &&
         std::all_of(elastic.regions.begin(), elastic.regions.end(), [](const Region& region) { return region.solid; });
}

}  // namespace

std::unique_ptr<SoftBody> SoftBody::Create(const mjModel* m, int instance) {
  Reader reader(m, instance);
  std::shared_ptr<const SoftModel> model = FindModel(m, instance, &reader);
  if (model) CheckRequirements(m, *model, &reader);
  const ScalingReader scaling(m, instance, model ? model->elastic.factors : 1, &reader);
  if (reader.ok()) return std::unique_ptr<SoftBody>(new SoftBody(m, instance, std::move(model), scaling));
  mju_warning("mjframes: soft body '%s': %s.", m->names + m->name_pluginadr[instance], reader.error().c_str());
  return nullptr;
}

SoftBody::SoftBody(const mjModel* m, int instance, std::shared_ptr<const SoftModel> model, const ScalingReader& scaling)
    : instance_(instance),
      model_(std::move(model)),
      kinematics_(model_->kinematics),
      elasticity_(model_->elastic, kinematics_.pairs()),
      contact_(m, model_->contact, kinematics_),
      scaling_reader_(scaling),
      force_(kinematics_.points().size()),
      moved_(force_.size()),
      mass_scale_(force_.size(), 1.0),
      mass_(model_->mass),
      mass_difference_(model_->mass_difference),
      total_mass_(TotalMass()),
      added_mass_(mass_.size()) {
  if (model_->implicit && !kinematics_.turning() && Corrects(model_->elastic))
    correction_.emplace(&kinematics_, &elasticity_);
}

double SoftBody::TotalMass() const {
  double sum = 0;
  for (size_t i = 0; i < mass_.size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    sum += (pair.j == pair.k ? 1 : 2) * mass_[i];
  }
  return sum;
}

// Masses may be changed in the model at any time. √(s_j s_k) M_jk stays positive definite, and right where s is common.
void SoftBody::ScaleMass(const mjModel* m) {
  bool same = true;
  for (size_t j = 0; j < mass_scale_.size(); j++) {
    const ControlPoint& point = kinematics_.points()[j];
    double ratio = m->body_mass[point.body] / point.carried;
    if (!(ratio > 0 && std::isfinite(ratio))) {
      if (!told_mass_) {
        mju_warning("mjframes: body '%s' has a mass of %g kg, which must be positive: the soft body keeps %g kg there.",
                    m->names + m->name_bodyadr[point.body], m->body_mass[point.body], point.carried);
      }
      told_mass_ = true;
      ratio = 1;
    }
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
  total_mass_ = TotalMass();
}

void SoftBody::Locate(const mjModel* m, const mjData* d) {
  ScaleMass(m);
  elasticity_.Scale(scaling_reader_.Read(m).stiffness);
  kinematics_.Gather(m, d);
}

void SoftBody::AddElasticity(const mjData* d) {
  elasticity_.Evaluate(kinematics_.x().data(), model_->implicit || model_->beta > 0, &force_);
  if (correction_) correction_->Start(force_);
  if (model_->implicit) kinematics_.StiffenTurns(force_, d);
}

void SoftBody::AddDamping(double h) {
  const double beta = scaling().beta * model_->beta, rate = model_->implicit ? h + beta : beta;
  const std::vector<Vec3>& v = kinematics_.v();
  // K is blind to a common velocity, but not to the last digit of a stiff K times a fast one
  Vec3 common{};
  for (const Vec3& some : v) common = common + (1.0 / v.size()) * some;
  for (size_t j = 0; j < v.size(); j++) moved_[j] = rate * (v[j] - common);
  elasticity_.SubtractProduct(moved_.data(), force_.data());
  if (model_->alpha == 0) return;
  SubtractMass(mass_, scaling().alpha * model_->alpha, v.data());
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

void SoftBody::StoreInertia(const mjModel* m, mjData* d, bool consistent) {
  const double h = m->opt.timestep, alpha = scaling().alpha * model_->alpha, beta = scaling().beta * model_->beta;
  const double firmness = correction_ ? correction_->firmness() : 0;
  for (size_t i = 0; i < mass_.size(); i++) {
    added_mass_[i] = model_->implicit ? h * alpha * mass_[i] : 0;
    if (consistent) added_mass_[i] += mass_difference_[i];
  }
  kinematics_.StoreInertia(elasticity_.StiffnessForInertia(), model_->implicit ? h * ((1 + firmness) * h + beta) : 0,
                           added_mass_.data(), m, d);
}

bool SoftBody::IsFast(double h, bool constrained) { return correction_ && correction_->IsFast(h, constrained, force_); }

bool SoftBody::Correct(const mjModel* m, mjData* d, const double* a, bool last, bool* firmer) {
  if (!correction_) return false;
  const double firmness = correction_->firmness(), beta = scaling().beta * model_->beta;
  if (!correction_->Improve(m->opt.timestep, beta, mass_, a, last, &force_)) return false;
  *firmer = *firmer || correction_->firmness() != firmness;
  kinematics_.StoreForce(force_, d);
  return true;
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
