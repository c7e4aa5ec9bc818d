#include "row_inertia.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "constants.h"
#include "impedance.h"

namespace mjframes {

RowInertia::RowInertia(const mjModel* m, std::vector<char> marked)
    : marked_(std::move(marked)), depends_(m->nv), dof_(m->nv), place_(m->nv), sqrt_inverse_(m->nv) {}

void RowInertia::Start(const mjModel* m, const mjData* d) {
  for (int i = 0; i < m->nv; i++) sqrt_inverse_[i] = std::sqrt(d->qLDiagInv[i]);
}

RowGroup RowInertia::Find(const mjModel* m, const mjData* d, int row, int rows) {
  RowGroup group = {row, rows, false, true, 0, nullptr, nullptr};
  int last = -1, left = 0;  // how many are marked in depends_
  const auto depend = [&](int dof) {
    left += !depends_[dof];
    depends_[dof] = 1;
    last = std::max(last, dof);
  };
  const int* geom = IsContact(d, row) ? d->contact[d->efc_id[row]].geom : nullptr;
  if (geom && geom[0] >= 0 && geom[1] >= 0) {
    for (int s = 0; s < 2; s++) {
      const int body = m->body_weldid[m->geom_bodyid[geom[s]]];
      if (m->body_dofnum[body] > 0) depend(m->body_dofadr[body] + m->body_dofnum[body] - 1);
    }
  } else {
    for (int i = row; i < row + rows; i++) {
      if (mj_isSparse(m)) {
        std::for_each_n(d->efc_J_colind + d->efc_J_rowadr[i], d->efc_J_rownnz[i], depend);
      } else {
        for (int dof = 0; dof < m->nv; dof++) {
          if (d->efc_J[i * m->nv + dof] != 0) depend(dof);
        }
      }
    }
  }
  for (int dof = last, below = -1; left > 0; dof--) {
    if (!depends_[dof]) continue;
    depends_[dof] = 0;
    left--;
    group.marked = group.marked || marked_[dof];
    const int parent = below < 0 ? -1 : m->dof_parentid[below];
    group.paths = group.paths && (parent < 0 || parent == dof);
    below = dof;
    dof_[group.size++] = dof;
    if (m->dof_parentid[dof] >= 0) depend(m->dof_parentid[dof]);
  }
  std::reverse(dof_.begin(), dof_.begin() + group.size);
  return group;
}

void RowInertia::Solve(const mjModel* m, const mjData* d, RowGroup* group) {
  const int size = group->size;
  int* dofs = group->dof;
  double* y = group->y;
  std::copy_n(dof_.begin(), size, dofs);
  std::fill_n(y, kLanes * size, 0.0);
  const bool sparse = mj_isSparse(m);
  if (sparse) {
    for (int k = 0; k < size; k++) place_[dofs[k]] = k;
  }
  for (int r = 0; r < group->rows; r++) {
    const int i = group->row + r;
    if (sparse) {
      const int first = d->efc_J_rowadr[i];
      for (int e = first; e < first + d->efc_J_rownnz[i]; e++) y[kLanes * place_[d->efc_J_colind[e]] + r] = d->efc_J[e];
    } else {
      for (int k = 0; k < size; k++) y[kLanes * k + r] = d->efc_J[i * m->nv + dofs[k]];
    }
  }
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    const double* L[kTile];
    Lanes own[kTile];
    for (int k = size - 1; k >= 0;) {
      // up to kTile of them at once: those above each are the ones before it
      int together = 0, above = 0;
      for (; together < std::min(kTile, k + 1); together++) {
        const int dof = dofs[k - together], at = m->M_rowadr[dof];
        if (together > 0 && m->M_rownnz[dof] != above) break;
        above = m->M_rownnz[dof] - 1;
        if (above > k - together || (above > 0 && dofs[k - together - above] != m->M_colind[at])) break;
        L[together] = d->qLD + at;
      }
      if (together == 0) {
        const int dof = dofs[k], at = m->M_rowadr[dof];
        own[0] = Load(y + kLanes * k);
        for (int a = m->M_rownnz[dof] - 2, before = k - 1; a >= 0; a--, before--) {
          while (dofs[before] != m->M_colind[at + a]) before--;
          double* x = y + kLanes * before;
          Store(Load(x) - d->qLD[at + a] * own[0], x);
        }
        together = 1;
      } else {
        above = m->M_rownnz[dofs[k - together + 1]] - 1;  // of the uppermost
        for (int t = 0; t < together; t++) {
          own[t] = Load(y + kLanes * (k - t));
          for (int u = 0; u < t; u++) own[t] -= L[u][above + together - 1 - t] * own[u];
        }
        double* x = y + kLanes * (k - together + 1 - above);
        if (together == kTile) {
          for (int a = 0; a < above; a++, x += kLanes) {
            Lanes sum = Load(x);
            for (int t = 0; t < kTile; t++) sum -= L[t][a] * own[t];
            Store(sum, x);
          }
        } else {
          for (int a = 0; a < above; a++, x += kLanes) {
            Lanes sum = Load(x);
            for (int t = 0; t < together; t++) sum -= L[t][a] * own[t];
            Store(sum, x);
          }
        }
      }
      for (int t = 0; t < together; t++) Store(sqrt_inverse_[dofs[k - t]] * own[t], y + kLanes * (k - t));
      k -= together;
    }
  });
}

void MultiplyGroups(const mjModel* m, const RowGroup& p, const RowGroup& q, Lanes* out) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    Lanes sum[kLanes] = {}, odd[kLanes] = {};  // two of each, that need not wait for each other
    // the end of what is in the tree of entry k
    const auto tree_end = [m](const RowGroup& group, int k) {
      const int tree = m->dof_treeid[group.dof[k]];
      while (k < group.size && m->dof_treeid[group.dof[k]] == tree) k++;
      return k;
    };
    for (int a = 0, b = 0; a < p.size && b < q.size;) {
      const int most = std::min(p.size - a, q.size - b);
      int shared = 0;
      while (shared + kLanes <= most && std::memcmp(p.dof + a + shared, q.dof + b + shared, sizeof(int[kLanes])) == 0) {
        shared += kLanes;
      }
      while (shared < most && p.dof[a + shared] == q.dof[b + shared]) shared++;
      const double *some = p.y + kLanes * a, *other = q.y + kLanes * b;
      int k = 0;
      for (; k + 2 <= shared; k += 2, some += 2 * kLanes, other += 2 * kLanes) {
        const Lanes of_q = Load(other), next = Load(other + kLanes);
        for (int r = 0; r < kLanes; r++) sum[r] += some[r] * of_q;
        for (int r = 0; r < kLanes; r++) odd[r] += some[kLanes + r] * next;
      }
      if (k < shared) {
        const Lanes of_q = Load(other);
        for (int r = 0; r < kLanes; r++) sum[r] += some[r] * of_q;
      }
      a += shared;
      b += shared;
      if (shared == most) break;
      const int p_dof = p.dof[a], q_dof = q.dof[b];
      const bool same_tree = m->dof_treeid[p_dof] == m->dof_treeid[q_dof];
      const bool parted = same_tree && p.paths && q.paths;  // up to the next tree
      if (parted || p_dof < q_dof) a = parted || !same_tree ? tree_end(p, a) : a + 1;
      if (parted || q_dof < p_dof) b = parted || !same_tree ? tree_end(q, b) : b + 1;
    }
    for (int r = 0; r < kLanes; r++) Store(sum[r] + odd[r], reinterpret_cast<double*>(out + r));
  });
}

}  // namespace mjframes
