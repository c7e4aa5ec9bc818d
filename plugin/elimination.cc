#include "elimination.h"

#include <mujoco/mujoco.h>

#include <algorithm>

namespace mjframes {
namespace {

// row[r] −= Σ_k scaled[k][r] U_k of kRows rows, in kColumns registers of columns from c on.
template <int kRows, int kColumns, typename V>
MJFRAMES_INLINE void UpdateTile(double* const* row, const double* scaled, int stride, double* const* U, int size,
                                int c) {
  constexpr int kTiles = kRows * kColumns;
  const auto place = [&](int n) { return row[n / kColumns] + c + n % kColumns * kWidth<V>; };
  V sum[kTiles];
  MJFRAMES_UNROLL
  for (int n = 0; n < kTiles; n++) sum[n] = Load<V>(place(n));
  for (int k = 0; k < size; k++) {
    V u[kColumns];
    MJFRAMES_UNROLL
    for (int n = 0; n < kColumns; n++) u[n] = Load<V>(U[k] + c + n * kWidth<V>);
    MJFRAMES_UNROLL
    for (int n = 0; n < kTiles; n++) sum[n] -= scaled[k * stride + n / kColumns] * u[n % kColumns];
  }
  MJFRAMES_UNROLL
  for (int n = 0; n < kTiles; n++) Store(sum[n], place(n));
}

// The same for all columns of rows that are as long as the last one, which is the longest.
template <int kRows, typename V>
MJFRAMES_INLINE void UpdateRows(double* const* row, const double* scaled, int stride, double* const* U, int size,
                                int length) {
  int c = 0;
  for (; c + 2 * kWidth<V> < length; c += 3 * kWidth<V>) UpdateTile<kRows, 3, V>(row, scaled, stride, U, size, c);
  if (c + kWidth<V> < length) {
    UpdateTile<kRows, 2, V>(row, scaled, stride, U, size, c);
  } else if (c < length) {
    UpdateTile<kRows, 1, V>(row, scaled, stride, U, size, c);
  }
}

// row[r] −= Σ_k scaled[k][r] U_k of `count` rows in a row, the first of which has `length` entries.
template <typename V>
MJFRAMES_INLINE void UpdateAll(double* const* row, int count, const double* scaled, int stride, double* const* U,
                               int size, int length) {
  int r = 0;
  for (; r + kTile <= count; r += kTile)
    UpdateRows<kTile, V>(row + r, scaled + r, stride, U, size, length + r + kTile - 1);
  for (; r < count; r++) UpdateRows<1, V>(row + r, scaled + r, stride, U, size, length + r);
}

// A few of a chain at a time: first among themselves, then from the rest of it, at last the chain from what is above.
template <typename V>
MJFRAMES_INLINE void EliminateOf(double* const* U, int size, double* const* row, int above, double* scaled,
                                 double* inverse) {
  const int stride = above + size;
  for (int end = size, first; end > 0; end = first) {
    first = std::max(0, end - kTile);
    for (int k = end - 1; k >= first; k--) {
      inverse[k] = 1 / U[k][above + k];
      for (int i = first; i < k; i++) {
        const double factor = U[k][above + i] * inverse[k];
        for (int c = 0; c <= above + i; c += kWidth<V>) Store(Load<V>(U[i] + c) - factor * Load<V>(U[k] + c), U[i] + c);
      }
      for (int a = 0; a < above + first; a++) scaled[k * stride + a] = U[k][a] * inverse[k];
    }
    UpdateAll<V>(U, first, scaled + first * stride + above, stride, U + first, end - first, above + 1);
  }
  UpdateAll<V>(row, above, scaled, stride, U, size, 1);
}

// A chain's unknowns last to first: x −= (U_ka / D_k) x_k, x_k /= D_k.
template <typename V>
MJFRAMES_INLINE void Descend(const double* U, int begin, int k, double inverse, double* x) {
  const double part = x[k] *= inverse;
  int a = begin;
  for (; a + kWidth<V> <= k; a += kWidth<V>) Store(Load<V>(x + a) - part * Load<V>(U + a), x + a);
  for (; a < k; a++) x[a] -= part * U[a];
}

// x_k −= Σ_a (U_ka / D_k) x_a
template <typename V>
MJFRAMES_INLINE void Ascend(const double* U, int begin, int k, double inverse, double* x) {
  V sums = Fill<V>(0);
  int a = begin;
  for (; a + kWidth<V> <= k; a += kWidth<V>) sums += Load<V>(U + a) * Load<V>(x + a);
  double sum = 0;
  for (int lane = 0; lane < kWidth<V>; lane++) sum += sums[lane];
  for (; a < k; a++) sum += U[a] * x[a];
  x[k] -= inverse * sum;
}

}  // namespace

void Eliminate(double* const* U, int size, double* const* row, int above, double* scaled, double* inverse) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL { EliminateOf<V>(U, size, row, above, scaled, inverse); });
}

bool Envelope::Solve(double* x) const {
  double *inverse = memory, *scaled = memory + n;
  double* rows[kMostRows];
  for (int k = 0; k < n; k++) {
    rows[k] = Row(k);
    std::fill(rows[k] + k + 1, rows[k] + PadToTile(k + 1), 0.0);
  }
  for (int end = n; end > 0; end -= kMaxChain) {
    const int first = std::max(0, end - kMaxChain), left = *std::min_element(begin + first, begin + end);
    double* from_left[kMostRows];  // rows
    for (int k = left; k < end; k++) {
      std::fill(rows[k] + left, rows[k] + std::max(begin[k], left), 0.0);
      begin[k] = std::min(begin[k], left);
      from_left[k] = rows[k] + left;
    }
    Eliminate(from_left + first, end - first, from_left + left, first - left, scaled, inverse + first);
    for (int k = first; k < end; k++) {
      if (!(rows[k][k] > mjMINVAL)) return false;
    }
  }
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    for (int k = n - 1; k >= 0; k--) Descend<V>(rows[k], begin[k], k, inverse[k], x);
    for (int k = 0; k < n; k++) Ascend<V>(rows[k], begin[k], k, inverse[k], x);
  });
  return true;
}

}  // namespace mjframes
