#include "shares.h"

#include <algorithm>
#include <cmath>

#include "constants.h"
#include "simd.h"

namespace mjframes {
namespace {

// out += scale Yᵀ C⁻¹ Y (n × n, up to the diagonal, in rows of `width`) of rows [Y, C] (o × width), which are lost;
// what has no stiffness carries nothing.
MJFRAMES_INLINE void AddCarriedOf(double* __restrict rows, int own, int width, double scale, double* __restrict out) {
  const int n = width - own;
  double largest = 0;
  for (int i = 0; i < own; i++) largest = std::max(largest, rows[static_cast<size_t>(i) * width + n + i]);
  for (int i = 0; i < own; i++) {  // Y becomes L⁻¹ Y, C = L Lᵀ
    double* pivot = rows + static_cast<size_t>(i) * width;
    const bool stiff = pivot[n + i] > kSingularShare * largest;
    const double inverse = stiff ? 1 / std::sqrt(pivot[n + i]) : 0;
    for (int c = 0; c < width; c++) pivot[c] *= inverse;
    for (int r = i + 1; stiff && r < own; r++) {
      double* row = rows + static_cast<size_t>(r) * width;
      const double factor = pivot[n + r];
      for (int c = 0; c < width; c++) row[c] -= factor * pivot[c];
    }
  }
  for (int a = 0; a < n; a++) {
    double* sum = out + static_cast<size_t>(a) * width;
    for (int i = 0; i < own; i++) {
      const double* row = rows + static_cast<size_t>(i) * width;
      const double factor = scale * row[a];
      for (int b = 0; b <= a; b++) sum[b] += factor * row[b];
    }
  }
}

void AddCarried(double* rows, int own, int width, double scale, double* out) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL { AddCarriedOf(rows, own, width, scale, out); });
}

}  // namespace

std::vector<double> RestOf(const std::vector<double>& stiffness, int width, int own) {
  const int n = width - own;
  std::vector<double> whole = stiffness, rest;
  std::vector<double> rows(stiffness.begin() + static_cast<ptrdiff_t>(n) * width, stiffness.end());
  if (n > 0) AddCarried(rows.data(), own, width, -1, whole.data());
  for (int a = 0; a < n; a++) {
    const double* row = whole.data() + static_cast<size_t>(a) * width;
    rest.insert(rest.end(), row, row + a + 1);
  }
  return rest;
}

void ScaleStiffness(const std::vector<double>& built, int width, const Shares& shares,
                    const std::vector<double>& factors, double* scratch, double* scaled) {
  const int own = shares.own, n = width - own;
  const size_t size = ShareSize(width, own);
  const double last = factors.back();
  double* K = scaled;
  const double* share = shares.rows.data();
  for (int r = n; r < width; r++) {
    for (int c = 0; c <= r; c++, share++) {
      double sum = last * built[static_cast<size_t>(r) * width + c];
      for (size_t m = 0; m + 1 < factors.size(); m++) sum += (factors[m] - last) * share[m * size];
      K[static_cast<size_t>(r) * width + c] = K[static_cast<size_t>(c) * width + r] = sum;
    }
  }
  if (n == 0) return;
  double trace = 0, built_trace = 0;
  for (int r = n; r < width; r++) {
    trace += K[static_cast<size_t>(r) * width + r];
    built_trace += built[static_cast<size_t>(r) * width + r];
  }
  const double mean = built_trace > 0 ? trace / built_trace : last;
  const double* rest = shares.rest.data();
  for (int a = 0; a < n; a++) {
    for (int b = 0; b <= a; b++, rest++) K[static_cast<size_t>(a) * width + b] = mean * *rest;
  }
  std::copy_n(K + static_cast<size_t>(n) * width, static_cast<size_t>(own) * width, scratch);
  AddCarried(scratch, own, width, 1, K);
  for (int a = 0; a < n; a++) {
    for (int b = 0; b < a; b++) K[static_cast<size_t>(b) * width + a] = K[static_cast<size_t>(a) * width + b];
  }
}

}  // namespace mjframes
