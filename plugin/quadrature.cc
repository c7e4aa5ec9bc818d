#include "quadrature.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "constants.h"
#include "hessian.h"
#include "simd.h"

namespace mjframes {
namespace {

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

// V_q P of eight points from their F (9 × 8), and V_q ∂P/∂F where `hessian` is given.
template <typename V>
MJFRAMES_INLINE void RespondOf(Law law, const LawParameters* material, const double* volume, const double* gradient,
                               double* stress, double* hessian) {
  for (int lane = 0; lane < kWideLanes; lane += kWidth<V>) {
    V F[9], P[9];
    for (int e = 0; e < 9; e++) F[e] = Load<V>(gradient + e * kWideLanes + lane);
    const Invariants<V> is = InvariantsOf(F);
    const Slopes<V> of = SlopesOf(law, material + lane, is);
    const V weight = Load<V>(volume + lane);
    FirstPiola(F, is, of, P);
    for (int e = 0; e < 9; e++) Store(weight * P[e], stress + e * kWideLanes + lane);
    if (!hessian) continue;
    V H[81];
    ProjectedHessian(F, of, H);
    for (int e = 0; e < 81; e++) Store(weight * H[e], hessian + e * kWideLanes + lane);
  }
}

void RespondEight(Law law, const LawParameters* material, const double* volume, const double* gradient, double* stress,
                  double* hessian) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL { RespondOf<V>(law, material, volume, gradient, stress, hessian); });
}

// Entry of point n in arrays of eight points side by side.
MJFRAMES_INLINE double* EntryOf(std::vector<double>* array, int entries, int n) {
  return array->data() + static_cast<size_t>(n / kWideLanes) * entries * kWideLanes + n % kWideLanes;
}

// F of a region's points into the row of all.
void StoreGradients(const QuadratureRegion& region, int first, QuadratureScratch* scratch) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    for (int q = 0; q < region.quadrature_points; q += kLanes) {
      Lanes F[9];
      Gradient(region.by_point.data() + static_cast<size_t>(q) * 3 * region.size(), scratch->x.data(), region.size(),
               F);
      for (int lane = 0; lane < std::min(kLanes, region.quadrature_points - q); lane++) {
        double* entry = EntryOf(&scratch->gradient, 9, first + q + lane);
        for (int e = 0; e < 9; e++) entry[e * kWideLanes] = F[e][lane];
      }
    }
  });
}

// Adds Σ_q V_q P ∇W_j of a region to force (3 × padded).
void AddForce(const QuadratureRegion& region, int first, QuadratureScratch* scratch) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    const int padded = PadToLanes(region.size());
    double* __restrict force = scratch->force.data();
    const double* g = region.by_quadrature.data();
    for (int q = 0; q < region.quadrature_points; q++, g += 3 * padded) {
      const double* P = EntryOf(&scratch->stress, 9, first + q);
      for (int r = 0; r < 3; r++) {
        const double p0 = P[3 * r * kWideLanes], p1 = P[(3 * r + 1) * kWideLanes], p2 = P[(3 * r + 2) * kWideLanes];
        for (int j = 0; j < padded; j += kLanes) {
          const Lanes sum = p0 * Load(g + j) + p1 * Load(g + padded + j) + p2 * Load(g + 2 * padded + j);
          Store(Load(force + r * padded + j) + sum, force + r * padded + j);
        }
      }
    }
  });
}

// V_q (∂P/∂F) ∇W_k of a region, columns from k on: entry (r, a), s at 3 (3r + a) + s of products (q × 27 × padded).
template <typename V>
MJFRAMES_INLINE void MultiplyColumns(const QuadratureRegion& region, int first, int k, QuadratureScratch* scratch) {
  const int padded = PadToLanes(region.size());
  double* __restrict out = scratch->products.data() + k;
  const double* g = region.by_quadrature.data() + k;
  for (int q = 0; q < region.quadrature_points; q++, g += 3 * padded) {
    const double* H = EntryOf(&scratch->hessian, 81, first + q);
    const V g0 = Load<V>(g), g1 = Load<V>(g + padded), g2 = Load<V>(g + 2 * padded);
    for (int n = 0; n < 27; n++, H += 3 * kWideLanes, out += padded) {
      Store(H[0] * g0 + H[kWideLanes] * g1 + H[2 * kWideLanes] * g2, out);
    }
  }
}

