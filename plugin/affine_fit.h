// The affine motion that fits those of points best, each weighted with c_j = |ω_j|: its slopes are
//
//   ∇N_j = C⁻¹ c_j (x_j − x̄),   C = Σ_j c_j (x_j − x̄)(x_j − x̄)ᵀ,   x̄ = Σ_j c_j x_j / Σ_j c_j
//
// so that Σ_j ∇N_j = 0 and Σ_j x_j ∇N_jᵀ = 1, whatever the weights.

#ifndef MJFRAMES_PLUGIN_AFFINE_FIT_H_
#define MJFRAMES_PLUGIN_AFFINE_FIT_H_

#include <cmath>
#include <vector>

#include "constants.h"
#include "linear.h"

namespace mjframes {

class AffineFit {
 public:
  // For points x with weights ω, which stay where they are; false where those that have any lie in a plane.
  bool Find(const std::vector<Vec3>& x, const double* omega) {
    x_ = x.data();
    omega_ = omega;
    double total = 0;
    Vec3 sum{};
    for (size_t j = 0; j < x.size(); j++) {
      total += std::abs(omega[j]);
      sum = sum + std::abs(omega[j]) * x[j];
    }
    if (!(total > 0)) return false;
    middle_ = (1 / total) * sum;
    Mat3 C{};
    for (size_t j = 0; j < x.size(); j++) {
      if (omega[j] == 0) continue;
      const Vec3 from = x[j] - middle_, scaled = From(j);
      for (int a = 0; a < 3; a++) {
        for (int b = 0; b <= a; b++) C[3 * a + b] += scaled[a] * from[b];
      }
    }
    C = {C[0], C[3], C[6], C[3], C[4], C[7], C[6], C[7], C[8]};
    const double size = (C[0] + C[4] + C[8]) / 3;
    if (!(Det(C) > kFlatPoints * size * size * size)) return false;
    inverse_ = Inverse(C);
    return true;
  }

  // c_j (x_j − x̄)
  Vec3 From(size_t j) const { return std::abs(omega_[j]) * (x_[j] - middle_); }

  // C⁻¹ v: ∇N_j of v = From(j); and v · ∇N_j is Along(v) · From(j)
  Vec3 Along(const Vec3& v) const { return Mul(inverse_, v); }

 private:
  const Vec3* x_;
  const double* omega_;
  Vec3 middle_;
  Mat3 inverse_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_AFFINE_FIT_H_
