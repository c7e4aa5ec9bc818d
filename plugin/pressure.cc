#include "pressure.h"

#include <mujoco/mujoco.h>

#include <algorithm>

#include "simd.h"

namespace mjframes {
double ShareOut(double* distance, int begin, int end, double reach) {
  const double deepest = ExtremesOf(distance + begin, end - begin).least;
  if (deepest == mjMAXVAL) {
    std::fill(distance + begin, distance + end, 0.0);
    return mjMAXVAL;
  }
  double total = 0, mean = 0;
  for (int s = begin; s < end; s++) {
    const double height = distance[s] - deepest;
    if (!(height < reach)) {
      distance[s] = 0;
      continue;
    }
    const double share = 1 - height / reach;
    mean += share * share * distance[s];
    distance[s] = share * share;
    total += distance[s];
  }
  for (int s = begin; s < end; s++) {
    if (distance[s] > 0) distance[s] /= total;
  }
  return mean / total;
}

}  // namespace mjframes