// Adds Σ_q,a ∂_a W_j product[(r, a), s][k] of four j and one register of k to the scratch memory's blocks.
template <typename V>
MJFRAMES_INLINE void AddTile(const QuadratureRegion& region, QuadratureScratch* scratch, int j0, int k0) {
  const int padded = PadToLanes(region.size());
  V tile[kLanes][9];
  for (int r = 0; r < 3; r++) {
    V sum[12];
    for (V& s : sum) s = Fill<V>(0);
    for (int q = 0; q < region.quadrature_points; q++) {
      const double* g = region.by_quadrature.data() + static_cast<size_t>(q) * 3 * padded + j0;
      const double* t = scratch->products.data() + (static_cast<size_t>(q) * 27 + 9 * r) * padded + k0;
      for (int a = 0; a < 3; a++, g += padded, t += 3 * padded) {
        const V t0 = Load<V>(t), t1 = Load<V>(t + padded), t2 = Load<V>(t + 2 * padded);
        for (int j = 0; j < kLanes; j++) {
          sum[j] += g[j] * t0;
          sum[4 + j] += g[j] * t1;
          sum[8 + j] += g[j] * t2;
        }
      }
    }
    for (int n = 0; n < 12; n++) tile[n % 4][3 * r + n / 4] = sum[n];
  }
  for (int j = j0; j < std::min(j0 + kLanes, region.size()); j++) {
    int32_t pair[kWidth<V>];
    for (int k = 0; k < kWidth<V>; k++) pair[k] = k0 + k <= j ? j * (j + 1) / 2 + k0 + k : -1;
    Scatter(tile[j - j0], pair, scratch->block.data()->data());
  }
}

// Adds a region's K to the scratch memory's blocks.
template <typename V>
MJFRAMES_INLINE void AddBlocksOf(const QuadratureRegion& region, int first, QuadratureScratch* scratch) {
  const int padded = PadToLanes(region.size());
  int k = 0;
  for (; k + kWidth<V> <= padded; k += kWidth<V>) MultiplyColumns<V>(region, first, k, scratch);
  for (; k < padded; k += kLanes) MultiplyColumns<Lanes>(region, first, k, scratch);
  for (int j = 0; j < padded; j += kLanes) {
    for (k = 0; k + kWidth<V> <= j + kLanes; k += kWidth<V>) AddTile<V>(region, scratch, j, k);
    for (; k <= j; k += kLanes) AddTile<Lanes>(region, scratch, j, k);
  }
}

void AddBlocks(const QuadratureRegion& region, int first, QuadratureScratch* scratch) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL { AddBlocksOf<V>(region, first, scratch); });
}

// Whether no point of a region is stretched far or inverted.
bool IsCalm(const QuadratureRegion& region, int first, QuadratureScratch* scratch) {
  for (int q = 0; q < region.quadrature_points; q++) {
    const double* entry = EntryOf(&scratch->gradient, 9, first + q);
    Mat3 F;
    double square = 0;
    for (int e = 0; e < 9; e++) {
      F[e] = entry[e * kWideLanes];
      square += F[e] * F[e];
    }
    if (!(square < 3 * kCalm * kCalm && Det(F) > 0)) return false;
  }
  return true;
}

// A [v]×
MJFRAMES_INLINE Mat3 MulSkew(const Mat3& A, const Vec3& v) {
  Mat3 product;
  for (int r = 0; r < 9; r += 3) {
    const Vec3 row = Cross({A[r], A[r + 1], A[r + 2]}, v);
    for (int c = 0; c < 3; c++) product[r + c] = row[c];
  }
  return product;
}

