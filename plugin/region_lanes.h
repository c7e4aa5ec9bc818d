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
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_REGION_LANES_H_
