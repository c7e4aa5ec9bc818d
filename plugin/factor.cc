#include "factor.h"

#include <algorithm>
#include <cstddef>

#include "constants.h"
#include "elimination.h"

namespace mjframes {
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
