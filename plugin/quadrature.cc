#include "quadrature.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "hessian.h"
#include "lanes.h"
#include "multiversion.h"

namespace mjframes {
namespace {

constexpr double kLeastVolume = 1e-6;  // [-] least |J| that Cauchy's stress is divided by

MJFRAMES_INLINE double At(const Lanes* a, int entry, int lane) {
  return reinterpret_cast<const double*>(a)[entry * kLanes + lane];
}

// F of four quadrature points.
MJFRAMES_INLINE void Gradient(const double* by_point, const Vec3* x, int m, Lanes* F) {
  for (int e = 0; e < 9; e++) F[e] = Fill(0);
  for (int j = 0; j < m; j++, by_point += 3 * kLanes) {
    const Lanes g[3] = {Load(by_point), Load(by_point + kLanes), Load(by_point + 2 * kLanes)};
    for (int e = 0; e < 9; e++) F[e] += x[j][e / 3] * g[e % 3];
  }
}

MJFRAMES_INLINE Slopes SlopesOf(Law law, const LawParameters* material, const Invariants& is) {
  Slopes of;
  for (int lane = 0; lane < kLanes; lane++) {
    const LawParameters& p = material[lane];
    const Stretch f = Respond(law, p, is.i1[lane]);
    of.f1[lane] = f.slope;
    of.f2[lane] = f.curvature;
    of.second[lane] = p.second;
    of.volume[lane] = p.volume;
    of.g1[lane] = p.volume * (is.j[lane] - 1) - p.linear;
  }
  return of;
}

// Adds V_q P ∇W_j of four quadrature points to force (3 × padded) and, where `products` is given, writes
// V_q (∂P/∂F) ∇W_k, entry (r, a), s at 3 (3r + a) + s, to it (4 × 27 × padded).
MJFRAMES_MULTIVERSION
void FourPoints(const QuadratureRegion& region, int q, const Vec3* x, double* __restrict force,
                double* __restrict products) {
  const int m = region.size(), padded = PadToLanes(m);
  Lanes F[9], P[9];
  Gradient(region.by_point.data() + static_cast<size_t>(q) * 3 * m, x, m, F);
  const Invariants is = InvariantsOf(F);
  const Slopes of = SlopesOf(region.law, region.material.data() + q, is);
  FirstPiola(F, is, of, P);
  const Lanes volume = Load(region.volume.data() + q);
  for (Lanes& p : P) p *= volume;

  const double* gradients = region.by_quadrature.data() + static_cast<size_t>(q) * 3 * padded;
  for (int lane = 0; lane < kLanes; lane++) {
    const double* g = gradients + static_cast<size_t>(lane) * 3 * padded;
    for (int r = 0; r < 3; r++) {
      const double p0 = At(P, 3 * r, lane), p1 = At(P, 3 * r + 1, lane), p2 = At(P, 3 * r + 2, lane);
      for (int j = 0; j < padded; j += kLanes) {
        const Lanes sum = p0 * Load(g + j) + p1 * Load(g + padded + j) + p2 * Load(g + 2 * padded + j);
        Store(Load(force + r * padded + j) + sum, force + r * padded + j);
      }
    }
  }
  if (!products) return;

  Lanes H[81];
  ProjectedHessian(F, of, H);
  for (Lanes& h : H) h *= volume;
  for (int lane = 0; lane < kLanes; lane++) {
    const double* g = gradients + static_cast<size_t>(lane) * 3 * padded;
    double* out = products + static_cast<size_t>(lane) * 27 * padded;
    for (int k = 0; k < padded; k += kLanes) {
      const Lanes g0 = Load(g + k), g1 = Load(g + padded + k), g2 = Load(g + 2 * padded + k);
      for (int n = 0; n < 27; n++) {
        Store(At(H, 3 * n, lane) * g0 + At(H, 3 * n + 1, lane) * g1 + At(H, 3 * n + 2, lane) * g2,
              out + n * padded + k);
      }
    }
  }
}

// Σ_q,a ∂_a W_j product[(r, a), s][k] of four j and four k: tile[3r + s][j][k].
MJFRAMES_MULTIVERSION
void Tile(const double* __restrict gradients, const double* __restrict products, int points, int padded,
          double* __restrict tile) {
  for (int r = 0; r < 3; r++) {
    Lanes sum[12];
    for (Lanes& s : sum) s = Fill(0);
    for (int q = 0; q < points; q++) {
      const double* g = gradients + static_cast<size_t>(q) * 3 * padded;
      const double* t = products + (static_cast<size_t>(q) * 27 + 9 * r) * padded;
      for (int a = 0; a < 3; a++, g += padded, t += 3 * padded) {
        const Lanes t0 = Load(t), t1 = Load(t + padded), t2 = Load(t + 2 * padded);
        for (int j = 0; j < kLanes; j++) {
          sum[j] += g[j] * t0;
          sum[4 + j] += g[j] * t1;
          sum[8 + j] += g[j] * t2;
        }
      }
    }
    for (int n = 0; n < 12; n++) Store(sum[n], tile + (12 * r + n) * kLanes);
  }
}

void Center(const QuadratureRegion& region, const Vec3* x, QuadratureScratch* scratch) {
  // positions far from the origin would cost digits, translations carry no energy
  const int m = region.size();
  Vec3 mean{};
  for (int j = 0; j < m; j++) mean = mean + x[region.point[j]];
  mean = (1.0 / m) * mean;
  for (int j = 0; j < m; j++) scratch->x[j] = x[region.point[j]] - mean;
}

}  // namespace

QuadratureRegion::QuadratureRegion(Law law, std::vector<int32_t> point, const double* gradient, const double* volume,
                                   const LawParameters* material, int q, std::vector<int32_t> pair)
    : law(law), quadrature_points(q), point(std::move(point)), pair(std::move(pair)) {
  const int m = size(), padded = PadToLanes(m), points = PadToLanes(q);
  this->volume.assign(points, 0);
  std::copy_n(volume, q, this->volume.begin());
  this->material.assign(points, LawParameters{});
  std::copy_n(material, q, this->material.begin());
  by_point.assign(static_cast<size_t>(points) * m * 3, 0);
  by_quadrature.assign(static_cast<size_t>(points) * padded * 3, 0);
  for (int n = 0; n < q; n++) {
    for (int j = 0; j < m; j++) {
      for (int a = 0; a < 3; a++) {
        const double g = gradient[(static_cast<size_t>(n) * m + j) * 3 + a];
        by_point[((static_cast<size_t>(n / kLanes) * m + j) * 3 + a) * kLanes + n % kLanes] = g;
        by_quadrature[(static_cast<size_t>(n) * 3 + a) * padded + j] = g;
      }
    }
  }
}

QuadratureScratch::QuadratureScratch(const std::vector<QuadratureRegion>& regions) {
  size_t points = 0, columns = 0, entries = 0;
  for (const QuadratureRegion& region : regions) {
    const size_t padded = PadToLanes(region.size());
    points = std::max(points, static_cast<size_t>(region.size()));
    columns = std::max(columns, padded);
    entries = std::max(entries, padded * region.volume.size());
  }
  x.resize(points);
  force.resize(3 * columns);
  products.resize(27 * entries);
}

void AddQuadratureRegion(const QuadratureRegion& region, const Vec3* x, QuadratureScratch* scratch, Vec3* force,
                         double* pair_stiffness) {
  const int m = region.size(), padded = PadToLanes(m), points = static_cast<int>(region.volume.size());
  Center(region, x, scratch);
  double* sum = scratch->force.data();
  double* products = pair_stiffness ? scratch->products.data() : nullptr;
  std::fill_n(sum, 3 * padded, 0.0);
  for (int q = 0; q < points; q += kLanes) {
    double* four = products ? products + static_cast<size_t>(q) * 27 * padded : nullptr;
    FourPoints(region, q, scratch->x.data(), sum, four);
  }
  for (int j = 0; j < m; j++) {
    Vec3& f = force[region.point[j]];
    f = f - Vec3{sum[j], sum[padded + j], sum[2 * padded + j]};
  }
  if (!pair_stiffness) return;

  double tile[9 * kLanes * kLanes];
  for (int j0 = 0; j0 < m; j0 += kLanes) {
    for (int k0 = 0; k0 <= j0; k0 += kLanes) {
      Tile(region.by_quadrature.data() + j0, products + k0, points, padded, tile);
      for (int j = j0; j < std::min(j0 + kLanes, m); j++) {
        for (int k = k0; k < std::min(k0 + kLanes, j + 1); k++) {
          const int32_t index = region.pair[j * (j + 1) / 2 + k];
          if (index < 0) continue;
          double* target = pair_stiffness + 9 * static_cast<size_t>(index);
          const double* entry = tile + (j - j0) * kLanes + (k - k0);
          for (int e = 0; e < 9; e++) target[e] += entry[e * kLanes * kLanes];
        }
      }
    }
  }
}

double QuadratureEnergy(const QuadratureRegion& region, const Vec3* x, QuadratureScratch* scratch) {
  Center(region, x, scratch);
  double energy = 0;
  for (int q = 0; q < region.quadrature_points; q += kLanes) {
    Lanes F[9];
    Gradient(region.by_point.data() + static_cast<size_t>(q) * 3 * region.size(), scratch->x.data(), region.size(), F);
    const Invariants is = InvariantsOf(F);
    for (int lane = 0; lane < kLanes; lane++) {
      const LawParameters& p = region.material[q + lane];
      energy += region.volume[q + lane] * EnergyDensity(region.law, p, is.i1[lane], is.i2[lane], is.j[lane]);
    }
  }
  return energy;
}

void QuadratureStates(const QuadratureRegion& region, const Vec3* x, QuadratureScratch* scratch, PointState* states) {
  Center(region, x, scratch);
  for (int q = 0; q < region.quadrature_points; q += kLanes) {
    Lanes F[9], P[9];
    Gradient(region.by_point.data() + static_cast<size_t>(q) * 3 * region.size(), scratch->x.data(), region.size(), F);
    const Invariants is = InvariantsOf(F);
    FirstPiola(F, is, SlopesOf(region.law, region.material.data() + q, is), P);
    for (int lane = 0; lane < std::min(kLanes, region.quadrature_points - q); lane++) {
      PointState& state = states[q + lane];
      Mat3 stress;
      for (int e = 0; e < 9; e++) {
        state.F[e] = At(F, e, lane);
        stress[e] = At(P, e, lane);
      }
      const double j = is.j[lane];
      const double divisor = std::copysign(std::max(std::abs(j), kLeastVolume), j);
      state.cauchy = Mul(stress, Transpose(state.F));
      for (double& c : state.cauchy) c /= divisor;
      state.energy = EnergyDensity(region.law, region.material[q + lane], is.i1[lane], is.i2[lane], j);
    }
  }
}

}  // namespace mjframes
