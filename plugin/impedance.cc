#include "impedance.h"

#include <algorithm>
#include <optional>
#include <vector>

#include "stack.h"
#include "world.h"

namespace mjframes {
namespace {

bool IsPyramid(const mjModel* m, const mjContact& contact) {
  return contact.dim > 1 && m->opt.cone == mjCONE_PYRAMIDAL;
}

// Of what a geom rides on [1/kg]: a free soft body in one piece, or a rigid body as MuJoCo sees it. A soft body that is
// held does not move in one piece: none.
std::optional<double> InverseMass(const mjModel* m, const mjData* d, int geom) {
  for (int body = m->geom_bodyid[geom]; body > 0; body = m->body_parentid[body]) {
    const SoftBody* soft = GetSoftBody(d, m->body_plugin[body]);
    if (soft) return soft->kinematics().held() ? std::nullopt : std::optional(1 / soft->mass());
  }
  return m->body_invweight0[2 * m->geom_bodyid[geom]];
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

// By what the rows from i on are longer than rates of translation or rotation without entering MuJoCo's own R.
double RowLength(const mjModel* m, const mjData* d, int i) {
  if (RowsTogether(m, d, i) == 1 || m->eq_type[d->efc_id[i]] != mjEQ_WELD) return 1;
  const bool turns = i >= 3 && d->efc_id[i - 3] == d->efc_id[i];
  return turns ? m->eq_data[mjNEQDATA * d->efc_id[i] + 10] : 1;  // torquescale
}

SoftBody* SoftOf(const mjModel* m, const mjData* d, int dof) {
  return GetSoftBody(d, m->body_plugin[m->dof_bodyid[dof]]);
}

double JacobianEntry(const mjModel* m, const mjData* d, int i, int dof) {
  if (!mj_isSparse(m)) return d->efc_J[i * m->nv + dof];
  const int *begin = d->efc_J_colind + d->efc_J_rowadr[i], *end = begin + d->efc_J_rownnz[i];
  const int* at = std::lower_bound(begin, end, dof);
  return at != end && *at == dof ? d->efc_J[d->efc_J_rowadr[i] + (at - begin)] : 0;
}

// Σ_j |g_j| of row i. A body's slides feel what its own points and those on slides below are pushed by; a link between
// has none. push: of each mover.
double SumOfPushes(const mjModel* m, const mjData* d, const SoftBody& soft, int i, Vec3* push) {
  const std::vector<Mover>& movers = soft.kinematics().movers();
  const auto slides = [&](int n) { return m->body_plugin[movers[n].body] == soft.instance(); };
  const int count = static_cast<int>(movers.size());
  double sum = 0;
  for (int n = 0; n < count; n++) {
    push[n] = {};
    if (!slides(n)) continue;
    for (int dof = movers[n].dof; dof < movers[n].dof + 3; dof++) {
      push[n] = push[n] + JacobianEntry(m, d, i, dof) * ToVec3(d->xaxis + 3 * m->dof_jntid[dof]);
    }
    int above = movers[n].parent;
    while (above >= 0 && !slides(above)) above = movers[above].parent;
    if (above >= 0) push[above] = push[above] - push[n];
  }
  for (int n = 0; n < count; n++) sum += Norm(push[n]);
  return sum;
}

// How much more of a soft body the first rows of a group see than a tie is to.
double Excess(const mjModel* m, mjData* d, const SoftBody& soft, const RowGroup& group, int rows) {
  const size_t movers = soft.kinematics().movers().size();
  if (!HasRoom(d, 3 * movers)) return 0;
  double seen = 0, most = 0;
  for (int k = 0; k < group.size; k++) {
    if (SoftOf(m, d, group.dof[k]) != &soft) continue;
    for (int r = 0; r < rows; r++) seen += group.y[kLanes * k + r] * group.y[kLanes * k + r];
  }
  MarkStack(d);
  Vec3* push = static_cast<Vec3*>(mj_stackAllocByte(d, movers * sizeof(Vec3), alignof(Vec3)));
  for (int r = 0; r < rows; r++) {
    const double sum = SumOfPushes(m, d, soft, group.row + r, push);
    most += sum * sum / soft.mass();
  }
  FreeStack(d);
  return most > mjMINVAL ? std::max(0.0, seen - most) : 0;
}

// The same of all soft bodies that they tie.
double Excess(const mjModel* m, mjData* d, const RowGroup& group, int rows) {
  double sum = 0;
  const SoftBody* last = nullptr;
  for (int k = 0; k < group.size; k++) {
    const SoftBody* soft = SoftOf(m, d, group.dof[k]);
    if (soft && soft != last) sum += Excess(m, d, *soft, group, rows);
    if (soft) last = soft;
  }
  return sum;
}

void SetFromInverse(mjData* d, int i, double inverse_inertia) {
  const double impedance = d->efc_KBIP[4 * i + 2];
  SetResistance(d, i, std::max(mjMINVAL, inverse_inertia * (1 - impedance) / impedance));
}

}  // namespace

void SetResistance(mjData* d, int i, double R) {
  d->efc_R[i] = R;
  d->efc_D[i] = 1 / R;
  if (d->nisland > 0) {
    d->iefc_R[d->map_efc2iefc[i]] = R;
    d->iefc_D[d->map_efc2iefc[i]] = 1 / R;
  }
}

bool IsContact(const mjData* d, int i) { return d->efc_type[i] >= mjCNSTR_CONTACT_FRICTIONLESS; }

int RowCount(const mjModel* m, const mjContact& contact) {
  if (contact.dim == 1) return 1;
  return m->opt.cone == mjCONE_PYRAMIDAL ? 2 * (contact.dim - 1) : contact.dim;
}

// Rows of one direction in space have one R, or it would depend on the axes: those of a connect, and of a weld's
// translation and rotation.
int RowsTogether(const mjModel* m, const mjData* d, int i) {
  if (IsContact(d, i)) return RowCount(m, d->contact[d->efc_id[i]]);
  if (d->efc_type[i] != mjCNSTR_EQUALITY || (m->opt.enableflags & mjENBL_DIAGEXACT)) return 1;
  const int type = m->eq_type[d->efc_id[i]];
  return type == mjEQ_CONNECT || type == mjEQ_WELD ? 3 : 1;
}

void SetResistances(const mjModel* m, mjData* d, const double* lies, const RowGroup& group) {
  const int first = group.row, count = RowsTogether(m, d, first);
  Lanes product[kLanes];
  MultiplyGroups(m, group, group, product);
  if (IsContact(d, first)) {
    const mjContact& contact = d->contact[d->efc_id[first]];
    const double assumed = AssumedInverse(m, d, contact);
    // the normal is the mean of a pyramid's first two edges, or the first row
    double actual = IsPyramid(m, contact) ? 0.25 * (product[0][0] + 2 * product[0][1] + product[1][1]) : product[0][0];
    if (const double flat = lies ? lies[d->efc_id[first]] : 0; flat > 0) {
      const auto one = InverseMass(m, d, contact.geom[0]), other = InverseMass(m, d, contact.geom[1]);
      if (one && other) actual += flat * (*one + *other - actual);
    }
    if (!(assumed > mjMINVAL) || !(actual > mjMINVAL)) return;
    for (int i = first; i < first + count; i++) SetFromInverse(d, i, actual / assumed * d->efc_diagA[i]);
    return;
  }
  double sum = m->opt.enableflags & mjENBL_DIAGEXACT ? 0 : -Excess(m, d, group, count);
  for (int r = 0; r < count; r++) sum += product[r][r];
  const double length = RowLength(m, d, first), actual = sum / (count * length * length);
  if (!(actual > mjMINVAL)) return;
  for (int i = first; i < first + count; i++) SetFromInverse(d, i, actual);
}

}  // namespace mjframes
