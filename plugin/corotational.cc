#include "corotational.h"

#include <algorithm>

#include "hessian.h"
#include "rotation.h"

namespace mjframes {
namespace {

// F += a bᵀ
void AddOuter(const Vec3& a, const Vec3& b, Mat3* F) {
  for (int e = 0; e < 9; e++) (*F)[e] += a[e / 3] * b[e % 3];
}

// Σ_j x_j g_jᵀ
Mat3 GradientOf(const Region& region, const Vec3* x, const std::vector<Vec3>& g) {
  Mat3 F{};
  for (int j = 0; j < region.size(); j++) AddOuter(x[region.point[j]], g[j], &F);
  return F;
}

// θ, for R₀ᵀ and the region's own F.
double Trust(const Region& region, const Vec3* x, const Mat3& back, const Mat3& F) {
  double least = std::min(kAgreeing, SmallestEigenvalue(Mul(back, F)));
  int j = 0;
  for (const int32_t end : region.frame_end) {
    Mat3 of_frame{};
    for (; j < end; j++) AddOuter(x[region.point[j]], region.own[j], &of_frame);
    least = std::min(least, SmallestEigenvalue(Mul(back, of_frame)));
  }
  return TrustOf(least);
}

RegionBatch BatchOf(const std::vector<const Region*>& regions) {
  RegionBatch batch;
  const int m = batch.size = regions.front()->size();
  const size_t blocks = static_cast<size_t>(m) * (m + 1) / 2;
  batch.point.assign(kWideLanes * static_cast<size_t>(m), 0);
  batch.present.assign(kWideLanes * static_cast<size_t>(m), 0);
  batch.shows = batch.present;
  batch.rest.assign(kWideLanes * 3 * static_cast<size_t>(m), 0);
  batch.gradient = batch.rest;
  if (std::any_of(regions.begin(), regions.end(), [](const Region* region) { return !region->fallback.empty(); })) {
    batch.fallback = batch.own = batch.rest;
    batch.ends = batch.present;
  }
  batch.moduli.stiffness.assign(kWideLanes * 9 * blocks, 0);
  batch.pair.assign(kWideLanes * blocks, -1);
  batch.law = regions.front()->law;
  batch.cells = 0;
  for (const Region* region : regions) batch.cells = std::max(batch.cells, static_cast<int>(region->cells.size()));
  batch.volume.assign(kWideLanes * static_cast<size_t>(batch.cells), 0);
  batch.moduli.material.assign(batch.volume.size(), LawParameters{});
  batch.slope.assign(27 * static_cast<size_t>(m) * batch.volume.size(), 0);
  for (int lane = 0; lane < kWideLanes; lane++) {
    // lanes without a region have the last one's shape, without its stiffness
    const bool filled = lane < static_cast<int>(regions.size());
    const Region& region = filled ? *regions[lane] : *regions.back();
    batch.sizes[lane / kLanes] = std::max(batch.sizes[lane / kLanes], region.size());
    batch.inverse_size[lane] = 1.0 / region.size();
    batch.enlargement[lane] = region.enlargement;
    batch.falls_back[lane] = !region.fallback.empty();
    for (int j = 0, block = 0; j < region.size(); j++) {
      batch.point[kWideLanes * j + lane] = region.point[j];
      batch.present[kWideLanes * j + lane] = 1;
      batch.shows[kWideLanes * j + lane] = j < region.shows;
      for (int r = 0; r < 3; r++) {
        batch.rest[kWideLanes * (3 * j + r) + lane] = region.rest[j][r];
        batch.gradient[kWideLanes * (3 * j + r) + lane] = region.gradient[j][r];
      }
      for (int r = 0; r < 3 && !region.fallback.empty(); r++) {
        batch.fallback[kWideLanes * (3 * j + r) + lane] = region.fallback[j][r];
        batch.own[kWideLanes * (3 * j + r) + lane] = region.own[j][r];
      }
      for (int k = 0; filled && k <= j; k++, block++) batch.pair[kWideLanes * block + lane] = region.pair[block];
    }
    if (filled) {
      batch.region.push_back(region.number);
      FillLane(region, region.stiffness.data(), nullptr, lane, &batch.moduli);
    }
    for (size_t q = 0; filled && q < region.cells.size(); q++) {
      const Cell& cell = region.cells[q];
      batch.volume[kWideLanes * q + lane] = cell.volume;
      for (int j = 0; j < region.size(); j++) {
        double* slope = batch.slope.data() + kWideLanes * 27 * (q * m + j) + lane;
        for (int e = 0; e < 27; e++) slope[kWideLanes * e] = cell.slope[3 * (e / 3 * region.size() + j) + e % 3];
      }
    }
    for (const int32_t end : region.frame_end) batch.ends[kWideLanes * (end - 1) + lane] = 1;
  }
  return batch;
}

}  // namespace

void FillLane(const Region& region, const double* stiffness, const double* factors, int lane,
              RegionBatch::Moduli* moduli) {
  const size_t width = 3 * static_cast<size_t>(region.size());
  size_t entry = 0;
  for (int j = 0; j < region.size(); j++) {
    for (int k = 0; k <= j; k++) {
      for (int e = 0; e < 9; e++, entry++) {
        moduli->stiffness[kWideLanes * entry + lane] = stiffness[(3 * j + e / 3) * width + 3 * k + e % 3];
      }
    }
  }
  for (size_t q = 0; q < region.cells.size(); q++) {
    const Cell& cell = region.cells[q];
    moduli->material[kWideLanes * q + lane] = factors ? Scaled(cell.material, factors[cell.factor]) : cell.material;
  }
}

Mat3 RegionRotation(const Region& region, const Vec3* x, const Mat3& guess) {
  Mat3 F = GradientOf(region, x, region.gradient);
  const Mat3 R = ClosestRotation(F, guess);
  if (region.fallback.empty()) return R;
  const double theta = Trust(region, x, Transpose(R), F);
  if (theta == 1) return R;
  const Mat3 parents = GradientOf(region, x, region.fallback);
  for (int e = 0; e < 9; e++) F[e] = theta * F[e] + (1 - theta) * parents[e];
  return ClosestRotation(F, R);
}

double RegionEnergy(const Region& region, const Vec3* x, const Mat3& R, const double* stiffness,
                    const double* factors) {
  const int m = region.size();
  Vec3 mean{};
  for (int j = 0; j < m; j++) mean = mean + (1.0 / m) * x[region.point[j]];
  const auto strain = [&](int j) { return MulT(R, x[region.point[j]] - mean) - region.rest[j]; };
  double energy = 0;
  for (int j = 0; j < m; j++) {
    const Vec3 yj = strain(j);
    Vec3 w{};
    for (int k = 0; k < m; k++) {
      const Vec3 yk = strain(k);
      for (int r = 0; r < 3; r++) {
        const double* row = stiffness + 3 * (static_cast<size_t>(3 * j + r) * m + k);
        w[r] += row[0] * yk[0] + row[1] * yk[1] + row[2] * yk[2];
      }
    }
    energy += 0.5 * Dot(yj, w);
  }
  for (const Cell& cell : region.cells) {
    Mat3 F = kIdentity;
    for (int j = 0; j < m; j++) {
      const Vec3 yj = strain(j);
      for (int e = 0; e < 9; e++) {
        const double* row = cell.slope.data() + 3 * (static_cast<size_t>(e) * m + j);
        F[e] += row[0] * yj[0] + row[1] * yj[1] + row[2] * yj[2];
      }
    }
    const Invariants<double> is = InvariantsOf(F.data());
    const double factor = factors ? factors[cell.factor] : 1;
    energy += cell.volume * factor * EnergyDensity(region.law, cell.material, is.i1, is.i2, is.j);
  }
  return energy;
}

BatchScratch::BatchScratch(const std::vector<RegionBatch>& batches) {
  size_t points = 0;
  for (const RegionBatch& batch : batches) {
    points = std::max(points, static_cast<size_t>(batch.size));
    curved.resize(std::max(curved.size(), batch.slope.size()));
  }
  const size_t lanes = kWideLanes * points;
  z.resize(3 * lanes);
  gradient.resize(3 * lanes);
  h.resize(3 * lanes);
  product.resize(12 * lanes);
  g.resize(9 * lanes);
}

std::vector<RegionBatch> BatchesOf(const std::vector<Region>& regions) {
  std::vector<const Region*> order;
  for (const Region& region : regions) order.push_back(&region);
  std::stable_sort(order.begin(), order.end(), [](const Region* a, const Region* b) {
    return a->size() != b->size() ? a->size() > b->size() : a->point < b->point;
  });
  std::vector<RegionBatch> batches;
  for (size_t e = 0; e < order.size(); e += kWideLanes) {
    const size_t end = std::min(e + kWideLanes, order.size());
    batches.push_back(BatchOf({order.begin() + e, order.begin() + end}));
  }
  return batches;
}

}  // namespace mjframes
