// Weights of points of a soft body's material, as attributes hold them.
//
//   p_n = Σ_j W_nj x_j + o_n          o_n = p̄_n − Σ_j W_nj x̄_j: what frames that cannot turn leave
//
// Index letters: n point; j control point.

#ifndef MJFRAMES_PLUGIN_WEIGHTS_H_
#define MJFRAMES_PLUGIN_WEIGHTS_H_

#include <cstdint>
#include <vector>

#include "attributes.h"
#include "linear.h"

namespace mjframes {

struct Weights {
  std::vector<int32_t> first;  // of each point's entries below, and the end of the last one's (n + 1)
  std::vector<int32_t> point;  // j                                                            (Σ)
  std::vector<double> weight;  // W_nj                                                         (Σ)
  std::vector<Vec3> offset;    // o_n [m], none where all are zero                             (n)

  int size() const { return static_cast<int>(first.size()) - 1; }

  // Σ_j W_nj of values of the control points.
  Vec3 Sum(int n, const std::vector<Vec3>& values) const;
  // p_n in the soft body's own axes.
  Vec3 Position(int n, const std::vector<Vec3>& x) const;
};

// Reads those of an instance, of a soft body with `count` control points. What is wrong is told to `reader`: then there
// are no points.
Weights ReadWeights(size_t count, Reader* reader);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_WEIGHTS_H_
