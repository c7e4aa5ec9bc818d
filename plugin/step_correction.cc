#include "step_correction.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "constants.h"

namespace mjframes {
namespace {

constexpr double kNone = std::numeric_limits<double>::infinity();

// The root of the mean squared distance of the points from their middle, at rest.
double Extent(const std::vector<ControlPoint>& points) {
  Vec3 middle{};
  double sum = 0;
  for (const ControlPoint& point : points) middle = middle + (1.0 / points.size()) * point.rest;
  for (const ControlPoint& point : points) sum += Dot(point.rest - middle, point.rest - middle);
  return std::sqrt(sum / points.size());
}

// Takes their mean from all.
void Centre(std::vector<Vec3>* all) {
  Vec3 mean{};
  for (const Vec3& some : *all) mean = mean + (1.0 / all->size()) * some;
  for (Vec3& some : *all) some = some - mean;
}

}  // namespace

StepCorrection::StepCorrection(Kinematics* kinematics, Elasticity* elasticity)
    : kinematics_(kinematics),
      elasticity_(elasticity),
      extent_(Extent(kinematics->points())),
      elastic_(kinematics->points().size()),
      now_{elastic_, 0, kNone},
      best_(now_),
      kick_(elastic_),
      move_(elastic_),
      ahead_(elastic_),
      force_(elastic_),
      next_(elastic_),
      damped_(elastic_) {}

void StepCorrection::Start(const std::vector<Vec3>& elastic) {
  elastic_ = elastic;
  std::fill(now_.force.begin(), now_.force.end(), Vec3{});
  now_.firmness = 0;
  now_.made = best_.made = kNone;
  settled_ = false;
}

bool StepCorrection::IsFar(const std::vector<Vec3>& moved) const {
  const double far = kFastStep * extent_;
  return std::any_of(moved.begin(), moved.end(), [far](const Vec3& some) { return Dot(some, some) > far * far; });
}

bool StepCorrection::IsFast(double h, bool constrained, const std::vector<Vec3>& force) {
  for (size_t j = 0; j < move_.size(); j++) {  // as an explicit step
    move_[j] = h * kinematics_->v()[j] + (h * h / kinematics_->points()[j].mass) * force[j];
  }
  if (!constrained) Centre(&move_);
  return IsFar(move_);
}

// Of `kick_` and `move_`; to the elastic and kinetic energy there is.
double StepCorrection::GainOf(double h, double beta, const std::vector<double>& mass) {
  const std::vector<Vec3>& x = kinematics_->x();
  double kinetic = 0, work = 0;
  for (size_t j = 0; j < x.size(); j++) {
    ahead_[j] = x[j] + move_[j];
    damped_[j] = (1 + now_.firmness + beta / h) * move_[j];
    force_[j] = elastic_[j] + now_.force[j];
  }
  elasticity_->SubtractProduct(damped_.data(), force_.data());
  for (size_t j = 0; j < x.size(); j++) work += Dot(force_[j], move_[j] - (0.5 * h) * kick_[j]);
  for (size_t i = 0; i < mass.size(); i++) {
    const PointPair& pair = kinematics_->pairs()[i];
    kinetic += (pair.j == pair.k ? 0.5 : 1) * mass[i] * Dot(move_[pair.j], move_[pair.k]) / (h * h);
  }
  if (best_.made == kNone) energy_ = elasticity_->Energy(x.data());  // of all looks at a step
  return (elasticity_->Energy(ahead_.data()) - energy_ + work) / (energy_ + kinetic);
}

// next = f̂ − f + K δ
void StepCorrection::AimAtEnd() {
  elasticity_->EvaluateAhead(kinematics_->x().data(), ahead_.data(), &next_);
  for (size_t j = 0; j < next_.size(); j++) {
    next_[j] = next_[j] - elastic_[j];
    damped_[j] = -1 * move_[j];
  }
  elasticity_->SubtractProduct(damped_.data(), next_.data());
}

bool StepCorrection::Improve(double h, double beta, const std::vector<double>& mass, const double* a, bool last,
                             std::vector<Vec3>* change) {
  if (settled_) return false;
  const std::vector<Vec3>& v = kinematics_->v();
  kinematics_->Slide(a, &kick_);
  for (size_t j = 0; j < v.size(); j++) {
    kick_[j] = h * kick_[j];
    move_[j] = h * (v[j] + kick_[j]);
  }
  Centre(&move_);
  if (!IsFar(move_)) return false;
  const double made = GainOf(h, beta, mass);
  if (!(made > kMadeEnergy)) return false;
  const bool best = made < best_.made;
  if (best) {
    best_ = now_;
    best_.made = made;
  }
  double firmness = now_.firmness;
  settled_ = last;
  if (last) {
    if (best) return false;
    next_ = best_.force;
    firmness = best_.firmness;
  } else if (made < now_.made) {
    if (made > kBetterStep * now_.made) firmness = kDampMore * firmness + 1;
    AimAtEnd();
    for (Vec3& some : next_) some = (1 + firmness) * some;
    now_.made = made;
  } else {
    firmness = kDampMore * firmness + 1;
    std::fill(next_.begin(), next_.end(), Vec3{});
    now_.made = kNone;
  }
  for (size_t j = 0; j < v.size(); j++) {  // what is new of c and s
    (*change)[j] = next_[j] - now_.force[j];
    damped_[j] = (firmness - now_.firmness) * h * v[j];
  }
  if (firmness != now_.firmness) {
    Centre(&damped_);
    elasticity_->SubtractProduct(damped_.data(), change->data());
  }
  now_.force = next_;
  now_.firmness = firmness;
  return true;
}

}  // namespace mjframes
