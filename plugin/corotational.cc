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

}  // namespace

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

double RegionEnergy(const Region& region, const Vec3* x, const Mat3& R) {
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
        const double* row = region.stiffness.data() + 3 * (static_cast<size_t>(3 * j + r) * m + k);
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
    energy += cell.volume * EnergyDensity(region.law, cell.material, is.i1, is.i2, is.j);
  }
  return energy;
}

}  // namespace mjframes
