#include "pressure.h"

#include <mujoco/mujoco.h>

#include <algorithm>

#include "simd.h"

namespace mjframes {
namespace {

// The least of values begin … end, and at most mjMAXVAL.
MJFRAMES_MULTIVERSION
double Least(const double* value, int begin, int end) {
  Lanes least = Fill(mjMAXVAL);
  int s = begin;
  for (; s + kLanes <= end; s += kLanes) {
    const Lanes some = Load(value + s);
    least = some < least ? some : least;
  }
  double result = std::min({least[0], least[1], least[2], least[3]});
  for (; s < end; s++) result = std::min(result, value[s]);
  return result;
}

}  // namespace

double ShareOut(double* distance, int begin, int end, double reach) {
  const double deepest = Least(distance, begin, end);
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
