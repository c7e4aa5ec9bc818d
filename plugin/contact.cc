#include "contact.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "affine_fit.h"
#include "constants.h"
#include "impedance.h"
#include "linear.h"
#include "patch_field.h"
#include "requirements.h"
#include "round_side.h"
#include "tendon.h"
#include "touch.h"
#include "world.h"

namespace mjframes {
namespace {

std::array<std::array<mjfCollision, mjNGEOMTYPES>, mjNGEOMTYPES> g_original;  // written once, at load

SoftSide SideOf(const mjModel* m, const mjData* d, int geom) {
  if (geom < 0) return {};  // a flex
  const SoftBody* body = GetSoftBody(d, SoftInstanceOf(m, geom));
  return {body, body ? body->contact().FindPatch(geom) : -1};
}

int CollisionHook(const mjModel* m, mjData* d, mjPreContact* con, int g1, int g2, mjtNum margin) {
  if (Tendon* tendon = TendonOf(m, d, g2)) {
    tendon->Measure(m, d);
    return 0;
  }
  const SoftSide side[2] = {SideOf(m, d, g1), SideOf(m, d, g2)};
  if (!side[0].body && !side[1].body) {
    return g_original[m->geom_type[g1]][m->geom_type[g2]](m, d, con, g1, g2, margin);
  }
  for (int s = 0; s < 2; s++) {
    if (side[s].body && side[s].body->kinematics().IsHeldBy(m->geom_bodyid[s == 0 ? g2 : g1])) return 0;
  }
  const int geom[2] = {g1, g2};
  TouchScratch scratch;
  Touch touch[kMaxTouches];
  const int found = FindTouches(m, d, geom, side, margin, &scratch, touch);
  if (found == 0 || WrongNumber(m, g1) || WrongNumber(m, g2)) return 0;  // of these World::CheckOptions tells
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

// What constraint row `r` of the contact measures: translation along one world direction, rotation about another.
struct Measure {
  Vec3 along, about;
};

Measure RowMeasure(const mjModel* m, const mjContact& contact, int r) {
  const auto axis = [&contact](int i) { return ToVec3(contact.frame + 3 * i); };
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

// Whether degree of freedom `dof` moves a flex that is a side of the contact.
bool MovesFlex(const mjModel* m, const mjContact& contact, int dof) {
  for (const int flex : contact.flex) {
    if (flex < 0) continue;
    const bool nodes = m->flex_interp[flex] != 0;
    const int* body = nodes ? m->flex_nodebodyid + m->flex_nodeadr[flex] : m->flex_vertbodyid + m->flex_vertadr[flex];
    const int count = nodes ? m->flex_nodenum[flex] : m->flex_vertnum[flex];
    if (std::any_of(body, body + count, [&](int b) { return b >= 0 && MovesBody(m, dof, b); })) return true;
  }
  return false;
}

// What the row measures at `position` on `body` for a unit rate of degree of freedom `dof`.
double RigidEntry(const mjModel* m, const mjData* d, int body, const Vec3& position, const Measure& measure, int dof) {
  if (!MovesBody(m, dof, body)) return 0;
  const mjtNum* cdof = d->cdof + 6 * dof;
  const Vec3 rotation = ToVec3(cdof), arm = position - ToVec3(d->subtree_com + 3 * m->body_rootid[body]);
  return Dot(measure.along, ToVec3(cdof + 3) + Cross(rotation, arm)) + Dot(measure.about, rotation);
}

// The soft bodies on either side of a contact and what of them its point is made of.
struct Sides {
  const Kinematics* kinematics[2];  // null for other geoms
  const std::vector<Moments>* moments[2];
  const double* shifts[2];  // Σ r · ∇N_j at and below the movers, null where r is nothing
  const Vec3* slopes[2];    // Σ ∇N_j, null where rows turn nothing
};

// What the row measures on side s for a unit rate of degree of freedom `dof`.
double SideEntry(const mjModel* m, const mjData* d, const mjContact& contact, const Sides& sides, int s,
                 const Measure& measure, const Vec3& local, int dof) {
  if (contact.geom[s] < 0) return 0;  // dofs that move a flex are left as they are
  const int body = m->geom_bodyid[contact.geom[s]];
  const Vec3 position = ToVec3(contact.pos);
  const Kinematics* kinematics = sides.kinematics[s];
  const int n = kinematics ? kinematics->MoverOfDof(dof) : -1;
  if (n < 0) return RigidEntry(m, d, body, position, measure, dof);
  return kinematics->RowEntry((*sides.moments[s])[n], local, n, dof - kinematics->movers()[n].dof) +
         RigidEntry(m, d, body, position, {{}, measure.about}, dof);
}

// What a row measures of a soft body whose movers only slide along its axes, all in these axes.
struct SlideMeasure {
  Vec3 along, across, about;  // translation, what of it is not along the normal, rotation
  const Moments* moments;
  const double* shifts;  // see Sides
  const Vec3* slopes;
};

// Its entries, which move nothing else. columns: of a sparse row, null for a dense one; of a mover all three are there,
// or none.
void WriteSlides(const std::vector<Mover>& movers, const SlideMeasure& measure, double sign, const int* columns,
                 int entries, double* row) {
  int entry = 0;
  for (size_t n = 0; n < movers.size(); n++) {
    const Mover& mover = movers[n];
    if (columns) {
      while (entry < entries && columns[entry] < mover.dof) entry++;
      if (entry == entries) return;
      if (columns[entry] != mover.dof) continue;
    } else {
      entry = mover.dof;
    }
    Vec3 own = measure.moments[n].weight * measure.along;
    if (measure.shifts) own = own + measure.shifts[n] * measure.across;
    if (measure.slopes) own = own + 0.5 * Cross(measure.about, measure.slopes[n]);
    for (int a = 0; a < 3; a++) row[entry + a] = sign * own[a];
  }
}

// Overwrites the entries of row `r` of the contact for the degrees of freedom that the movers of side s have; where
// they are those of a robot's links, the other side may move with them too.
void WriteRow(const mjModel* m, mjData* d, const mjContact& contact, const Sides& sides, int s, int r) {
  const int i = contact.efc_address + r;
  const bool sparse = mj_isSparse(m);
  const int* columns = sparse ? d->efc_J_colind + d->efc_J_rowadr[i] : nullptr;
  double* row = d->efc_J + (sparse ? d->efc_J_rowadr[i] : i * m->nv);
  const Measure measure = RowMeasure(m, contact, r);
  const Kinematics& kinematics = *sides.kinematics[s];
  Vec3 local[2];
  for (int side = 0; side < 2; side++) {
    if (sides.kinematics[side]) local[side] = sides.kinematics[side]->ToLocal(d, measure.along);
  }
  const double sign = s == 1 ? 1 : -1;
  const int entries = sparse ? d->efc_J_rownnz[i] : m->nv;
  if (!kinematics.turning()) {
    const Vec3 normal = ToVec3(contact.frame), across = measure.along - Dot(measure.along, normal) * normal;
    const bool turns = Dot(measure.about, measure.about) > 0;
    const SlideMeasure slides = {local[s],
                                 kinematics.ToLocal(d, across),
                                 kinematics.ToLocal(d, measure.about),
                                 sides.moments[s]->data(),
                                 sides.shifts[s],
                                 turns ? sides.slopes[s] : nullptr};
    return WriteSlides(kinematics.movers(), slides, sign, columns, entries, row);
  }
  const bool flex = contact.geom[1 - s] < 0;
  const int own = m->geom_bodyid[contact.geom[s]], other = flex ? own : m->geom_bodyid[contact.geom[1 - s]];
  int entry = 0;
  for (size_t n = 0; n < kinematics.movers().size(); n++) {
    const Mover& mover = kinematics.movers()[n];
    for (int a = 0; a < mover.dofs; a++) {
      const int dof = mover.dof + a;
      // rows have room for what moves the two bodies, and islands know of no more: dense rows must not have more either
      if (!sparse && !MovesBody(m, dof, own) && !MovesBody(m, dof, other)) continue;
      if (flex && MovesFlex(m, contact, dof)) continue;
      if (sparse) {
        while (entry < entries && columns[entry] < dof) entry++;
        if (entry == entries) return;
        if (columns[entry] != dof) continue;
      } else {
        entry = dof;
      }
      row[entry] = sign * (SideEntry(m, d, contact, sides, s, measure, local[s], dof) -
                           SideEntry(m, d, contact, sides, 1 - s, measure, local[1 - s], dof));
    }
  }
}

// add(s, weight): adds the weights of the control points in the touching point of side s.
template <typename Add>
void WriteContact(const mjModel* m, mjData* d, const mjContact& contact, const SoftSide side[2],
                  ContactScratch* scratch, const Add& add) {
  Sides sides = {};
  for (int s = 0; s < 2; s++) {
    if (!side[s].body) continue;
    const Kinematics& kinematics = side[s].body->kinematics();
    double* omega = scratch->omega.data();
    std::fill_n(omega, kinematics.points().size(), 0.0);
    add(s, omega);
    const Vec3 lever = kinematics.Lever(omega, kinematics.PositionToLocal(d, ToVec3(contact.pos)));
    kinematics.PointMoments(omega, lever, &scratch->moments[s]);
    sides.kinematics[s] = &kinematics;
    sides.moments[s] = &scratch->moments[s];
    const bool shifted = contact.dim > 1 && !side[1 - s].body, turned = contact.dim > 3;
    AffineFit fit;
    if (kinematics.turning() || !(shifted || turned) || !fit.Find(kinematics.x(), omega)) continue;
    if (shifted) {
      double* shifts = scratch->shifts[s].data();
      const Vec3 along = fit.Along(lever);
      kinematics.SumToMovers(omega, [&](size_t j) { return Dot(along, fit.From(j)); }, shifts);
      sides.shifts[s] = shifts;
    }
    if (turned) {
      Vec3* slopes = scratch->slopes[s].data();
      kinematics.SumToMovers(omega, [&](size_t j) { return fit.Along(fit.From(j)); }, slopes);
      sides.slopes[s] = slopes;
    }
  }
  for (int s = 0; s < 2; s++) {
    for (int r = 0; sides.kinematics[s] && r < RowCount(m, contact); r++) WriteRow(m, d, contact, sides, s, r);
  }
}

// Whether there are rows to write: of a patch and what is not its own body.
bool IsSoft(const SoftSide side[2]) {
  if (side[0].body == side[1].body) return false;
  return std::all_of(side, side + 2, [](const SoftSide& one) { return !one.body || one.patch >= 0; });
}

// The largest distance of this contact and those after it between the same geoms.
double HighestOfPair(const mjData* d, int first) {
  double highest = d->contact[first].dist;
  for (int c = first + 1; c < d->ncon && std::equal(d->contact[c].geom, d->contact[c].geom + 2, d->contact[first].geom);
       c++) {
    highest = std::max(highest, d->contact[c].dist);
  }
  return highest;
}

// For a contact that is not one of FindTouches: it acts on the material that is there. Those of a flex MuJoCo finds
// itself, by the patch's signed distance (patch_field.h); others a program may have moved, or made.
void WriteForeignContact(const mjModel* m, mjData* d, const mjContact& contact, const SoftSide side[2],
                         ContactScratch* scratch) {
  WriteContact(m, d, contact, side, scratch,
               [&](int s, double* weight) { AddPlaceWeights(side[s], d, ToVec3(contact.pos), weight); });
}

}  // namespace

ContactScratch::ContactScratch(const mjModel* m)
    : omega(kMaxCarried * m->nbody),
      moments{std::vector<Moments>(m->nv), std::vector<Moments>(m->nv)},
      shifts{std::vector<double>(m->nv), std::vector<double>(m->nv)},
      slopes{std::vector<Vec3>(m->nv), std::vector<Vec3>(m->nv)},
      last(m->nplugin) {}

void InstallCollisionHook() {
  for (int type = 0; type < mjNGEOMTYPES; type++) {
    mjfCollision* entry = &mjCOLLISIONFUNC[type][mjGEOM_SDF];
    g_original[type][mjGEOM_SDF] = *entry;
    if (*entry) *entry = CollisionHook;
  }
}

bool TouchSearch::Find(int c) {
  const mjContact& contact = d_->contact[c];
  touch_ = nullptr;
  if (contact.geom[0] != pair_[0] || contact.geom[1] != pair_[1]) {
    for (int s = 0; s < 2; s++) {
      pair_[s] = contact.geom[s];
      side_[s] = SideOf(m_, d_, pair_[s]);
    }
    recalled_ = IsSoft(side_) && pair_[0] >= 0 && pair_[1] >= 0;
    count_ = next_ = 0;
    if (recalled_) count_ = RecallTouches(d_, pair_, side_, &scratch_, found_);
  }
  if (!IsSoft(side_)) return false;
  // contacts of a pair come in the order of its touches, without those that are too far
  const Vec3 position = ToVec3(contact.pos);
  const auto find = [&] {
    for (int i = 0; i < count_; i++) {
      const int at = (next_ + i) % count_;
      if (Norm(found_[at].position - position) <= kSamePlace) return at;
    }
    return -1;
  };
  int same = find();
  if (same < 0 && recalled_) {  // mjData is a copy, or has other contacts than those found last
    recalled_ = false;
    count_ = FindTouches(m_, d_, pair_, side_, HighestOfPair(d_, c) + kSamePlace, &scratch_, found_);
    next_ = 0;
    same = find();
  }
  if (same >= 0) {
    touch_ = found_ + same;
    next_ = same + 1;
  }
  return true;
}

void WriteContactRows(const mjModel* m, mjData* d, ContactScratch* scratch, ContactDents* dents, double* lies) {
  TouchSearch search(m, d);
  for (int c = 0; c < d->ncon; c++) {
    const mjContact& contact = d->contact[c];
    if (dents) dents[c] = {};
    if (lies) lies[c] = 0;
    if (contact.efc_address < 0 || !search.Find(c)) continue;
    const SoftSide* side = search.side();
    const Touch* touch = search.touch();
    if (!touch) {
      WriteForeignContact(m, d, contact, side, scratch);
      continue;
    }
    WriteContact(m, d, contact, side, scratch,
                 [&](int s, double* weight) { AddTouchWeights(side, *touch, search.scratch(), s, weight); });
    if (dents) {
      dents[c] = TouchDents(side, *touch);
      const int s = side[1].body ? 1 : 0, geom = contact.geom[1 - s];
      if (geom >= 0) {
        const int body = m->geom_bodyid[geom];
        const ContactModel& soft = side[s].body->contact().model();
        dents[c].lift = RollingLift(side[s].body->kinematics(), soft, side[s].patch, d, m->opt.timestep, *touch, body);
      }
    }
    if (lies) lies[c] = touch->lies;
  }
  if (dents) Squeeze(m, d, dents, &scratch->last);
}

}  // namespace mjframes
