// Several doubles that are computed on together, and code compiled for the processor's vector units.
//
// Lanes are four doubles, one AVX register or two of SSE2, WideLanes eight, one AVX-512 register. What is computed lane
// by lane is written once, for a type V of either, as inline functions; Dispatch runs it compiled for the processor
// that it finds itself on, with the widest V that this one has. Processors with different vector units differ in the
// last digits.

#ifndef MJFRAMES_PLUGIN_SIMD_H_
#define MJFRAMES_PLUGIN_SIMD_H_

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "linear.h"
#include "processor.h"

// What Dispatch runs must end up inside the functions that it has compiled for newer processors.
#define MJFRAMES_INLINE inline __attribute__((always_inline))
#define MJFRAMES_KERNEL __attribute__((always_inline))  // of a lambda, after its parameters

// Before a loop over an array of Lanes, which are in registers only where the loop is unrolled.
#define MJFRAMES_UNROLL _Pragma("GCC unroll 16")

// Without AVX, GCC warns that functions would return Lanes in another way than with it; those that do are all inlined.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace mjframes {

inline constexpr int kLanes = 4;
inline constexpr int kWideLanes = 8;

using Lanes = double __attribute__((vector_size(kLanes * sizeof(double))));
using WideLanes = double __attribute__((vector_size(kWideLanes * sizeof(double))));

template <typename V>
inline constexpr int kWidth = sizeof(V) / sizeof(double);

constexpr int PadToLanes(int n) { return (n + kLanes - 1) / kLanes * kLanes; }
constexpr int PadToWide(int n) { return (n + kWideLanes - 1) / kWideLanes * kWideLanes; }

template <typename V = Lanes>
MJFRAMES_INLINE V Load(const double* p) {
  V a;
  std::memcpy(&a, p, sizeof(a));
  return a;
}

template <typename V>
MJFRAMES_INLINE void Store(const V& a, double* p) {
  std::memcpy(p, &a, sizeof(a));
}

template <typename V = Lanes>
MJFRAMES_INLINE V Fill(double a) {
  return a - V{};
}

template <typename V>
MJFRAMES_INLINE V Sqrt(const V& a) {
  V root;
  for (int lane = 0; lane < kWidth<V>; lane++) root[lane] = std::sqrt(a[lane]);
  return root;
}

template <typename V>
MJFRAMES_INLINE V Abs(const V& a) {
  return a < 0.0 ? -a : a;
}

template <typename V>
MJFRAMES_INLINE bool AnyPositive(const V& a) {
  bool any = false;
  for (int lane = 0; lane < kWidth<V>; lane++) any = any || a[lane] > 0;
  return any;
}

template <typename V>
using Mask = decltype(V{} < V{});  // of lanes, all bits set where true

template <typename V>
MJFRAMES_INLINE bool Any(const Mask<V>& mask) {
  bool any = false;
  for (int lane = 0; lane < kWidth<V>; lane++) any = any || mask[lane];
  return any;
}

template <typename V>
MJFRAMES_INLINE bool All(const Mask<V>& mask) {
  return !Any<V>(!mask);
}

// 3-vectors and 3×3 matrices (row major) of several problems side by side, one a lane.

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

// From lanes to 3×3 blocks of pairs of control points.

// The lanes of a, then those of b, that are named.
template <int I, int J, int K, int L>
MJFRAMES_INLINE Lanes Pick(const Lanes& a, const Lanes& b) {
#ifdef __clang__
  return __builtin_shufflevector(a, b, I, J, K, L);
#else
  using Numbers = long long __attribute__((vector_size(sizeof(Lanes))));
  return __builtin_shuffle(a, b, Numbers{I, J, K, L});
#endif
}

// out[lane][n] = a_n[lane] of four lanes
MJFRAMES_INLINE void Transpose4(const Lanes& a0, const Lanes& a1, const Lanes& a2, const Lanes& a3, Lanes* out) {
  const Lanes low01 = Pick<0, 4, 2, 6>(a0, a1), high01 = Pick<1, 5, 3, 7>(a0, a1);
  const Lanes low23 = Pick<0, 4, 2, 6>(a2, a3), high23 = Pick<1, 5, 3, 7>(a2, a3);
  out[0] = Pick<0, 1, 4, 5>(low01, low23);
  out[1] = Pick<0, 1, 4, 5>(high01, high23);
  out[2] = Pick<2, 3, 6, 7>(low01, low23);
  out[3] = Pick<2, 3, 6, 7>(high01, high23);
}

// Adds each lane's block (entry e in block[e]) to its pair, −1 for none. stiffness: row-major blocks by pair.
template <typename V>
MJFRAMES_INLINE void Scatter(const V* block, const int32_t* pair, double* stiffness) {
  for (int four = 0; four < kWidth<V>; four += kLanes) {
    Lanes part[9], front[4], back[4];
    for (int e = 0; e < 9; e++) part[e] = Load(reinterpret_cast<const double*>(block + e) + four);
    Transpose4(part[0], part[1], part[2], part[3], front);
    Transpose4(part[4], part[5], part[6], part[7], back);
    for (int lane = 0; lane < kLanes; lane++) {
      if (pair[four + lane] < 0) continue;
      double* target = stiffness + 9 * static_cast<size_t>(pair[four + lane]);
      Store(Load(target) + front[lane], target);
      Store(Load(target + 4) + back[lane], target + 4);
      target[8] += part[8][lane];
    }
  }
}

// Sanitizers, which guard every access of each version, would compile for minutes.
#if defined(__x86_64__) && !defined(MJFRAMES_SANITIZE)
#define MJFRAMES_PROCESSORS 1

template <typename Kernel>
__attribute__((target(MJFRAMES_AVX512))) void RunWithAvx512(const Kernel& kernel) {
  kernel.template operator()<WideLanes>();
}

template <typename Kernel>
__attribute__((target(MJFRAMES_AVX2))) void RunWithAvx2(const Kernel& kernel) {
  kernel.template operator()<Lanes>();
}
#endif

// Runs `kernel`, a lambda [&]<typename V>() MJFRAMES_KERNEL { … }.
template <typename Kernel>
MJFRAMES_INLINE void Dispatch(const Kernel& kernel) {
#ifdef MJFRAMES_PROCESSORS
  if (kHasAvx512) return RunWithAvx512(kernel);
  if (kHasAvx2) return RunWithAvx2(kernel);
#endif
  kernel.template operator()<Lanes>();
}

// The least and the largest of n values, none of them beyond ±mjMAXVAL.
struct Extremes {
  double least, largest;
};

inline Extremes ExtremesOf(const double* value, int n) {
  Extremes of = {mjMAXVAL, -mjMAXVAL};
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    V low = Fill<V>(of.least), high = Fill<V>(of.largest);
    int i = 0;
    for (; i + kWidth<V> <= n; i += kWidth<V>) {
      const V some = Load<V>(value + i);
      low = some < low ? some : low;
      high = some > high ? some : high;
    }
    for (int lane = 0; lane < kWidth<V>; lane++) {
      of = {std::min(of.least, low[lane]), std::max(of.largest, high[lane])};
    }
    for (; i < n; i++) of = {std::min(of.least, value[i]), std::max(of.largest, value[i])};
  });
  return of;
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SIMD_H_
