// A quadric over a plane, z ≈ c₀ + c₁ x + c₂ y + ½ c₃ x² + c₄ x y + ½ c₅ y², by least squares.

#ifndef MJFRAMES_PLUGIN_QUADRIC_H_
#define MJFRAMES_PLUGIN_QUADRIC_H_

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "linear.h"

namespace mjframes {

class Quadric {
 public:
  static constexpr int kTerms = 6;

  void Add(double x, double y, double z, double weight) {
    const Terms term(x, y);
    for (int i = 0; i < kTerms; i++) {
      right_[i] += weight * term.value[i] * z;
      for (int j = 0; j < kTerms; j++) matrix_[kTerms * i + j] += weight * term.value[i] * term.value[j];
    }
    square_ += weight * z * z;
    total_ += weight;
  }

  // After all points; false where they do not tell the terms apart.
  bool Fit() {
    if (mju_cholFactor(matrix_, kTerms, mjMINVAL) < kTerms) return false;
    mju_cholSolve(c, matrix_, right_, kTerms);
    return true;
  }

  double At(double x, double y) const { return mju_dot(c, Terms(x, y).value, kTerms); }

  // How far the points are off it, a root mean square.
  double Roughness() const { return std::sqrt(std::max(0.0, square_ - mju_dot(c, right_, kTerms)) / total_); }

  // Its curvatures, the larger one first, and the angle from x to the direction of that.
  double Curvature(int i) const {
    return 0.5 * (c[3] + c[5]) + (i == 0 ? 1 : -1) * std::hypot(0.5 * (c[3] - c[5]), c[4]);
  }
  double Angle() const { return 0.5 * std::atan2(2 * c[4], c[3] - c[5]); }

  double c[kTerms] = {};

 private:
  struct Terms {
    Terms(double x, double y) : value{1, x, y, 0.5 * x * x, x * y, 0.5 * y * y} {}
    double value[kTerms];
  };

  double matrix_[kTerms * kTerms] = {}, right_[kTerms] = {}, square_ = 0, total_ = 0;
};

// Two directions across a unit vector, and across each other.
struct Tangents {
  explicit Tangents(const Vec3& normal) {
    const Vec3 along = Cross(normal, std::abs(normal[0]) < 0.5 ? Vec3{1, 0, 0} : Vec3{0, 1, 0});
    x = (1 / Norm(along)) * along;
    y = Cross(normal, x);
  }

  Vec3 x, y;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_QUADRIC_H_