// (Zᵀ Z)⁻¹ of places x about their middle; false where all are there.
MJFRAMES_INLINE bool InvertMoment(const Vec3* x, const Vec3& middle, int m, Mat3* inverse) {
  Mat3 moment{};  // Zᵀ Z
  for (int j = 0; j < m; j++) {
    const Vec3 z = x[j] - middle;
    const double square = Dot(z, z);
    for (int e = 0; e < 9; e++) moment[e] += (e % 4 == 0 ? square : 0) - z[e / 3] * z[e % 3];
  }
  const double trace = moment[0] + moment[4] + moment[8];
  if (!(trace > 0)) return false;
  for (int e = 0; e < 9; e += 4) moment[e] += kInLine * trace;
  *inverse = Inverse(moment);
  return true;
}

// Pᵀ K P = K − Z Cᵀ − C Zᵀ, C = U A − ½ Z A Zᵀ U A, U = K Z, A = (Zᵀ Z)⁻¹, of the scratch memory's blocks and x.
MJFRAMES_INLINE void ProjectBlocksOf(int m, QuadratureScratch* scratch) {
  const Vec3* z = scratch->x.data();
  Mat3 A;
  if (!InvertMoment(z, {}, m, &A)) return;
  Mat3* U = scratch->turned.data();
  std::fill_n(U, m, Mat3{});
  const Mat3* block = scratch->block.data();
  for (int j = 0; j < m; j++) {
    for (int k = 0; k <= j; k++, block++) {
      const Mat3 at = MulSkew(*block, z[k]);
      for (int e = 0; e < 9; e++) U[j][e] -= at[e];
      if (k == j) continue;
      const Mat3 across = MulSkew(Transpose(*block), z[j]);
      for (int e = 0; e < 9; e++) U[k][e] -= across[e];
    }
  }
  Mat3 ZU{};
  for (int j = 0; j < m; j++) {
    const Mat3 some = Mul(Skew(z[j]), U[j]);
    for (int e = 0; e < 9; e++) ZU[e] += some[e];
  }
  const Mat3 half = Mul(A, Mul(ZU, A));
  for (int j = 0; j < m; j++) {
    const Mat3 some = Mul(U[j], A), turn = Mul(Skew(z[j]), half);
    for (int e = 0; e < 9; e++) U[j][e] = some[e] + 0.5 * turn[e];  // C
  }
  Mat3* into = scratch->block.data();
  for (int j = 0; j < m; j++) {
    for (int k = 0; k <= j; k++, into++) {
      const Mat3 left = MulSkew(U[j], z[k]), right = MulSkew(U[k], z[j]);
      for (int e = 0; e < 9; e++) (*into)[e] -= left[e] + right[3 * (e % 3) + e / 3];
    }
  }
}

void ProjectBlocks(int m, QuadratureScratch* scratch) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL { ProjectBlocksOf(m, scratch); });
}

// Moves the scratch memory's blocks to the pairs of a region.
void MoveToPairs(const QuadratureRegion& region, QuadratureScratch* scratch, double* stiffness) {
  for (size_t i = 0; i < region.pair.size(); i++) {
    if (region.pair[i] < 0) continue;
    double* pair = stiffness + 9 * static_cast<size_t>(region.pair[i]);
    for (int e = 0; e < 9; e++) pair[e] += scratch->block[i][e];
  }
  std::fill_n(scratch->block.begin(), region.pair.size(), Mat3{});
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
                                   const LawParameters* material, int q, std::vector<int32_t> pair,
                                   std::vector<int32_t> factor)
    : law(law), quadrature_points(q), point(std::move(point)), pair(std::move(pair)), factor(std::move(factor)) {
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
  size_t points = 0, columns = 0, entries = 0, count = 0;
  for (const QuadratureRegion& region : regions) {
    const size_t padded = PadToLanes(region.size());
    points = std::max(points, static_cast<size_t>(region.size()));
    columns = std::max(columns, padded);
    entries = std::max(entries, padded * region.quadrature_points);
    first.push_back(static_cast<int>(count));
    count += region.quadrature_points;
    volume.insert(volume.end(), region.volume.begin(), region.volume.begin() + region.quadrature_points);
    material.insert(material.end(), region.material.begin(), region.material.begin() + region.quadrature_points);
  }
  if (regions.empty()) return;
  count = (count + kWideLanes - 1) / kWideLanes * kWideLanes;
  volume.resize(count, 0);
  material.resize(count, material.front());
  gradient.resize(9 * count);
  stress.resize(9 * count);
  hessian.resize(81 * count);
  for (size_t n = 0; n < count; n++) {  // points that fill up stay at rest
    for (int e = 0; e < 9; e += 4) EntryOf(&gradient, 9, static_cast<int>(n))[e * kWideLanes] = 1;
  }
  x.resize(points);
  block.resize(points * (points + 1) / 2);
  plain.resize(block.size());
  turned.resize(points);
  force.resize(3 * columns);
  products.resize(27 * entries);
}

