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

// A vertex that is higher than its cluster's deepest by this many contact radii or more has no share in the contact.
constexpr double kBlend = 1;  // [-]

// A contact found again at the same place to rounding is the same; anything farther is another one.
constexpr double kSamePlace = 1e-9;  // [m]

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
    const Vec3 x = body.kinematics().WorldPosition(d, patch.point[j]);
    for (int c = 0; c < 3; c++) AddScaled(out + c * n, patch.weight.data() + j * n, x[c], n);
  }
  if (patch.offset.empty()) return;
  const Mat3 axes = body.kinematics().Axes(d);
  for (int c = 0; c < 3; c++) {
    for (int e = 0; e < 3; e++) AddScaled(out + c * n, patch.offset.data() + e * n, axes[3 * c + e], n);
  }
}

Vec3 Vertex(const double* skinned, int n, int s) { return {skinned[s], skinned[n + s], skinned[2 * n + s]}; }

// Where the clusters of a patch touch geom `other`, touching or not; one contact a cluster.
int ClusterContacts(const SoftBody& body, const Patch& patch, const mjData* d, const GeomQuery& other, double* skinned,
                    double* blend, ClusterContact* out) {
  const int n = patch.vertices;
  const double radius = body.contact_radius();
  SkinPatch(body, patch, d, skinned);
  int begin = 0, count = 0;
  for (const int size : patch.cluster) {
    const int end = begin + size;
    double deepest = mjMAXVAL;
    for (int s = begin; s < end; s++) {
      blend[s] = other.Distance(Vertex(skinned, n, s)) - radius;
      deepest = std::min(deepest, blend[s]);
    }
    ClusterContact contact = {0, {}, {}, begin, end};
    double total = 0;
    for (int s = begin; s < end; s++) {
      const double share = std::max(0.0, 1 - (blend[s] - deepest) / (kBlend * radius));
      contact.distance += share * share * blend[s];
      blend[s] = share * share;
      total += blend[s];
    }
    contact.distance /= total;
    Vec3 centre{};
    for (int s = begin; s < end; s++) {
      if (blend[s] == 0) continue;
      blend[s] /= total;
      const Vec3 p = Vertex(skinned, n, s);
      centre = centre + blend[s] * p;
      contact.normal = contact.normal + blend[s] * other.Normal(p);
    }
    // opposite normals cancel where a thin geom is between the vertices: no direction, no contact
    const double length = Norm(contact.normal);
    if (length > mjMINVAL) {
      contact.normal = (1 / length) * contact.normal;
      contact.position = centre - (radius + 0.5 * contact.distance) * contact.normal;
      out[count++] = contact;
    }
    begin = end;
  }
  return count;
}

// Contacts between geom g1 and patch g2, as an entry of mjCOLLISIONFUNC gives them.
int CollidePatch(const SoftBody& body, const Patch& patch, const mjModel* m, mjData* d, mjPreContact* con, int g1,
                 int g2, double margin) {
  const GeomQuery other(m, d, g1);
  if (!other.valid) return 0;
  double skinned[3 * kMaxPatchVertices], blend[kMaxPatchVertices];
  ClusterContact contact[kMaxClusters];
  const int found = ClusterContacts(body, patch, d, other, skinned, blend, contact);
  const int limit = mj_maxContact(m, g1, g2, -1);
  int count = 0;
  for (int i = 0; i < found && count < limit; i++) {
    if (!(contact[i].distance < margin)) continue;
    con[count].dist = contact[i].distance;
    for (int c = 0; c < 3; c++) {
      con[count].pos[c] = contact[i].position[c];
      con[count].normal[c] = contact[i].normal[c];
      con[count].tangent[c] = 0;
    }
    count++;
  }
  return count;
}

