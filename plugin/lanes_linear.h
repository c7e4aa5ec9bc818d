// 3-vectors and 3×3 matrices (row major) of several problems side by side, one a lane.

#ifndef MJFRAMES_PLUGIN_LANES_LINEAR_H_
#define MJFRAMES_PLUGIN_LANES_LINEAR_H_

#include "lanes.h"
#include "linear.h"

namespace mjframes {

template <typename V>
MJFRAMES_INLINE Mat3 LaneOf(const V* matrix, int lane) {
  Mat3 one;
  for (int e = 0; e < 9; e++) one[e] = matrix[e][lane];
  return one;
}

template <typename V>
MJFRAMES_INLINE void Cross3(const V* a, const V* b, V* out) {
  for (int r = 0; r < 3; r++) out[r] = a[(r + 1) % 3] * b[(r + 2) % 3] - a[(r + 2) % 3] * b[(r + 1) % 3];
}

// out = a b
template <typename V>
MJFRAMES_INLINE void Mul3(const V* a, const V* b, V* out) {
  for (int r = 0; r < 3; r++) {
    for (int c = 0; c < 3; c++) {
      out[3 * r + c] = a[3 * r] * b[c] + a[3 * r + 1] * b[3 + c] + a[3 * r + 2] * b[6 + c];
    }
  }
}

// out = aᵀ b
template <typename V>
MJFRAMES_INLINE void MulT3(const V* a, const V* b, V* out) {
  for (int r = 0; r < 3; r++) {
    for (int c = 0; c < 3; c++) out[3 * r + c] = a[r] * b[c] + a[3 + r] * b[3 + c] + a[6 + r] * b[6 + c];
  }
}

// out = det(a) a⁻¹; returns the determinant.
template <typename V>
MJFRAMES_INLINE V Adjugate(const V* a, V* out) {
  for (int r = 0; r < 3; r++) {
    const int s = (r + 1) % 3, t = (r + 2) % 3;
    for (int c = 0; c < 3; c++) {
      const int d = (c + 1) % 3, e = (c + 2) % 3;
      out[3 * c + r] = a[3 * s + d] * a[3 * t + e] - a[3 * s + e] * a[3 * t + d];
    }
  }
  return a[0] * out[0] + a[1] * out[3] + a[2] * out[6];
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_LANES_LINEAR_H_
