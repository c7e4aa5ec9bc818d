#include "elasticity.h"

#include <algorithm>

#include "simd.h"

namespace mjframes {

Elasticity::Elasticity(const ElasticModel& model, const std::vector<PointPair>& pairs)
    : model_(model),
      pairs_(pairs),
      batch_scratch_(model.batches),
      quadrature_scratch_(model.quadrature),
      scaled_(model.factors, 1.0),
      stiffness_(9 * pairs.size()),
      enlarged_(model.enlarges ? 9 * pairs.size() : 0) {
  rotation_.resize(model.regions.size());
  if (model.factors == 1) return;
  for (const RegionBatch& batch : model.batches) moduli_.push_back(batch.moduli);
  size_t most = 0;
  for (const Region& region : model.regions) most = std::max(most, region.stiffness.size());
  matrix_.resize(most);
  rows_.resize(most);
}

const double* Elasticity::ScaledStiffness(const Region& region) {
  if (!apart_) return region.stiffness.data();
  ScaleStiffness(region.stiffness, 3 * region.size(), region.shares, scaled_, rows_.data(), matrix_.data());
  return matrix_.data();
}

void Elasticity::Scale(const std::vector<double>& factors) {
  apart_ = std::any_of(factors.begin(), factors.end(), [&](double s) { return s != factors.front(); });
  factor_ = apart_ ? 1 : factors.front();
  if (!apart_) {  // only what is computed at quadrature points has no copy beside
    if (model_.quadrature.empty() || std::count(scaled_.begin(), scaled_.end(), 1.0) == model_.factors) return;
    std::fill(scaled_.begin(), scaled_.end(), 1.0);
  } else {
    if (factors == scaled_) return;
    std::copy(factors.begin(), factors.end(), scaled_.begin());
  }
  quadrature_scratch_.Scale(model_.quadrature, scaled_);
  for (size_t b = 0; b < moduli_.size(); b++) {
    const std::vector<int>& regions = model_.batches[b].region;
    for (size_t lane = 0; lane < regions.size(); lane++) {
      const Region& region = model_.regions[regions[lane]];
      FillLane(region, ScaledStiffness(region), scaled_.data(), static_cast<int>(lane), &moduli_[b]);
    }
  }
}

void Elasticity::Evaluate(const Vec3* x, bool stiffness, std::vector<Vec3>* force) {
  std::fill(force->begin(), force->end(), Vec3{});
  std::fill(stiffness_.begin(), stiffness_.end(), 0.0);
  std::fill(enlarged_.begin(), enlarged_.end(), 0.0);
  double* K = stiffness ? stiffness_.data() : nullptr;
  AddRegions(x,
             {.force = force->data(), .stiffness = K, .enlarged = K && model_.enlarges ? enlarged_.data() : nullptr});
  AddQuadrature(model_.quadrature, x, &quadrature_scratch_, force->data(), K);
  if (!model_.quadrature.empty() && !enlarged_.empty()) {
    std::transform(stiffness_.begin(), stiffness_.end(), enlarged_.begin(),
                   [this](double k) { return model_.enlargement * k; });
  }
  if (factor_ == 1) return;
  for (Vec3& f : *force) f = factor_ * f;
  for (double& k : stiffness_) k *= factor_;
  for (double& k : enlarged_) k *= factor_;
}

void Elasticity::SubtractProduct(const Vec3* __restrict u, Vec3* __restrict force) const {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    const double* K = stiffness_.data();
    int at = 0;
    Vec3 sum{};
    for (const PointPair& pair : pairs_) {
      const int j = pair.j, k = pair.k;
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
  });
}

void Elasticity::EvaluateAhead(const Vec3* x, const Vec3* ahead, std::vector<Vec3>* force) {
  std::fill(force->begin(), force->end(), Vec3{});
  AddRegions(x, {.force = force->data(), .ahead = ahead});
  if (!model_.quadrature.empty()) {
    AddQuadrature(model_.quadrature, ahead, &quadrature_scratch_, force->data(), nullptr);
    TakeTorque(x, force);
  }
  for (Vec3& f : *force) f = factor_ * f;
}

double Elasticity::Energy(const Vec3* x) {
  double energy = 0;
  AddRegions(x, {.energy = &energy});
  for (size_t e = 0; e < model_.quadrature.size(); e++) {
    energy += QuadratureEnergy(model_.quadrature, e, x, &quadrature_scratch_);
  }
  return factor_ * energy;
}

const std::vector<Mat3>& Elasticity::Rotations(const Vec3* x) {
  AddRegions(x, {.rotation = rotation_.data()});
  return rotation_;
}

void Elasticity::AddRegions(const Vec3* x, const Wanted& wanted) {
  AddBatches(model_.batches, apart_ ? moduli_.data() : nullptr, x, &batch_scratch_, wanted);
}

const Region& Elasticity::FindRegion(int number) const {
  return *std::find_if(model_.regions.begin(), model_.regions.end(),
                       [number](const Region& r) { return r.number == number; });
}

}  // namespace mjframes
