// Some of the eight regions of a batch: those that one call computes side by side.

#ifndef MJFRAMES_PLUGIN_REGION_LANES_H_
#define MJFRAMES_PLUGIN_REGION_LANES_H_

#include "corotational.h"
#include "simd.h"

namespace mjframes {

// The lanes from `first` on that one call computes: V of the batch's eight.
template <typename V>
struct Half {
  const RegionBatch& batch;
  const RegionBatch::Moduli& moduli;
  int first;
  int size = batch.sizes[first / kLanes];  // m, of the largest in these lanes

  MJFRAMES_INLINE V Of(const double* array, size_t entry) const { return Load<V>(array + kWideLanes * entry + first); }
  MJFRAMES_INLINE void Put(const V& value, double* array, size_t entry) const {
    Store(value, array + kWideLanes * entry + first);
  }
  // Block (j, k) of a symmetric matrix, whose blocks (j, k ≤ j) `array` has.
  MJFRAMES_INLINE void Block(const double* array, int j, int k, V* K) const {
    const size_t block = k <= j ? j * (j + 1) / 2 + k : k * (k + 1) / 2 + j;
    for (int e = 0; e < 9; e++) K[e] = Of(array, 9 * block + (k <= j ? e : 3 * (e % 3) + e / 3));
  }
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_REGION_LANES_H_
