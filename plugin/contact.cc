#include "contact.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "linear.h"
#include "multiversion.h"
#include "soft.h"
#include "touch.h"

namespace mjframes {
namespace {

// A contact found again at the same place to rounding is the same; anything farther is another one.
constexpr double kSamePlace = 1e-9;  // [m]

std::array<std::array<mjfCollision, mjNGEOMTYPES>, mjNGEOMTYPES> g_original;  // written once, at load

MJFRAMES_MULTIVERSION
void AddScaled(double* __restrict out, const double* __restrict weight, double value, int n) {
  for (int s = 0; s < n; s++) out[s] += weight[s] * value;
}

}  // namespace

void SkinPatch(const SoftBody& body, const Patch& patch, const mjData* d, double* out) {
  const int n = patch.vertices;
  std::fill(out, out + 3 * n, 0.0);
  for (size_t j = 0; j < patch.point.size(); j++) {
    const double* x = d->xpos + 3 * body.points()[patch.point[j]].body;
    for (int c = 0; c < 3; c++) AddScaled(out + c * n, patch.weight.data() + j * n, x[c], n);
  }
}

namespace {

SoftSide SideOf(const mjModel* m, const mjData* d, int geom) {
  const SoftBody* body = GetSoftBody(m, d, m->geom_plugin[geom]);
  return {body, body ? body->FindPatch(geom) : -1};
}

int CollisionHook(const mjModel* m, mjData* d, mjPreContact* con, int g1, int g2, mjtNum margin) {
  const SoftSide side[2] = {SideOf(m, d, g1), SideOf(m, d, g2)};
  if (!side[0].body && !side[1].body) {
    return g_original[m->geom_type[g1]][m->geom_type[g2]](m, d, con, g1, g2, margin);
  }
  const int geom[2] = {g1, g2};
  TouchScratch scratch;
  Touch touch[kMaxTouches];
  const int found = FindTouches(m, d, geom, side, margin, &scratch, touch);
  const int limit = mj_maxContact(m, g1, g2, -1);
  int count = 0;
  for (int i = 0; i < found && count < limit; i++) {
    if (!(touch[i].distance < margin)) continue;
    con[count].dist = touch[i].distance;
    for (int c = 0; c < 3; c++) {
      con[count].pos[c] = touch[i].position[c];
      con[count].normal[c] = touch[i].normal[c];
      con[count].tangent[c] = 0;
    }
    count++;
  }
  return count;
}

int RowCount(const mjModel* m, const mjContact& contact) {
  if (contact.dim == 1) return 1;
  return m->opt.cone == mjCONE_PYRAMIDAL ? 2 * (contact.dim - 1) : contact.dim;
}

// World direction that row `r` of the contact measures translation along; zero for purely rotational rows.
Vec3 RowDirection(const mjModel* m, const mjContact& contact, int r) {
  const auto axis = [&contact](int i) {
    return i < 3 ? Vec3{contact.frame[3 * i], contact.frame[3 * i + 1], contact.frame[3 * i + 2]} : Vec3{};
  };
  if (contact.dim == 1 || m->opt.cone == mjCONE_ELLIPTIC) return axis(r);
  const double sign = r % 2 == 0 ? 1 : -1;
  return axis(0) + (sign * contact.friction[r / 2]) * axis(r / 2 + 1);
}

// Overwrites the entries of constraint row `i` for the soft body's degrees of freedom that move the patch.
// direction: in the soft body's axes.  share[t]: Σ W_j(s) over the control points at depth t and below.
void WriteRow(const SoftBody& body, const Patch& patch, const mjModel* m, mjData* d, int i, double sign,
              const Vec3& direction, const std::vector<double>& share) {
  const bool sparse = mj_isSparse(m);
  const int* columns = sparse ? d->efc_J_colind + d->efc_J_rowadr[i] : nullptr;
  double* row = d->efc_J + (sparse ? d->efc_J_rowadr[i] : i * m->nv);
  int entry = sparse ? d->efc_J_rownnz[i] - 1 : 0;
  for (int j = patch.owner; j >= 0; j = body.points()[j].parent) {
    const ControlPoint& point = body.points()[j];
    if (!point.moves()) break;
    for (int r = 2; r >= 0; r--) {
      const double value = sign * share[point.depth] * direction[r];
      if (sparse) {
        while (entry >= 0 && columns[entry] > point.dof + r) entry--;
        if (entry >= 0 && columns[entry] == point.dof + r) row[entry] = value;
      } else {
        row[point.dof + r] = value;
      }
    }
  }
}

// Jᵀ of the contact's normal as a dense vector: the mean of a pyramid's first two edges, or the first row.
void NormalRow(const mjModel* m, const mjData* d, const mjContact& contact, double* out) {
  const int edges = contact.dim > 1 && m->opt.cone == mjCONE_PYRAMIDAL ? 2 : 1;
  std::fill(out, out + m->nv, 0.0);
  for (int e = 0; e < edges; e++) {
    const int i = contact.efc_address + e;
    if (mj_isSparse(m)) {
      for (int k = 0; k < d->efc_J_rownnz[i]; k++) {
        const int at = d->efc_J_rowadr[i] + k;
        out[d->efc_J_colind[at]] += d->efc_J[at] / edges;
      }
    } else {
      for (int k = 0; k < m->nv; k++) out[k] += d->efc_J[i * m->nv + k] / edges;
    }
  }
}

// R is (1 − imp)/imp times the inverse inertia seen by the contact. MuJoCo took that of the rigid point masses;
// here it is put right to J A⁻¹ Jᵀ, from diagA, which stays as it was: doing it again gives the same.
void ScaleImpedance(const mjModel* m, mjData* d, const mjContact& contact, ContactScratch* scratch) {
  const int body1 = m->geom_bodyid[contact.geom[0]], body2 = m->geom_bodyid[contact.geom[1]];
  const double assumed = m->body_invweight0[2 * body1] + m->body_invweight0[2 * body2];
  NormalRow(m, d, contact, scratch->row.data());
  mj_solveM2(m, d, scratch->half.data(), scratch->row.data(), scratch->sqrt_inverse.data(), 1);
  const double actual = mju_dot(scratch->half.data(), scratch->half.data(), m->nv);
  if (!(assumed > mjMINVAL) || !(actual > mjMINVAL)) return;
  for (int r = 0; r < RowCount(m, contact); r++) {
    const int i = contact.efc_address + r;
    const double impedance = d->efc_KBIP[4 * i + 2];
    const double R = std::max(mjMINVAL, actual / assumed * d->efc_diagA[i] * (1 - impedance) / impedance);
    d->efc_R[i] = R;
    d->efc_D[i] = 1 / R;
    if (d->nisland > 0) {
      d->iefc_R[d->map_efc2iefc[i]] = R;
      d->iefc_D[d->map_efc2iefc[i]] = 1 / R;
    }
  }
}

}  // namespace

ContactScratch::ContactScratch(int nv, int nbody)
    : row(nv), half(nv), sqrt_inverse(nv), share(nv), weight(nbody), touch(std::make_unique<TouchScratch>()) {}

ContactScratch::~ContactScratch() = default;

void InstallCollisionHook() {
  for (int type = 0; type < mjNGEOMTYPES; type++) {
    mjfCollision* entry = &mjCOLLISIONFUNC[type][mjGEOM_SDF];
    g_original[type][mjGEOM_SDF] = *entry;
    if (*entry) *entry = CollisionHook;
  }
}

void WriteContactRows(const mjModel* m, mjData* d, ContactScratch* scratch) {
  for (int i = 0; i < m->nv; i++) scratch->sqrt_inverse[i] = std::sqrt(d->qLDiagInv[i]);
  Touch found[kMaxTouches];
  SoftSide side[2];
  int pair[2] = {-1, -1}, count = 0, next = 0;  // the pair of geoms whose touches are in `found`
  for (int c = 0; c < d->ncon; c++) {
    const mjContact& contact = d->contact[c];
    if (contact.geom[0] < 0 || contact.geom[1] < 0 || contact.efc_address < 0) continue;
    if (contact.geom[0] != pair[0] || contact.geom[1] != pair[1]) {
      for (int s = 0; s < 2; s++) {
        pair[s] = contact.geom[s];
        side[s] = SideOf(m, d, pair[s]);
      }
      double highest = contact.dist;
      for (int i = c + 1; i < d->ncon && std::equal(pair, pair + 2, d->contact[i].geom); i++) {
        highest = std::max(highest, d->contact[i].dist);
      }
      count = FindTouches(m, d, pair, side, highest + kSamePlace, scratch->touch.get(), found);
      next = 0;
    }
    // contacts of a pair come in the order of its touches, without those that are too far
    while (next < count &&
           Norm(found[next].position - Vec3{contact.pos[0], contact.pos[1], contact.pos[2]}) > kSamePlace) {
      next++;
    }
    if (next == count) continue;
    for (int s = 0; s < 2; s++) {
      if (!side[s].body) continue;
      const SoftBody& body = *side[s].body;
      const Patch& patch = body.patches()[side[s].patch];
      std::vector<double>& share = scratch->share;
      std::fill(share.begin(), share.end(), 0.0);
      std::fill(scratch->weight.begin(), scratch->weight.end(), 0.0);
      AddTouchWeights(d, side, found[next], *scratch->touch, s, scratch->weight.data());
      for (int j = patch.owner; j >= 0 && body.points()[j].moves(); j = body.points()[j].parent) {
        share[body.points()[j].depth] = scratch->weight[j];
      }
      for (int depth = body.points()[patch.owner].depth; depth > 0; depth--) share[depth - 1] += share[depth];
      const double* axes = d->xmat + 9 * body.points()[patch.owner].body;
      for (int r = 0; r < RowCount(m, contact); r++) {
        Vec3 local;
        const Vec3 direction = RowDirection(m, contact, r);
        mju_mulMatTVec3(local.data(), axes, direction.data());
        WriteRow(body, patch, m, d, contact.efc_address + r, s == 1 ? 1 : -1, local, share);
      }
    }
    ScaleImpedance(m, d, contact, scratch);
    next++;
  }
}

}  // namespace mjframes
