#include "corotational.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

namespace mjframes {
namespace {

using StrainMatrix = std::array<double, kStrains * kStrains>;

// S_s x, S_s of pressed.h
Vec3 Strained(int s, const Vec3& x) {
  Vec3 y{};
  const int a = s % 3, b = (s + 1) % 3;
  if (s < 3) {
    y[a] = x[a];
  } else {
    y[a] = kSqrtHalf * x[b];
    y[b] = kSqrtHalf * x[a];
  }
  return y;
}

// C of pressed.h: yᵀ K_e y of each two uniform strains y_j = S_s x̄_j [J].
StrainMatrix UniformEnergy(const Region& region, const double* stiffness) {
  const int m = region.size();
  StrainMatrix energy{};
  for (int s = 0; s < kStrains; s++) {
    const double* K = stiffness;
    for (int j = 0; j < m; j++) {
      Vec3 force{};
      for (double& component : force) {
        for (int k = 0; k < m; k++, K += 3) component += Dot(ToVec3(K), Strained(s, region.rest[k]));
      }
      for (int t = 0; t < kStrains; t++) energy[kStrains * t + s] += Dot(Strained(t, region.rest[j]), force);
    }
  }
  return energy;
}

// Its eigenvalue on the strain that changes the volume alone.
double Dilation(const StrainMatrix& energy) {
  double sum = 0;
  for (int s = 0; s < 3; s++) {
    for (int t = 0; t < 3; t++) sum += energy[kStrains * s + t];
  }
  return std::max(0.0, sum / 3);
}

// The mean of its eigenvalues on the five that change a region's shape and not its volume.
double Shear(const StrainMatrix& energy) {
  double trace = 0;
  for (int s = 0; s < kStrains; s++) trace += energy[(kStrains + 1) * s];
  return std::max(0.0, (trace - Dilation(energy)) / (kStrains - 1));
}

// energy⁻¹, or nothing where a strain costs nothing.
std::optional<StrainMatrix> InverseOf(StrainMatrix energy) {
  StrainMatrix inverse{};
  for (int s = 0; s < kStrains; s++) inverse[(kStrains + 1) * s] = 1;
  const double least = kSingular * *std::max_element(energy.begin(), energy.end());
  for (int k = 0; k < kStrains; k++) {
    const double pivot = energy[(kStrains + 1) * k];
    if (!(pivot > least)) return std::nullopt;
    for (int n = 0; n < kStrains; n++) {
      energy[kStrains * k + n] /= pivot;
      inverse[kStrains * k + n] /= pivot;
    }
    for (int i = 0; i < kStrains; i++) {
      const double share = energy[kStrains * i + k];
      if (i == k) continue;
      for (int n = 0; n < kStrains; n++) {
        energy[kStrains * i + n] -= share * energy[kStrains * k + n];
        inverse[kStrains * i + n] -= share * inverse[kStrains * k + n];
      }
    }
  }
  return inverse;
}

// The mean stiffness of the cells against shear, as `Shear` has it [J].
double ShearOfCells(const Region& region, const double* factors) {
  double sum = 0;
  for (const Cell& cell : region.cells) {
    const double shear = 2 * (Respond(region.law, cell.material, 3).slope + cell.material.second);
    sum += 2 * cell.volume * shear * (factors ? factors[cell.factor] : 1);
  }
  return sum;
}

// What a lane has of pressed.h.
void FillPressed(const Region& region, const StrainMatrix& energy, int lane, RegionBatch::Moduli* moduli) {
  const std::optional<StrainMatrix> compliance = region.stiffens && region.solid ? InverseOf(energy) : std::nullopt;
  // a uniform strain has (3 λ + 2 μ) V on dilations and 2 μ V on shears
  const double mu = 0.5 * Shear(energy), lame = std::max(0.0, (Dilation(energy) - 2 * mu) / 3);
  moduli->pressed[lane] = compliance && lame > 0 ? mu * lame / (lame + mu) : 0;
  if (!compliance) return;
  for (int n = 0; n < kStrains * kStrains; n++) moduli->compliance[kWideLanes * n + lane] = (*compliance)[n];
}

RegionBatch BatchOf(const std::vector<const Region*>& regions) {
  RegionBatch batch;
  const int m = batch.size = regions.front()->size();
  const size_t blocks = static_cast<size_t>(m) * (m + 1) / 2;
  batch.point.assign(kWideLanes * static_cast<size_t>(m), 0);
  batch.present.assign(kWideLanes * static_cast<size_t>(m), 0);
  batch.rest.assign(kWideLanes * 3 * static_cast<size_t>(m), 0);
  batch.gradient = batch.rest;
  batch.moduli.stiffness.assign(kWideLanes * 9 * blocks, 0);
  batch.pair.assign(kWideLanes * blocks, -1);
  batch.law = regions.front()->law;
  batch.cells = 0;
  for (const Region* region : regions) batch.cells = std::max(batch.cells, static_cast<int>(region->cells.size()));
  batch.volume.assign(kWideLanes * static_cast<size_t>(batch.cells), 0);
  batch.moduli.material.assign(batch.volume.size(), LawParameters{});
  batch.moduli.compliance.assign(kWideLanes * kStrains * kStrains, 0);
  batch.moduli.pressed.assign(kWideLanes, 0);
  batch.slope.assign(27 * static_cast<size_t>(m) * batch.volume.size(), 0);
  for (int lane = 0; lane < kWideLanes; lane++) {
    // lanes without a region have the last one's shape, without its stiffness
    const bool filled = lane < static_cast<int>(regions.size());
    const Region& region = filled ? *regions[lane] : *regions.back();
    batch.sizes[lane / kLanes] = std::max(batch.sizes[lane / kLanes], region.size());
    batch.inverse_size[lane] = 1.0 / region.size();
    batch.enlargement[lane] = region.enlargement;
    batch.solid[lane] = region.solid;
    batch.celled[lane] = !region.cells.empty();
    for (int j = 0, block = 0; j < region.size(); j++) {
      batch.point[kWideLanes * j + lane] = region.point[j];
      batch.present[kWideLanes * j + lane] = 1;
      for (int r = 0; r < 3; r++) {
        batch.rest[kWideLanes * (3 * j + r) + lane] = region.rest[j][r];
        batch.gradient[kWideLanes * (3 * j + r) + lane] = region.gradient[j][r];
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
  }
  return batch;
}

}  // namespace

void FillLane(const Region& region, const double* stiffness, const double* factors, int lane,
              RegionBatch::Moduli* moduli) {
  const size_t width = 3 * static_cast<size_t>(region.size());
  const StrainMatrix uniform = UniformEnergy(region, stiffness);
  const double twist = 0.5 * kTwistFirmness * (Shear(uniform) + ShearOfCells(region, factors));
  FillPressed(region, uniform, lane, moduli);
  size_t entry = 0;
  for (int j = 0; j < region.size(); j++) {
    for (int k = 0; k <= j; k++) {
      const Vec3 &gj = region.gradient[j], &gk = region.gradient[k];
      const double dot = Dot(gj, gk);
      for (int e = 0; e < 9; e++, entry++) {
        const double skew = (e % 4 == 0 ? dot : 0) - gj[e % 3] * gk[e / 3];
        moduli->stiffness[kWideLanes * entry + lane] =
            stiffness[(3 * j + e / 3) * width + 3 * k + e % 3] + twist * skew;
      }
    }
  }
  for (size_t q = 0; q < region.cells.size(); q++) {
    const Cell& cell = region.cells[q];
    moduli->material[kWideLanes * q + lane] = factors ? Scaled(cell.material, factors[cell.factor]) : cell.material;
  }
}

BatchScratch::BatchScratch(const std::vector<RegionBatch>& batches) {
  size_t points = 0, cells = 0;
  for (const RegionBatch& batch : batches) {
    points = std::max(points, static_cast<size_t>(batch.size));
    cells = std::max(cells, static_cast<size_t>(batch.cells));
    curved.resize(std::max(curved.size(), batch.slope.size()));
  }
  const size_t lanes = kWideLanes * points;
  z.resize(3 * lanes);
  before.resize(3 * lanes);
  start.resize(3 * lanes);
  moment.resize(27 * lanes);
  product.resize(12 * lanes);
  follow.resize(18 * lanes);
  stress.resize(9 * kWideLanes * cells);
  turn.cells.resize((cells + kLanes - 1) / kLanes);
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
