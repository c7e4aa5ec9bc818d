#include "factor.h"

#include <algorithm>
#include <cstddef>

#include "constants.h"
#include "simd.h"

namespace mjframes {
namespace {

int PadToTile(int n) { return (n + kTile - 1 + kWideLanes - 1) / kWideLanes * kWideLanes; }

// row[r] −= Σ_k scaled[k][r] U_k of kRows rows, in kColumns registers of columns from c on.
template <int kRows, int kColumns, typename V>
MJFRAMES_INLINE void UpdateTile(double* const* row, const double* scaled, int stride, double* const* U, int size,
                                int c) {
  V sum[kRows][kColumns];
  for (int r = 0; r < kRows; r++) {
    for (int n = 0; n < kColumns; n++) sum[r][n] = Load<V>(row[r] + c + n * kWidth<V>);
  }
  for (int k = 0; k < size; k++) {
    V u[kColumns];
    for (int n = 0; n < kColumns; n++) u[n] = Load<V>(U[k] + c + n * kWidth<V>);
    for (int r = 0; r < kRows; r++) {
      for (int n = 0; n < kColumns; n++) sum[r][n] -= scaled[k * stride + r] * u[n];
    }
  }
  for (int r = 0; r < kRows; r++) {
    for (int n = 0; n < kColumns; n++) Store(sum[r][n], row[r] + c + n * kWidth<V>);
  }
}

// The same for all columns of rows that are as long as the last one, which is the longest.
template <int kRows, typename V>
MJFRAMES_INLINE void UpdateRows(double* const* row, const double* scaled, int stride, double* const* U, int size,
                                int length) {
  int c = 0;
  for (; c + kWidth<V> < length; c += 2 * kWidth<V>) UpdateTile<kRows, 2, V>(row, scaled, stride, U, size, c);
  if (c < length) UpdateTile<kRows, 1, V>(row, scaled, stride, U, size, c);
}

// Eliminates a chain. U: its rows, `above` entries each before the chain's own; row: those above it.
template <typename V>
MJFRAMES_INLINE void EliminateOf(double* const* U, int size, double* const* row, int above, double* scaled,
                                 double* inverse) {
  for (int k = size - 1; k >= 0; k--) {
    inverse[k] = 1 / U[k][above + k];
    for (int i = 0; i < k; i++) {
      const double factor = U[k][above + i] * inverse[k];
      for (int c = 0; c <= above + i; c += kWidth<V>) Store(Load<V>(U[i] + c) - factor * Load<V>(U[k] + c), U[i] + c);
    }
    for (int a = 0; a < above; a++) scaled[k * above + a] = U[k][a] * inverse[k];
  }
  int a = 0;
  for (; a + kTile <= above; a += kTile) UpdateRows<kTile, V>(row + a, scaled + a, above, U, size, a + kTile);
  for (; a < above; a++) UpdateRows<1, V>(row + a, scaled + a, above, U, size, a + 1);
}

void Eliminate(double* const* U, int size, double* const* row, int above, double* scaled, double* inverse) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL { EliminateOf<V>(U, size, row, above, scaled, inverse); });
}

}  // namespace

InertiaFactor::InertiaFactor(const mjModel* m, const std::vector<bool>& trees) : start_(m->nv, 0) {
  size_t length = 0, scaled = 0, deepest = 0;
  for (int i = 0; i < m->nv; i++) {
    if (!trees[m->dof_treeid[i]]) continue;
    const int entries = m->M_rownnz[i];
    start_[i] = static_cast<int>(length);
    length += PadToTile(entries);
    const bool continues = !chains_.empty() && chains_.back().first + chains_.back().size == i &&
                           chains_.back().size < kMaxChain && entries == m->M_rownnz[i - 1] + 1 &&
                           m->M_colind[m->M_rowadr[i] + entries - 2] == i - 1;
    if (continues) {
      chains_.back().size++;
    } else {
      chains_.push_back({i, 1});
    }
    deepest = std::max(deepest, static_cast<size_t>(entries));
    scaled = std::max(scaled, static_cast<size_t>(chains_.back().size) * deepest);
  }
  std::reverse(chains_.begin(), chains_.end());
  rows_.resize(length);
  scaled_.resize(scaled);
  path_.resize(deepest);
}

bool InertiaFactor::Factor(const mjModel* m, mjData* d) {
  bool positive = true;
  const bool may_sleep = m->opt.enableflags & mjENBL_SLEEP;
  const auto asleep = [&](const Chain& chain) {
    return may_sleep && d->body_awake[m->dof_bodyid[chain.first]] == mjS_ASLEEP;
  };
  for (const Chain& chain : chains_) {
    if (asleep(chain)) continue;
    for (int i = chain.first; i < chain.first + chain.size; i++) {
      const int entries = m->M_rownnz[i];
      double* row = rows_.data() + start_[i];
      std::copy_n(d->M + m->M_rowadr[i], entries, row);
      std::fill(row + entries, row + PadToTile(entries), 0.0);
    }
  }
  for (const Chain& chain : chains_) {
    if (asleep(chain)) continue;
    double* U[kMaxChain];
    for (int k = 0; k < chain.size; k++) U[k] = rows_.data() + start_[chain.first + k];
    const int above = m->M_rownnz[chain.first] - 1;
    const int* column = m->M_colind + m->M_rowadr[chain.first];
    for (int a = 0; a < above; a++) path_[a] = rows_.data() + start_[column[a]];
    double* inverse = d->qLDiagInv + chain.first;
    Eliminate(U, chain.size, path_.data(), above, scaled_.data(), inverse);
    for (int k = 0; k < chain.size; k++) {
      double* out = d->qLD + m->M_rowadr[chain.first + k];
      for (int a = 0; a < above + k; a++) out[a] = U[k][a] * inverse[k];
      out[above + k] = U[k][above + k];
      positive = positive && out[above + k] > 0;
    }
  }
  return positive;
}

}  // namespace mjframes
