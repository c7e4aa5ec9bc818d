// Four doubles that are computed on together: one AVX register, or two of SSE2.

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

using Lanes = double __attribute__((vector_size(kLanes * sizeof(double))));

constexpr int PadToLanes(int n) { return (n + kLanes - 1) / kLanes * kLanes; }

MJFRAMES_INLINE Lanes Load(const double* p) {
  Lanes a;
  std::memcpy(&a, p, sizeof(a));
  return a;
}

MJFRAMES_INLINE void Store(const Lanes& a, double* p) { std::memcpy(p, &a, sizeof(a)); }

MJFRAMES_INLINE Lanes Fill(double a) { return Lanes{a, a, a, a}; }

MJFRAMES_INLINE Lanes Sqrt(const Lanes& a) {
  return Lanes{std::sqrt(a[0]), std::sqrt(a[1]), std::sqrt(a[2]), std::sqrt(a[3])};
}

MJFRAMES_INLINE Lanes Abs(const Lanes& a) { return a < 0.0 ? -a : a; }

MJFRAMES_INLINE Lanes Magnitude(Lanes a) { return a < 0 ? -a : a; }

MJFRAMES_INLINE Lanes Positive(const Lanes& a) { return a > 0.0 ? a : Fill(0); }

MJFRAMES_INLINE bool AnyPositive(const Lanes& a) { return a[0] > 0 || a[1] > 0 || a[2] > 0 || a[3] > 0; }

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_LANES_H_
