#include "contact.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "distance.h"
#include "linear.h"
#include "multiversion.h"
#include "soft.h"

namespace mjframes {
namespace {

// Contacts of one patch with one geom: three hold a patch up, a fourth keeps a square from rocking; curved and
// edged geoms get twice as many. MuJoCo's own limit is respected as well.
constexpr int kPlaneContacts = 4;
constexpr int kMaxContacts = 8;

// A vertex deeper by 1 mm counts like one that is farther from the chosen ones by this many mm: depth must win
// over spread, but rounding in the depths must not reshuffle the contacts of a body at rest.
constexpr double kDepthPreference = 10;

// Ties of symmetric shapes go to the earlier vertex, whatever the rounding.
constexpr double kTieBreak = 1e-4;  // [-] of the distance

// A contact belongs to the vertex it was made from to rounding; anything farther is not that vertex.
constexpr double kSameVertex = 1e-6;  // [m]

std::array<std::array<mjfCollision, mjNGEOMTYPES>, mjNGEOMTYPES> g_original;  // written once, at load

MJFRAMES_MULTIVERSION
void AddScaled(double* __restrict out, const double* __restrict weight, double value, int n) {
  for (int s = 0; s < n; s++) out[s] += weight[s] * value;
}

// World positions of the vertices by component: out[c n + s] = Σ_j W_j(s) x_j
void SkinPatch(const SoftBody& body, const Patch& patch, const mjData* d, double* out) {
  const int n = patch.vertices;
  std::fill(out, out + 3 * n, 0.0);
  for (size_t j = 0; j < patch.point.size(); j++) {
    const double* x = d->xpos + 3 * body.points()[patch.point[j]].body;
    for (int c = 0; c < 3; c++) AddScaled(out + c * n, patch.weight.data() + j * n, x[c], n);
  }
}

Vec3 Vertex(const double* skinned, int n, int s) { return {skinned[s], skinned[n + s], skinned[2 * n + s]}; }

// Chooses up to `limit` of the candidates, deep and well spread, and returns them in vertex order.
int Choose(const Patch& patch, const int* candidate, const double* depth, int count, int limit, int* chosen) {
  if (count <= limit) {
    std::copy(candidate, candidate + count, chosen);
    return count;
  }
  const int n = patch.vertices;
  double spread[kMaxPatchVertices];  // rest distance to the nearest chosen vertex, at first to the centre
  Vec3 centre{};
  for (int i = 0; i < count; i++) centre = centre + (1.0 / count) * Vertex(patch.rest.data(), n, candidate[i]);
  for (int i = 0; i < count; i++) spread[i] = Norm(Vertex(patch.rest.data(), n, candidate[i]) - centre);
  for (int pick = 0; pick < limit; pick++) {
    int best = 0;
    double best_score = -mjMAXVAL;
    for (int i = 0; i < count; i++) {
      const double score = spread[i] * (1 - kTieBreak * i / count) + kDepthPreference * depth[i];
      if (spread[i] >= 0 && score > best_score) {
        best = i;
        best_score = score;
      }
    }
    const Vec3 point = Vertex(patch.rest.data(), n, candidate[best]);
    for (int i = 0; i < count; i++) {
      const double distance = Norm(Vertex(patch.rest.data(), n, candidate[i]) - point);
      // the first spread was measured from the centre: it says nothing about distances between contacts
      spread[i] = spread[i] < 0 ? -1 : pick == 0 ? distance : std::min(spread[i], distance);
    }
    spread[best] = -1;  // taken
  }
  int picked = 0;
  for (int i = 0; i < count; i++) {
    if (spread[i] < 0) chosen[picked++] = candidate[i];
  }
  return picked;
}

// mjCOLLISIONFUNC entry: contacts between geom g1 and patch g2.
int CollidePatch(const SoftBody& body, const Patch& patch, const mjModel* m, mjData* d, mjPreContact* con, int g1,
                 int g2, double margin) {
  const GeomQuery other(m, d, g1);
  if (!other.valid) return 0;
  const int limit =
      std::min(mj_maxContact(m, g1, g2, -1), m->geom_type[g1] == mjGEOM_PLANE ? kPlaneContacts : kMaxContacts);
  if (limit <= 0) return 0;

  double skinned[3 * kMaxPatchVertices], depth[kMaxPatchVertices];
  int candidate[kMaxPatchVertices];
  const int n = patch.vertices;
  const double radius = body.contact_radius();
  SkinPatch(body, patch, d, skinned);
  int count = 0;
  for (int s = 0; s < n; s++) {
    Vec3 normal;
    const double distance = other.Distance(Vertex(skinned, n, s), &normal) - radius;
    if (distance < margin) {
      candidate[count] = s;
      depth[count++] = -distance;
    }
  }
  int chosen[kMaxContacts];
  const int picked = Choose(patch, candidate, depth, count, limit, chosen);
  for (int i = 0; i < picked; i++) {
    const Vec3 p = Vertex(skinned, n, chosen[i]);
    Vec3 normal;
    const double distance = other.Distance(p, &normal) - radius;
    const Vec3 position = p - (radius + 0.5 * distance) * normal;
    con[i].dist = distance;
    for (int c = 0; c < 3; c++) {
      con[i].pos[c] = position[c];
      con[i].normal[c] = normal[c];
      con[i].tangent[c] = 0;
    }
  }
  return picked;
}

int CollisionHook(const mjModel* m, mjData* d, mjPreContact* con, int g1, int g2, mjtNum margin) {
  const SoftBody* body1 = GetSoftBody(m, d, m->geom_plugin[g1]);
  const SoftBody* body2 = GetSoftBody(m, d, m->geom_plugin[g2]);
  if (!body1 && !body2) return g_original[m->geom_type[g1]][m->geom_type[g2]](m, d, con, g1, g2, margin);
  if (body1 && body2) return 0;  // soft bodies pass through each other
  if (body2) {
    const Patch* patch = body2->FindPatch(g2);
    return patch ? CollidePatch(*body2, *patch, m, d, con, g1, g2, margin) : 0;
  }
  const Patch* patch = body1->FindPatch(g1);
  const int count = patch ? CollidePatch(*body1, *patch, m, d, con, g2, g1, margin) : 0;
  for (int i = 0; i < count; i++) mju_scl3(con[i].normal, con[i].normal, -1);
  return count;
}

// The vertex that a contact was made from: its sphere's centre lies on the normal through the contact position.
// Contacts of a pair come in vertex order, so the search goes on from `start`.
int FindVertex(const mjContact& contact, int side, double radius, const double* skinned, int n, int start) {
  const double offset = (side == 1 ? 1 : -1) * (radius + 0.5 * contact.dist);
  const Vec3 centre = {contact.pos[0] + offset * contact.frame[0], contact.pos[1] + offset * contact.frame[1],
                       contact.pos[2] + offset * contact.frame[2]};
  for (int i = 0; i < n; i++) {
    const int s = start + i < n ? start + i : start + i - n;
    const Vec3 difference = Vertex(skinned, n, s) - centre;
    if (Dot(difference, difference) < kSameVertex * kSameVertex) return s;
  }
  return -1;
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

void InstallCollisionHook() {
  for (int type = 0; type < mjNGEOMTYPES; type++) {
    mjfCollision* entry = &mjCOLLISIONFUNC[type][mjGEOM_SDF];
    g_original[type][mjGEOM_SDF] = *entry;
    if (*entry) *entry = CollisionHook;
  }
}

void WriteContactRows(const mjModel* m, mjData* d, ContactScratch* scratch) {
  for (int i = 0; i < m->nv; i++) scratch->sqrt_inverse[i] = std::sqrt(d->qLDiagInv[i]);
  const Patch* skinned_patch = nullptr;
  int other_geom = -1, last_vertex = -1;
  for (int c = 0; c < d->ncon; c++) {
    const mjContact& contact = d->contact[c];
    if (contact.geom[0] < 0 || contact.geom[1] < 0 || contact.efc_address < 0) continue;
    for (int side = 0; side < 2; side++) {
      const int geom = contact.geom[side];
      const SoftBody* body = GetSoftBody(m, d, m->geom_plugin[geom]);
      const Patch* patch = body ? body->FindPatch(geom) : nullptr;
      if (!patch) continue;
      if (patch != skinned_patch) {
        SkinPatch(*body, *patch, d, scratch->skinned.data());
        skinned_patch = patch;
        other_geom = -1;
      }
      if (other_geom != contact.geom[1 - side]) {
        other_geom = contact.geom[1 - side];
        last_vertex = -1;
      }
      const int s = FindVertex(contact, side, body->contact_radius(), scratch->skinned.data(), patch->vertices,
                               last_vertex + 1);
      if (s < 0) continue;
      last_vertex = s;
      std::vector<double>& share = scratch->share;
      std::fill(share.begin(), share.end(), 0.0);
      for (size_t j = 0; j < patch->point.size(); j++) {
        share[body->points()[patch->point[j]].depth] += patch->weight[j * patch->vertices + s];
      }
      for (int depth = body->points()[patch->owner].depth; depth > 0; depth--) share[depth - 1] += share[depth];
      const double* axes = d->xmat + 9 * body->points()[patch->owner].body;
      for (int r = 0; r < RowCount(m, contact); r++) {
        Vec3 local;
        const Vec3 direction = RowDirection(m, contact, r);
        mju_mulMatTVec3(local.data(), axes, direction.data());
        WriteRow(*body, *patch, m, d, contact.efc_address + r, side == 1 ? 1 : -1, local, share);
      }
      ScaleImpedance(m, d, contact, scratch);
    }
  }
}

}  // namespace mjframes
