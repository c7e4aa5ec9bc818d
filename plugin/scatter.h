// From lanes to 3×3 blocks of pairs of control points.

#ifndef MJFRAMES_PLUGIN_SCATTER_H_
#define MJFRAMES_PLUGIN_SCATTER_H_

#include <cstddef>
#include <cstdint>

#include "lanes.h"

namespace mjframes {

// out[lane][n] = a_n[lane] of four lanes
MJFRAMES_INLINE void Transpose4(const Lanes& a0, const Lanes& a1, const Lanes& a2, const Lanes& a3, Lanes* out) {
  using Pick = long long __attribute__((vector_size(sizeof(Lanes))));
  const Lanes low01 = __builtin_shuffle(a0, a1, Pick{0, 4, 2, 6}), high01 = __builtin_shuffle(a0, a1, Pick{1, 5, 3, 7});
  const Lanes low23 = __builtin_shuffle(a2, a3, Pick{0, 4, 2, 6}), high23 = __builtin_shuffle(a2, a3, Pick{1, 5, 3, 7});
  out[0] = __builtin_shuffle(low01, low23, Pick{0, 1, 4, 5});
  out[1] = __builtin_shuffle(high01, high23, Pick{0, 1, 4, 5});
  out[2] = __builtin_shuffle(low01, low23, Pick{2, 3, 6, 7});
  out[3] = __builtin_shuffle(high01, high23, Pick{2, 3, 6, 7});
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
