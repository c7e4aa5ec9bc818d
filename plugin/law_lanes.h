// laws.h at several deformation gradients side by side, one a lane.

#ifndef MJFRAMES_PLUGIN_LAW_LANES_H_
#define MJFRAMES_PLUGIN_LAW_LANES_H_

#include "hessian.h"
#include "laws/laws.h"

namespace mjframes {

// material: of each lane.
template <typename V>
MJFRAMES_INLINE Slopes<V> SlopesOf(Law law, const LawParameters* material, const Invariants<V>& is) {
  Slopes<V> of;
  for (int lane = 0; lane < kWidth<V>; lane++) {
    const LawParameters& p = material[lane];
    const Stretch f = Respond(law, p, is.i1[lane]);
    of.f1[lane] = f.slope;
    of.f2[lane] = f.curvature;
    of.second[lane] = p.second;
    of.volume[lane] = p.volume;
    of.g1[lane] = p.volume * (is.j[lane] - 1) - p.linear;
  }
  return of;
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_LAW_LANES_H_
