#include "impedance.h"

#include <algorithm>
#include <cmath>

#include "kinematics.h"

namespace mjframes {
namespace {

// out += scale times row i of the constraint Jacobian.
void AddRow(const mjModel* m, const mjData* d, int i, double scale, double* out) {
  if (mj_isSparse(m)) {
    for (int k = 0; k < d->efc_J_rownnz[i]; k++) {
      const int at = d->efc_J_rowadr[i] + k;
      out[d->efc_J_colind[at]] += scale * d->efc_J[at];
    }
  } else {
    mju_addToScl(out, d->efc_J + i * m->nv, scale, m->nv);
  }
}

bool IsPyramid(const mjModel* m, const mjContact& contact) {
  return contact.dim > 1 && m->opt.cone == mjCONE_PYRAMIDAL;
}

// What MuJoCo took for the inverse inertia along the contact's normal.
double AssumedInverse(const mjModel* m, const mjData* d, const mjContact& contact) {
  if (!(m->opt.enableflags & mjENBL_DIAGEXACT) && contact.geom[0] >= 0 && contact.geom[1] >= 0) {
    const int body1 = m->geom_bodyid[contact.geom[0]], body2 = m->geom_bodyid[contact.geom[1]];
    return m->body_invweight0[2 * body1] + m->body_invweight0[2 * body2];
  }
  const double first = d->efc_diagA[contact.efc_address], slope = contact.friction[0];
  return IsPyramid(m, contact) ? first / (2 * contact.mu * contact.mu * (1 + slope * slope)) : first;
}

// Rows of one direction in space have one R, or it would depend on the axes: those of a connect, and of a weld's
// translation and rotation.
int RowsTogether(const mjModel* m, const mjData* d, int i) {
  if (d->efc_type[i] != mjCNSTR_EQUALITY || (m->opt.enableflags & mjENBL_DIAGEXACT)) return 1;
  const int type = m->eq_type[d->efc_id[i]];
  return type == mjEQ_CONNECT || type == mjEQ_WELD ? 3 : 1;
}

// By what the rows from i on are longer than rates of translation or rotation without entering MuJoCo's own R.
double RowLength(const mjModel* m, const mjData* d, int i) {
  if (RowsTogether(m, d, i) == 1 || m->eq_type[d->efc_id[i]] != mjEQ_WELD) return 1;
  const bool turns = i >= 3 && d->efc_id[i - 3] == d->efc_id[i];
  return turns ? m->eq_data[mjNEQDATA * d->efc_id[i] + 10] : 1;  // torquescale
}

void SetResistance(mjData* d, int i, double inverse_inertia) {
  const double impedance = d->efc_KBIP[4 * i + 2];
  const double R = std::max(mjMINVAL, inverse_inertia * (1 - impedance) / impedance);
  d->efc_R[i] = R;
  d->efc_D[i] = 1 / R;
  if (d->nisland > 0) {
    d->iefc_R[d->map_efc2iefc[i]] = R;
    d->iefc_D[d->map_efc2iefc[i]] = 1 / R;
  }
}

}  // namespace

int RowCount(const mjModel* m, const mjContact& contact) {
  if (contact.dim == 1) return 1;
  return m->opt.cone == mjCONE_PYRAMIDAL ? 2 * (contact.dim - 1) : contact.dim;
}

Impedance::Impedance(const mjModel* m)
    : row_(m->nv), half_(m->nv), path_(m->nv), sqrt_inverse_(m->nv), marked_(m->nv) {}

void Impedance::Start(const mjModel* m, const mjData* d) {
  for (int i = 0; i < m->nv; i++) sqrt_inverse_[i] = std::sqrt(d->qLDiagInv[i]);
  std::fill(marked_.begin(), marked_.end(), 0);
}

void Impedance::Mark(const Kinematics& kinematics) {
  for (const Mover& mover : kinematics.movers()) std::fill_n(marked_.begin() + mover.dof, mover.dofs, 1);
}

bool Impedance::RowConcerns(const mjModel* m, const mjData* d, int i) const {
  if (mj_isSparse(m)) {
    const int* columns = d->efc_J_colind + d->efc_J_rowadr[i];
    return std::any_of(columns, columns + d->efc_J_rownnz[i], [this](int dof) { return marked_[dof]; });
  }
  for (int k = 0; k < m->nv; k++) {
    if (marked_[k] && d->efc_J[i * m->nv + k] != 0) return true;
  }
  return false;
}

bool Impedance::Concerns(const mjModel* m, const mjData* d, const mjContact& contact) const {
  return RowConcerns(m, d, contact.efc_address);
}

// Of row_.
double Impedance::InverseInertia(const mjModel* m, mjData* d) {
  if (!SolvePaths(m, d)) mj_solveM2(m, d, half_.data(), row_.data(), sqrt_inverse_.data(), 1);
  return mju_dot(half_.data(), half_.data(), m->nv);
}

// half = D^(−½) L^(−ᵀ) row where whatever of the row is not zero lies, in each tree, on one path from its root: there
// the rows of L are packed and need no indices. False where it does not.
bool Impedance::SolvePaths(const mjModel* m, const mjData* d) {
  const double* row = row_.data();
  std::fill(half_.begin(), half_.end(), 0.0);
  for (int last = m->nv - 1; last >= 0; last--) {
    if (row[last] == 0) continue;
    const int* path = m->M_colind + m->M_rowadr[last];
    const int length = m->M_rownnz[last];
    double* x = path_.data();
    for (int k = length - 1, dof = last; dof >= path[0]; dof--) {
      if (dof == path[k]) {
        x[k--] = row[dof];
      } else if (row[dof] != 0) {
        return false;
      }
    }
    for (int k = length - 1; k > 0; k--) {
      if (x[k] != 0) mju_addToScl(x, d->qLD + m->M_rowadr[path[k]], -x[k], m->M_rownnz[path[k]] - 1);
    }
    for (int k = 0; k < length; k++) half_[path[k]] = x[k] * sqrt_inverse_[path[k]];
    last = path[0];
  }
  return true;
}

void Impedance::ScaleContact(const mjModel* m, mjData* d, const mjContact& contact) {
  const double assumed = AssumedInverse(m, d, contact);
  // the normal is the mean of a pyramid's first two edges, or the first row
  const int edges = IsPyramid(m, contact) ? 2 : 1;
  std::fill(row_.begin(), row_.end(), 0.0);
  for (int e = 0; e < edges; e++) AddRow(m, d, contact.efc_address + e, 1.0 / edges, row_.data());
  const double actual = InverseInertia(m, d);
  if (!(assumed > mjMINVAL) || !(actual > mjMINVAL)) return;
  for (int r = 0; r < RowCount(m, contact); r++) {
    const int i = contact.efc_address + r;
    SetResistance(d, i, actual / assumed * d->efc_diagA[i]);
  }
}

void Impedance::ScaleOthers(const mjModel* m, mjData* d) {
  int count = 0;
  for (int first = 0; first < d->ne + d->nf + d->nl; first += count) {
    count = RowsTogether(m, d, first);
    bool concerns = false;
    for (int i = first; i < first + count && !concerns; i++) concerns = RowConcerns(m, d, i);
    if (!concerns) continue;
    double sum = 0;
    for (int i = first; i < first + count; i++) {
      std::fill(row_.begin(), row_.end(), 0.0);
      AddRow(m, d, i, 1, row_.data());
      sum += InverseInertia(m, d);
    }
    const double length = RowLength(m, d, first), actual = sum / (count * length * length);
    if (!(actual > mjMINVAL)) continue;
    for (int i = first; i < first + count; i++) SetResistance(d, i, actual);
  }
}

}  // namespace mjframes
