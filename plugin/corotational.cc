#include "corotational.h"

#include "rotation.h"

namespace mjframes {

Mat3 RegionRotation(const Region& region, const Vec3* x, const Mat3& guess) {
  Mat3 F{};
  for (int j = 0; j < region.size(); j++) {
    const Vec3& xj = x[region.point[j]];
    const Vec3& g = region.gradient[j];
    for (int r = 0; r < 3; r++) {
      for (int c = 0; c < 3; c++) F[3 * r + c] += xj[r] * g[c];
    }
  }
  return ClosestRotation(F, guess);
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
  return energy;
}

}  // namespace mjframes