void QuadratureScratch::Scale(const std::vector<QuadratureRegion>& regions, const std::vector<double>& factors) {
  for (size_t e = 0; e < regions.size(); e++) {
    for (int q = 0; q < regions[e].quadrature_points; q++) {
      material[first[e] + q] = Scaled(regions[e].material[q], factors[regions[e].factor[q]]);
    }
  }
}

void AddQuadrature(const std::vector<QuadratureRegion>& regions, const Vec3* x, QuadratureScratch* scratch, Vec3* force,
                   double* stiffness) {
  if (regions.empty()) return;
  for (size_t e = 0; e < regions.size(); e++) {
    Center(regions[e], x, scratch);
    StoreGradients(regions[e], scratch->first[e], scratch);
  }
  for (size_t n = 0; n < scratch->volume.size(); n += kWideLanes) {
    RespondEight(regions.front().law, scratch->material.data() + n, scratch->volume.data() + n,
                 scratch->gradient.data() + 9 * n, scratch->stress.data() + 9 * n,
                 stiffness ? scratch->hessian.data() + 81 * n : nullptr);
  }
  for (size_t e = 0; e < regions.size(); e++) {
    const QuadratureRegion& region = regions[e];
    const int m = region.size(), padded = PadToLanes(m);
    double* sum = scratch->force.data();
    std::fill_n(sum, 3 * padded, 0.0);
    AddForce(region, scratch->first[e], scratch);
    for (int j = 0; j < m; j++) {
      Vec3& f = force[region.point[j]];
      f = f - Vec3{sum[j], sum[padded + j], sum[2 * padded + j]};
    }
    if (!stiffness) continue;
    if (!IsCalm(region, scratch->first[e], scratch)) {
      std::swap(scratch->block, scratch->plain);
      AddBlocks(region, scratch->first[e], scratch);
      MoveToPairs(region, scratch, stiffness);
      std::swap(scratch->block, scratch->plain);
    } else {
      AddBlocks(region, scratch->first[e], scratch);
    }
    if (e + 1 < regions.size() && regions[e + 1].point == region.point) continue;
    Center(region, x, scratch);
    ProjectBlocks(m, scratch);
    MoveToPairs(region, scratch, stiffness);
  }
}

void TakeTorque(const Vec3* x, std::vector<Vec3>* force) {
  const int n = static_cast<int>(force->size());
  Vec3 middle{}, torque{};
  for (int j = 0; j < n; j++) middle = middle + (1.0 / n) * x[j];
  Mat3 inverse;
  if (!InvertMoment(x, middle, n, &inverse)) return;
  for (int j = 0; j < n; j++) torque = torque + Cross(x[j] - middle, (*force)[j]);
  const Vec3 turn = Mul(inverse, torque);
  for (int j = 0; j < n; j++) (*force)[j] = (*force)[j] - Cross(turn, x[j] - middle);
}

double QuadratureEnergy(const std::vector<QuadratureRegion>& regions, size_t e, const Vec3* x,
                        QuadratureScratch* scratch) {
  const QuadratureRegion& region = regions[e];
  Center(region, x, scratch);
  double energy = 0;
  for (int q = 0; q < region.quadrature_points; q += kLanes) {
    Lanes F[9];
    Gradient(region.by_point.data() + static_cast<size_t>(q) * 3 * region.size(), scratch->x.data(), region.size(), F);
    const Invariants<Lanes> is = InvariantsOf(F);
    for (int lane = 0; lane < std::min(kLanes, region.quadrature_points - q); lane++) {
      const LawParameters& p = scratch->material[scratch->first[e] + q + lane];
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
    const Invariants<Lanes> is = InvariantsOf(F);
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
