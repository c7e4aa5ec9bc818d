// Four doubles that are computed on together: one AVX register, or two of SSE2. Eight: one AVX-512 register.

#ifndef MJFRAMES_PLUGIN_LANES_H_
#define MJFRAMES_PLUGIN_LANES_H_

#include <cmath>
#include <cstring>

// Helpers must end up inside the functions that are compiled once more for AVX2 (multiversion.h).
#define MJFRAMES_INLINE inline __attribute__((always_inline))

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

MJFRAMES_INLINE Lanes Positive(const Lanes& a) { return a > 0.0 ? a : Fill(0); }

template <typename V>
MJFRAMES_INLINE bool AnyPositive(const V& a) {
  bool any = false;
  for (int lane = 0; lane < kWidth<V>; lane++) any = any || a[lane] > 0;
  return any;
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_LANES_H_
