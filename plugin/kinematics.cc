#include "kinematics.h"

#include <algorithm>
#include <cmath>

#include "tendon.h"

namespace mjframes {
namespace {

// Whether the body lies square in its parent and has slide joints along x, y, z, and after them a ball or nothing.
bool SlidesAlongAxes(const mjModel* m, int body) {
  const int joints = m->body_jntnum[body];
  if (joints < 3 || joints > 4 || m->body_quat[4 * body] != 1) return false;
  if (joints == 4 && m->jnt_type[m->body_jntadr[body] + 3] != mjJNT_BALL) return false;
  for (int r = 0; r < 3; r++) {
    const int joint = m->body_jntadr[body] + r;
    if (m->jnt_type[joint] != mjJNT_SLIDE || m->jnt_axis[3 * joint + r] != 1) return false;
  }
  return true;
}

}  // namespace

void Kinematics::Create(const mjModel* m, int instance, Reader* reader) {
  FindPoints(m, instance, reader);
  if (!reader->ok()) return;
  FindMovers(m, instance);
  pair_of_.assign(points_.size() * points_.size(), -1);
  x_.resize(points_.size());
  v_.resize(points_.size());
  lever_.resize(points_.size());
}

void Kinematics::FindPoints(const mjModel* m, int instance, Reader* reader) {
  const auto rest = reader->Array<double>("point_rest");
  const auto mass = reader->Array<double>("point_mass");
  const auto carried = reader->Array<int32_t>("carrier_size");
  const auto order = reader->Array<int32_t>("carrier_point");
  const size_t count = order.size();
  const auto local = reader->ArrayOr<double>("point_offset", 0, 3 * count);
  const auto branch = reader->ArrayOr<int32_t>("point_branch", 0, count);
  if (!reader->Check(count >= 2 && rest.size() == 3 * count && mass.size() == count,
                     "its arrays of control points do not match each other")) {
    return;
  }
  points_.assign(count, ControlPoint{-1, -1, 0, false, false, {}, {}, 0, 0});
  size_t carrier = 0, next = 0;
  for (int body = 1; body < m->nbody; body++) {
    if (m->body_plugin[body] != instance) continue;
    if (!reader->Check(carrier < carried.size() && carried[carrier] > 0 && carried[carrier] <= kMaxCarried &&
                           next + carried[carrier] <= count,
                       "it has more bodies than control points")) {
      return;
    }
    if (!reader->Check(m->body_jntnum[body] == 0 || SlidesAlongAxes(m, body),
                       "each of its bodies has to have slide joints along x, y, z, with or without a ball, or none")) {
      return;
    }
    double total = 0;
    for (int i = 0; i < carried[carrier]; i++) {
      const int32_t j = order[next++];
      if (!reader->Check(j >= 0 && j < static_cast<int>(count) && points_[j].body < 0,
                         "its bodies do not match its control points: attach or copy the soft body as a whole")) {
        return;
      }
      const Vec3 at = ToVec3(local.data() + 3 * j);
      points_[j] = {body, -1, branch[j], false, Dot(at, at) > 0, at, ToVec3(rest.data() + 3 * j), mass[j], 0};
      total += mass[j];
    }
    if (!reader->Check(total > 0, "the masses of its control points have to be positive")) return;
    for (int i = 1; i <= carried[carrier]; i++) points_[order[next - i]].carried = total;
    carrier++;
  }
  reader->Check(next == count && carrier == carried.size(),
                "its bodies do not match its control points: attach or copy the soft body as a whole");
}

void Kinematics::FindMovers(const mjModel* m, int instance) {
  std::vector<int> moved(m->nbody, 0);  // points at and below each body
  for (const ControlPoint& point : points_) {
    for (int body = point.body; body > 0; body = m->body_parentid[body]) moved[body]++;
  }
  int root = m->nbody;  // the outermost body of the soft body's own
  for (const ControlPoint& point : points_) {
    if (m->body_jntnum[point.body] > 0) root = std::min(root, point.body);
  }
  if (root < m->nbody) {
    outermost_ = root;
    holder_ = m->body_parentid[root];
  }
  std::vector<int> mover_of(m->nbody, -1);
  int twists = 0, pairs = 0;
  for (int body = 1; body < m->nbody; body++) {
    if (moved[body] == 0) continue;
    const int above = mover_of[m->body_parentid[body]];
    mover_of[body] = above;
    const bool own = m->body_plugin[body] == instance;
    if (m->body_dofnum[body] == 0 || (!own && moved[body] == static_cast<int>(points_.size()))) continue;
    const Mover mover = {body,
                         above,
                         above < 0 ? 0 : movers_[above].depth + 1,
                         m->body_dofadr[body],
                         m->body_dofnum[body],
                         twists,
                         pairs,
                         0,
                         false};
    turning_ = turning_ || !own || mover.dofs > 3 || (above < 0 && m->body_parentid[body] != holder_) ||
               (above >= 0 && m->body_parentid[body] != movers_[above].body);
    twists += mover.dofs;
    pairs += mover.depth + 1;
    mover_of[body] = static_cast<int>(movers_.size());
    movers_.push_back(mover);
  }
  for (ControlPoint& point : points_) {
    point.mover = mover_of[point.body];
    if (point.mover >= 0) {
      Mover& mover = movers_[point.mover];
      mover.arms = mover.arms || point.offset || point.body != mover.body;
      turning_ = turning_ || point.offset;
    }
    point.still = point.mover < 0 && m->body_parentid[point.body] == holder_;
  }
  for (const ControlPoint& point : points_) {
    if (m->body_jntnum[point.body] > 0) continue;
    // what is held by the body that the soft body was attached to hangs in the holder, which is in that body
    const int outer = m->body_parentid[point.body];
    for (const int body : {outer, outer == holder_ ? m->body_parentid[holder_] : 0}) {
      if (body > 0 && !IsHeldBy(body)) held_by_.push_back(body);
    }
  }
  turns_ = turning_ || m->body_treeid[holder_] >= 0;
  if (turns_) bias_.resize(points_.size());
  stiffens_ = turning_;
  for (const ControlPoint& point : points_) stiffens_ = stiffens_ && (point.mover < 0 || movers_[point.mover].arms);
  replaces_ = !turning_ && OwnsInertia(m, instance);
  free_ = !movers_.empty();
  for (const ControlPoint& point : points_) free_ = free_ && point.mover >= 0;
  for (const Mover& mover : movers_) free_ = free_ && (mover.parent >= 0 || &mover == movers_.data());
  load_.resize(movers_.size());
  weight_.resize(movers_.size());
  slide_.resize(movers_.size());
  if (stiffens_) turn_.assign(movers_.size(), Mat3{});
  twist_.assign(6 * twists, 0.0);
  motion_.resize(6 * movers_.size());
}

// Whether neither actuators and MuJoCo's own tendons, which may have armature, nor the points of another instance add
// to the movers' entries of M.
bool Kinematics::OwnsInertia(const mjModel* m, int instance) const {
  std::vector<bool> own(m->nbody, false);  // movers and what hangs on them
  for (const Mover& mover : movers_) own[mover.body] = true;
  for (int body = 1; body < m->nbody; body++) {
    if (!own[body]) own[body] = own[m->body_parentid[body]];
    const int other = m->body_plugin[body];
    if (own[body] && other >= 0 && other != instance && m->plugin[other] == m->plugin[instance]) return false;
  }
  for (int i = 0; i < m->nactuator; i++) {
    const bool joint = m->actuator_trntype[i] == mjTRN_JOINT || m->actuator_trntype[i] == mjTRN_JOINTINPARENT;
    if (joint && own[m->jnt_bodyid[m->actuator_trnid[2 * i]]]) return false;
  }
  return CountOwnTendons(m) == 0;
}

bool Kinematics::IsAbove(int upper, int lower) const {
  if (upper < 0) return true;
  while (lower >= 0 && movers_[lower].depth > movers_[upper].depth) lower = movers_[lower].parent;
  return lower == upper;
}

bool Kinematics::Couple(int j, int k, int* pair) {
  int& known = pair_of_[std::max(j, k) * points_.size() + std::min(j, k)];
  if (known < 0) {
    const int nj = points_[j].mover, nk = points_[k].mover;
    PointPair added = {j, k, -1, false};
    if (nj >= 0 && nk >= 0 && points_[j].branch == points_[k].branch) {
      added.flip = movers_[nk].depth > movers_[nj].depth;
      const int deeper = added.flip ? nk : nj, upper = added.flip ? nj : nk;
      if (!IsAbove(upper, deeper)) return false;
      added.sum = movers_[deeper].pair + movers_[upper].depth;
    }
    known = static_cast<int>(pairs_.size());
    pairs_.push_back(added);
  }
  *pair = known;
  return true;
}

void Kinematics::Finish(const mjModel* m, Reader* reader) {
  for (Mover& mover : movers_) {
    mover.entry = static_cast<int>(entry_.size());
    for (int a = mover.dof; a < mover.dof + mover.dofs; a++) {
      const int* begin = m->M_colind + m->M_rowadr[a];
      const int* end = begin + m->M_rownnz[a];
      std::vector<int> path;  // movers from the outermost to this one
      for (int n = static_cast<int>(&mover - movers_.data()); n >= 0; n = movers_[n].parent) path.push_back(n);
      for (auto n = path.rbegin(); n != path.rend(); ++n) {
        const int last = *n == path.front() ? a + 1 : movers_[*n].dof + movers_[*n].dofs;
        for (int b = movers_[*n].dof; b < last; b++) {
          const int* found = std::find(begin, end, b);
          if (!reader->Check(found != end, "its bodies are not nested in the order they were written in")) return;
          entry_.push_back(static_cast<int>(found - m->M_colind));
        }
      }
    }
  }
  std::vector<int>().swap(pair_of_);
  const size_t size = turning_ ? 36 : 9;
  sum_.resize(movers_.empty() ? 0 : size * (movers_.back().pair + movers_.back().depth + 1));
}

bool Kinematics::MissesWaking(const mjModel* m) const {
  const auto sleepy = [m](int tree) {
    const int policy = m->tree_sleep_policy[tree];
    return policy != mjSLEEP_NEVER && policy != mjSLEEP_AUTO_NEVER;
  };
  if (outermost_ < 0) return false;
  const int own = m->body_treeid[outermost_], root = m->body_rootid[outermost_];
  bool tied = false, may_sleep = sleepy(own);
  for (const ControlPoint& point : points_) {
    const int tree = m->body_treeid[point.body], base = m->body_rootid[point.body];
    if (tree >= 0 ? tree == own : m->body_mocapid[base] < 0 || base == root) continue;
    tied = true;
    may_sleep = may_sleep || (tree >= 0 && sleepy(tree));
  }
  return tied && may_sleep;
}

bool Kinematics::Asleep(const mjModel* m, const mjData* d) const {
  return (m->opt.enableflags & mjENBL_SLEEP) && outermost_ >= 0 && d->body_awake[outermost_] == mjS_ASLEEP;
}

Vec3 Kinematics::WorldPosition(const mjData* d, int j) const {
  const ControlPoint& point = points_[j];
  const Vec3 origin = ToVec3(d->xpos + 3 * point.body);
  return point.offset ? origin + Mul(ToMat3(d->xmat + 9 * point.body), point.local) : origin;
}

Vec3 Kinematics::WorldVelocity(const mjModel* m, const mjData* d, int j) const {
  const ControlPoint& point = points_[j];
  mjtNum twist[6];
  mj_objectVelocity(m, d, mjOBJ_XBODY, point.body, twist, 0);
  return ToVec3(twist + 3) + Cross(ToVec3(twist), WorldPosition(d, j) - ToVec3(d->xpos + 3 * point.body));
}

Vec3 Kinematics::PositionToLocal(const mjData* d, const Vec3& position) const {
  return ToLocal(d, position - ToVec3(d->xpos + 3 * holder_));
}

Vec3 Kinematics::PositionToWorld(const mjData* d, const Vec3& position) const {
  return ToVec3(d->xpos + 3 * holder_) + Mul(Axes(d), position);
}

Mat3 Kinematics::Axes(const mjData* d) const { return ToMat3(d->xmat + 9 * holder_); }

void Kinematics::Gather(const mjModel* m, const mjData* d) {
  const Vec3 origin = ToVec3(d->xpos + 3 * holder_);
  const Mat3 axes = Axes(d);
  for (size_t j = 0; j < points_.size(); j++) {
    const ControlPoint& point = points_[j];
    if (point.still) {
      x_[j] = point.rest;
    } else if (turning_ || point.mover < 0) {
      x_[j] = MulT(axes, WorldPosition(d, static_cast<int>(j)) - origin);
    } else {  // from the slides themselves: rounding of world coordinates would strain a stiff body at rest
      const Mover& mover = movers_[point.mover];
      const int q = m->jnt_qposadr[m->body_jntadr[mover.body]];
      slide_[point.mover] = ToVec3(d->qpos + q) - ToVec3(m->qpos0 + q);
      if (mover.parent >= 0) slide_[point.mover] = slide_[point.mover] + slide_[mover.parent];
      x_[j] = point.rest + slide_[point.mover];
    }
  }
  // levers and twists are about the middle of the points: about the holder, far away, turning would cost digits
  middle_ = {};
  if (turning_) {
    for (const Vec3& x : x_) middle_ = middle_ + (1.0 / x_.size()) * x;
  }
  for (size_t j = 0; j < points_.size(); j++) lever_[j] = x_[j] - middle_;
  const Vec3 centre = origin + Mul(axes, middle_);
  for (size_t n = 0; n < movers_.size(); n++) {
    const Mover& mover = movers_[n];
    double* motion = motion_.data() + 6 * n;
    if (mover.parent >= 0) {
      std::copy_n(motion_.data() + 6 * mover.parent, 6, motion);
    } else {
      std::fill_n(motion, 6, 0.0);
    }
    if (!turning_) {
      for (int r = 0; r < 3; r++) motion[r] += d->qvel[mover.dof + r];
      continue;
    }
    const Vec3 arm = centre - ToVec3(d->subtree_com + 3 * m->body_rootid[mover.body]);
    for (int a = 0; a < mover.dofs; a++) {
      const mjtNum* cdof = d->cdof + 6 * (mover.dof + a);  // rotation, then translation at the root's centre of mass
      const Vec3 rotation = ToVec3(cdof);
      const Vec3 local[2] = {MulT(axes, ToVec3(cdof + 3) + Cross(rotation, arm)), MulT(axes, rotation)};
      double* twist = twist_.data() + 6 * (mover.twist + a);
      for (int r = 0; r < 6; r++) {
        twist[r] = local[r / 3][r % 3];
        motion[r] += twist[r] * d->qvel[mover.dof + a];
      }
    }
  }
  for (size_t j = 0; j < points_.size(); j++) {
    v_[j] = {};
    if (points_[j].mover < 0) continue;
    const double* motion = motion_.data() + 6 * points_[j].mover;
    v_[j] = ToVec3(motion);
    if (turning_) v_[j] = v_[j] + Cross(ToVec3(motion + 3), lever_[j]);
  }
}

// With V the spatial velocity and A = Σ dS_a/dt qvel_a over all degrees of freedom above, both at the root's centre of
// mass, and r from there to the point: a = A_v + A_ω × r + ω × (V_v + ω × r).
const Vec3* Kinematics::BiasAccelerations(const mjModel* m, const mjData* d) {
  if (!turns_) return nullptr;
  const Mat3 axes = Axes(d);
  int body = -1;
  double A[6] = {};
  for (size_t j = 0; j < points_.size(); j++) {
    if (points_[j].body != body) {
      body = points_[j].body;
      std::fill_n(A, 6, 0.0);
      const int moved = m->body_weldid[body];
      for (int a = m->body_dofadr[moved] + m->body_dofnum[moved] - 1; moved > 0 && a >= 0; a = m->dof_parentid[a]) {
        for (int r = 0; r < 6; r++) A[r] += d->cdof_dot[6 * a + r] * d->qvel[a];
      }
    }
    const mjtNum* V = d->cvel + 6 * body;
    const Vec3 r = WorldPosition(d, static_cast<int>(j)) - ToVec3(d->subtree_com + 3 * m->body_rootid[body]);
    const Vec3 velocity = ToVec3(V + 3) + Cross(ToVec3(V), r);
    bias_[j] = MulT(axes, ToVec3(A + 3) + Cross(ToVec3(A), r) + Cross(ToVec3(V), velocity));
  }
  return bias_.data();
}

void Kinematics::Slide(const double* a, std::vector<Vec3>* out) {
  for (size_t n = 0; n < movers_.size(); n++) {
    slide_[n] = ToVec3(a + movers_[n].dof);
    if (movers_[n].parent >= 0) slide_[n] = slide_[n] + slide_[movers_[n].parent];
  }
  for (size_t j = 0; j < points_.size(); j++) (*out)[j] = points_[j].mover < 0 ? Vec3{} : slide_[points_[j].mover];
}

void Kinematics::StoreForce(const std::vector<Vec3>& force, mjData* d) {
  turning_ ? StoreForceOf<6>(force, d) : StoreForceOf<3>(force, d);
}

template <int N>
void Kinematics::StoreForceOf(const std::vector<Vec3>& force, mjData* d) {
  std::fill(motion_.begin(), motion_.end(), 0.0);
  for (size_t j = 0; j < points_.size(); j++) {
    if (points_[j].mover < 0) continue;
    double* wrench = motion_.data() + 6 * points_[j].mover;
    for (int r = 0; r < 3; r++) wrench[r] += force[j][r];
    if constexpr (N == 6) {
      const Vec3 torque = Cross(lever_[j], force[j]);
      for (int r = 0; r < 3; r++) wrench[3 + r] += torque[r];
    }
  }
  for (size_t n = movers_.size(); n-- > 0;) {
    const Mover& mover = movers_[n];
    const double* wrench = motion_.data() + 6 * n;
    for (int a = 0; a < mover.dofs; a++) {
      if constexpr (N == 3) {
        d->qfrc_passive[mover.dof + a] += wrench[a];
      } else {
        const double* twist = twist_.data() + 6 * (mover.twist + a);
        for (int r = 0; r < 6; r++) d->qfrc_passive[mover.dof + a] += twist[r] * wrench[r];
      }
    }
    if (mover.parent < 0) continue;
    double* into = motion_.data() + 6 * mover.parent;
    for (int r = 0; r < N; r++) into[r] += wrench[r];
  }
}

Vec3 Kinematics::Lever(const double* omega, const Vec3& position) const {
  Vec3 lever = position;
  for (size_t j = 0; j < points_.size(); j++) lever = lever - omega[j] * x_[j];
  return lever;
}

double Kinematics::RowEntry(const Moments& moments, const Vec3& direction, int n, int a) const {
  if (!turning_) return moments.weight * direction[a];
  const double* twist = twist_.data() + 6 * (movers_[n].twist + a);
  return moments.weight * Dot(ToVec3(twist), direction) + Dot(ToVec3(twist + 3), Cross(moments.moment, direction));
}

int Kinematics::MoverOfDof(int dof) const {
  // movers are in the order of their bodies, and so of their degrees of freedom
  const auto after = std::upper_bound(movers_.begin(), movers_.end(), dof,
                                      [](int value, const Mover& mover) { return value < mover.dof; });
  if (after == movers_.begin()) return -1;
  const Mover& mover = *(after - 1);
  return dof < mover.dof + mover.dofs ? static_cast<int>(&mover - movers_.data()) : -1;
}

}  // namespace mjframes
