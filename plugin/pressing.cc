#include "pressing.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "constants.h"

namespace mjframes {
namespace {

// The mean of a over the places that bear.
double MeanWhere(const double* f, const double* a, int n) {
  double sum = 0;
  int count = 0;
  for (int t = 0; t < n; t++) {
    sum += f[t] > 0 ? a[t] : 0;
    count += f[t] > 0;
  }
  return sum / std::max(count, 1);
}

double Sum(const double* f, int n) {
  double sum = 0;
  for (int t = 0; t < n; t++) sum += f[t];
  return sum;
}

}  // namespace

double Press(const double* C, const double* gap, int n, double load, double* f, double* work) {
  double *residual = work, *direction = work + n, *change = work + 2 * n, *before = work + 3 * n;
  std::fill_n(f, n, load / n);
  std::fill_n(direction, n, 0.0);
  double square_before = 1, approach = 0;
  bool goes_on = false;  // whether the last direction counts
  for (int step = 0; step < kPressSteps; step++) {
    mju_mulMatVec(residual, C, f, n, n);
    mju_addTo(residual, gap, n);
    approach = MeanWhere(f, residual, n);
    double square = 0, rounding = 0;
    for (int t = 0; t < n; t++) {
      if (f[t] > 0) rounding += kContent * kContent * residual[t] * residual[t];
      residual[t] -= approach;
      if (f[t] > 0) square += residual[t] * residual[t];
    }
    const double ratio = goes_on ? square / square_before : 0;
    for (int t = 0; t < n; t++) direction[t] = f[t] > 0 ? residual[t] + ratio * direction[t] : 0;
    mju_mulMatVec(change, C, direction, n, n);
    const double mean = MeanWhere(f, change, n);
    double slope = 0, curvature = 0;
    for (int t = 0; t < n; t++) {
      slope += residual[t] * direction[t];
      curvature += (change[t] - mean) * direction[t];
    }
    double length = slope / curvature;
    const bool descends = slope > 0 && curvature > 0 && square > rounding;
    if (!descends && goes_on) {  // conjugate to places that bear no more, the direction may go up
      goes_on = false;
      continue;
    }
    std::copy_n(f, n, before);
    for (int t = 0; descends && t < n; t++) f[t] = std::max(0.0, f[t] - length * direction[t]);
    if (!(Sum(f, n) > kKeptLoad * load)) {  // only along a conjugate direction: the residual's mean is 0
      std::copy_n(before, n, f);
      if (!goes_on) break;
      goes_on = false;
      continue;
    }
    goes_on = true;
    for (int t = 0; t < n; t++) {
      if (f[t] > 0 || before[t] > 0 || !(residual[t] < 0)) continue;
      if (!descends) length = 1 / C[t * n + t];  // those that bear are content
      f[t] = -length * residual[t];
      goes_on = false;
    }
    if (!descends && goes_on) break;
    const double scale = load / Sum(f, n);  // 1 but for what was cut off
    for (int t = 0; t < n; t++) f[t] *= scale;
    double moved = 0;
    for (int t = 0; t < n; t++) moved += std::abs(f[t] - before[t]);
    square_before = square;
    if (moved < kPressed * load) break;
  }
  return approach;
}

}  // namespace mjframes