int CollisionHook(const mjModel* m, mjData* d, mjPreContact* con, int g1, int g2, mjtNum margin) {
  const SoftBody* body1 = GetSoftBody(m, d, m->geom_plugin[g1]);
  const SoftBody* body2 = GetSoftBody(m, d, m->geom_plugin[g2]);
  if (!body1 && !body2) return g_original[m->geom_type[g1]][m->geom_type[g2]](m, d, con, g1, g2, margin);
  if (body1 && body2) return 0;  // soft bodies pass through each other
  const SoftBody* body = body1 ? body1 : body2;
  if (body->kinematics().IsHeldBy(m, m->geom_bodyid[body1 ? g2 : g1])) return 0;
  if (body2) {
    const Patch* patch = body2->FindPatch(g2);
    return patch ? CollidePatch(*body2, *patch, m, d, con, g1, g2, margin) : 0;
  }
  const Patch* patch = body1->FindPatch(g1);
  const int count = patch ? CollidePatch(*body1, *patch, m, d, con, g2, g1, margin) : 0;
  for (int i = 0; i < count; i++) mju_scl3(con[i].normal, con[i].normal, -1);
  return count;
}

int RowCount(const mjModel* m, const mjContact& contact) {
  if (contact.dim == 1) return 1;
  return m->opt.cone == mjCONE_PYRAMIDAL ? 2 * (contact.dim - 1) : contact.dim;
}

// What constraint row `r` of the contact measures: translation along one world direction, rotation about another.
struct Measure {
  Vec3 along, about;
};

Measure RowMeasure(const mjModel* m, const mjContact& contact, int r) {
  const auto axis = [&contact](int i) {
    return Vec3{contact.frame[3 * i], contact.frame[3 * i + 1], contact.frame[3 * i + 2]};
  };
  if (contact.dim == 1 || m->opt.cone == mjCONE_ELLIPTIC)
    return r < 3 ? Measure{axis(r), {}} : Measure{{}, axis(r - 3)};
  const double scale = (r % 2 == 0 ? 1 : -1) * contact.friction[r / 2];
  const int i = r / 2 + 1;
  return i < 3 ? Measure{axis(0) + scale * axis(i), {}} : Measure{axis(0), scale * axis(i - 3)};
}

bool MovesBody(const mjModel* m, int dof, int body) {
  while (body > m->dof_bodyid[dof]) body = m->body_parentid[body];
  return body == m->dof_bodyid[dof];
}

// What the row measures at `position` on `body` for a unit rate of degree of freedom `dof`.
double RigidEntry(const mjModel* m, const mjData* d, int body, const Vec3& position, const Measure& measure, int dof) {
  if (!MovesBody(m, dof, body)) return 0;
  const mjtNum* cdof = d->cdof + 6 * dof;
  const mjtNum* centre = d->subtree_com + 3 * m->body_rootid[body];
  const Vec3 rotation = {cdof[0], cdof[1], cdof[2]}, arm = position - Vec3{centre[0], centre[1], centre[2]};
  return Dot(measure.along, Vec3{cdof[3], cdof[4], cdof[5]} + Cross(rotation, arm)) + Dot(measure.about, rotation);
}

