// From lanes to 3×3 blocks of pairs of control points.

#ifndef MJFRAMES_PLUGIN_SCATTER_H_
#define MJFRAMES_PLUGIN_SCATTER_H_

#include <cstddef>
#include <cstdint>

#include "lanes.h"

namespace mjframes {

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

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SCATTER_H_
