#include "shares.h"

#include <algorithm>
#include <cmath>

#include "constants.h"

namespace mjframes {
namespace {

// out += scale Yᵀ C⁻¹ Y (n × n, in rows of `width`) of rows [Y, C] (o × width), which are lost; what has no stiffness
// carries nothing.
void AddCarried(double* rows, int own, int width, double scale, double* out) {
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
  for (int i = 0; i < own; i++) {
    const double* row = rows + static_cast<size_t>(i) * width;
    for (int a = 0; a < n; a++) {
      const double factor = scale * row[a];
      for (int b = 0; b < n; b++) out[static_cast<size_t>(a) * width + b] += factor * row[b];
    }
  }
}

}  // namespace

std::vector<double> RestOf(const std::vector<double>& stiffness, int width, int own) {
  const int n = width - own;
  std::vector<double> whole = stiffness, rest;
  std::vector<double> rows(stiffness.begin() + static_cast<ptrdiff_t>(n) * width, stiffness.end());
  if (n > 0) AddCarried(rows.data(), own, width, -1, whole.data());
  for (int a = 0; a < n; a++) rest.insert(rest.end(), &whole[static_cast<size_t>(a) * width], &whole[a * width + n]);
  return rest;
}

void ScaleStiffness(const std::vector<double>& built, const Shares& shares, const std::vector<double>& factors,
                    double* scratch, std::vector<double>* scaled) {
  const int own = shares.own, width = static_cast<int>(std::lround(std::sqrt(built.size()))), n = width - own;
  const size_t size = ShareSize(width, own);
  const double last = factors.back();
  double* K = scaled->data();
  const double* share = shares.rows.data();
  for (int r = n; r < width; r++) {
    for (int c = 0; c <= r; c++, share++) {
      double sum = last * built[static_cast<size_t>(r) * width + c];
      for (size_t m = 0; m + 1 < factors.size(); m++) sum += (factors[m] - last) * share[m * size];
      K[static_cast<size_t>(r) * width + c] = K[static_cast<size_t>(c) * width + r] = sum;
    }
  }
  if (n == 0) return;
  for (int a = 0; a < n; a++) {
    for (int b = 0; b < n; b++)
      K[static_cast<size_t>(a) * width + b] = last * shares.rest[static_cast<size_t>(a) * n + b];
  }
  std::copy_n(K + static_cast<size_t>(n) * width, static_cast<size_t>(own) * width, scratch);
  AddCarried(scratch, own, width, 1, K);
}

}  // namespace mjframes