// Overwrites the entries of constraint row `i` for the degrees of freedom that the soft body's nodes have; where they
// are those of a robot's links, what is touched may move with them too. side: of the patch in the contact.
void WriteRow(const Kinematics& kinematics, const std::vector<Share>& share, const mjModel* m, mjData* d,
              const mjContact& contact, int r, int side) {
  const int i = contact.efc_address + r;
  const bool sparse = mj_isSparse(m);
  const int* columns = sparse ? d->efc_J_colind + d->efc_J_rowadr[i] : nullptr;
  double* row = d->efc_J + (sparse ? d->efc_J_rowadr[i] : i * m->nv);
  const int patch_body = m->geom_bodyid[contact.geom[side]], other_body = m->geom_bodyid[contact.geom[1 - side]];
  const Measure measure = RowMeasure(m, contact, r);
  const Vec3 local = kinematics.ToLocal(d, measure.along), position = {contact.pos[0], contact.pos[1], contact.pos[2]};
  const bool turning = kinematics.turning();
  const double sign = side == 1 ? 1 : -1;
  const int entries = sparse ? d->efc_J_rownnz[i] : m->nv;
  int entry = 0;
  for (size_t n = 0; n < kinematics.nodes().size(); n++) {
    const Node& node = kinematics.nodes()[n];
    for (int a = 0; a < node.dofs; a++) {
      const int dof = node.dof + a;
      if (sparse) {
        while (entry < entries && columns[entry] < dof) entry++;
        if (entry == entries) return;
        if (columns[entry] != dof) continue;
      } else {
        entry = dof;
      }
      double value = kinematics.RowEntry(share[n], local, static_cast<int>(n), a);
      if (turning) {
        value += RigidEntry(m, d, patch_body, position, {{}, measure.about}, dof) -
                 RigidEntry(m, d, other_body, position, measure, dof);
      }
      row[entry] = sign * value;
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

ContactScratch::ContactScratch(const mjModel* m)
    : row(m->nv),
      half(m->nv),
      sqrt_inverse(m->nv),
      omega(kMaxCarried * m->nbody),
      share(m->nv),
      skinned(3 * kMaxPatchVertices),
      blend(kMaxPatchVertices) {}

void InstallCollisionHook() {
  for (int type = 0; type < mjNGEOMTYPES; type++) {
    mjfCollision* entry = &mjCOLLISIONFUNC[type][mjGEOM_SDF];
    g_original[type][mjGEOM_SDF] = *entry;
    if (*entry) *entry = CollisionHook;
  }
}

void WriteContactRows(const mjModel* m, mjData* d, ContactScratch* scratch) {
  for (int i = 0; i < m->nv; i++) scratch->sqrt_inverse[i] = std::sqrt(d->qLDiagInv[i]);
  ClusterContact found[kMaxClusters];
  int pair[2] = {-1, -1}, count = 0, next = 0;  // the pair of geoms whose clusters are in `found`
  for (int c = 0; c < d->ncon; c++) {
    const mjContact& contact = d->contact[c];
    if (contact.geom[0] < 0 || contact.geom[1] < 0 || contact.efc_address < 0) continue;
    const int side = GetSoftBody(m, d, m->geom_plugin[contact.geom[1]]) ? 1 : 0;
    const SoftBody* body = GetSoftBody(m, d, m->geom_plugin[contact.geom[side]]);
    const Patch* patch = body ? body->FindPatch(contact.geom[side]) : nullptr;
    if (!patch) continue;
    if (contact.geom[0] != pair[0] || contact.geom[1] != pair[1]) {
      std::copy(contact.geom, contact.geom + 2, pair);
      count = ClusterContacts(*body, *patch, d, GeomQuery(m, d, contact.geom[1 - side]), scratch->skinned.data(),
                              scratch->blend.data(), found);
      next = 0;
    }
    // contacts of a pair come in the order of the clusters, without those that do not touch
    while (next < count &&
           Norm(found[next].position - Vec3{contact.pos[0], contact.pos[1], contact.pos[2]}) > kSamePlace) {
      next++;
    }
    if (next == count) continue;
    for (size_t j = 0; j < patch->point.size(); j++) {
      const double* weight = patch->weight.data() + j * patch->vertices;
      scratch->omega[j] = 0;
      for (int s = found[next].begin; s < found[next].end; s++) scratch->omega[j] += scratch->blend[s] * weight[s];
    }
    const Vec3 position = {contact.pos[0], contact.pos[1], contact.pos[2]};
    body->kinematics().PointShares(patch->point, scratch->omega.data(), body->kinematics().PositionToLocal(d, position),
                                   &scratch->share);
    for (int r = 0; r < RowCount(m, contact); r++) {
      WriteRow(body->kinematics(), scratch->share, m, d, contact, r, side);
    }
    ScaleImpedance(m, d, contact, scratch);
    next++;
  }
}

}  // namespace mjframes
