// 3-vectors and 3×3 matrices (row major), small enough to live in registers.

#ifndef MJFRAMES_PLUGIN_LINEAR_H_
#define MJFRAMES_PLUGIN_LINEAR_H_

#include <array>
#include <cmath>

namespace mjframes {

using Vec3 = std::array<double, 3>;
using Mat3 = std::array<double, 9>;  // row major

inline constexpr Mat3 kIdentity = {1, 0, 0, 0, 1, 0, 0, 0, 1};

inline Vec3 operator+(const Vec3& a, const Vec3& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Vec3 operator-(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Vec3 operator*(double s, const Vec3& a) { return {s * a[0], s * a[1], s * a[2]}; }
inline double Dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline double Norm(const Vec3& a) { return std::sqrt(Dot(a, a)); }

inline Vec3 Cross(const Vec3& a, const Vec3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

inline Vec3 Mul(const Mat3& m, const Vec3& v) {
  return {m[0] * v[0] + m[1] * v[1] + m[2] * v[2], m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
          m[6] * v[0] + m[7] * v[1] + m[8] * v[2]};
}

// mᵀ v
inline Vec3 MulT(const Mat3& m, const Vec3& v) {
  return {m[0] * v[0] + m[3] * v[1] + m[6] * v[2], m[1] * v[0] + m[4] * v[1] + m[7] * v[2],
          m[2] * v[0] + m[5] * v[1] + m[8] * v[2]};
}

inline Mat3 Mul(const Mat3& a, const Mat3& b) {
  Mat3 c;
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++) c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
  }
  return c;
}

// As MuJoCo keeps them.
inline Vec3 ToVec3(const double* values) { return {values[0], values[1], values[2]}; }
inline Mat3 ToMat3(const double* values) {
  Mat3 a;
  for (int i = 0; i < 9; i++) a[i] = values[i];
  return a;
}

inline Mat3 Transpose(const Mat3& a) { return {a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]}; }

// [v]×, so that [v]× a = v × a
inline Mat3 Skew(const Vec3& v) { return {0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0}; }

inline double Det(const Mat3& a) {
  return a[0] * (a[4] * a[8] - a[5] * a[7]) - a[1] * (a[3] * a[8] - a[5] * a[6]) + a[2] * (a[3] * a[7] - a[4] * a[6]);
}

// a⁻¹; the caller guarantees that a is regular
inline Mat3 Inverse(const Mat3& a) {
  const double s = 1 / Det(a);
  return {s * (a[4] * a[8] - a[5] * a[7]), s * (a[2] * a[7] - a[1] * a[8]), s * (a[1] * a[5] - a[2] * a[4]),
          s * (a[5] * a[6] - a[3] * a[8]), s * (a[0] * a[8] - a[2] * a[6]), s * (a[2] * a[3] - a[0] * a[5]),
          s * (a[3] * a[7] - a[4] * a[6]), s * (a[1] * a[6] - a[0] * a[7]), s * (a[0] * a[4] - a[1] * a[3])};
}

// |a u| is at most this times |u|: √(‖a‖₁ ‖a‖∞).
inline double NormBound(const Mat3& a) {
  double rows = 0, columns = 0;
  for (int i = 0; i < 3; i++) {
    rows = std::fmax(rows, std::abs(a[3 * i]) + std::abs(a[3 * i + 1]) + std::abs(a[3 * i + 2]));
    columns = std::fmax(columns, std::abs(a[i]) + std::abs(a[3 + i]) + std::abs(a[6 + i]));
  }
  return std::sqrt(rows * columns);
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_LINEAR_H_
