#include "patch_state.h"

#include <algorithm>
#include <limits>

#include "constants.h"
#include "kinematics.h"
#include "vertices.h"

namespace mjframes {
namespace {

std::array<mjtNum, 12> PlaceOf(const mjData* d, int geom) {
  std::array<mjtNum, 12> place;
  std::copy_n(d->geom_xpos + 3 * geom, 3, place.begin());
  std::copy_n(d->geom_xmat + 9 * geom, 9, place.begin() + 3);
  return place;
}

// Shares are of vertices, cluster by cluster; other entries are of clusters that do not touch. Material points, if any,
// are of vertices that have a share.
void CopyShares(const Touch* touch, int count, const double* from, const Vec3* from_xi, double* to, Vec3* to_xi) {
  for (int i = 0; i < count; i++) {
    if (touch[i].side < 0) continue;
    for (int s = touch[i].begin; s < touch[i].end; s++) {
      to[s] = from[s];
      if (from_xi && from[s] != 0) to_xi[s] = from_xi[s];
    }
  }
}

}  // namespace

PatchState::PatchState(const ContactModel& contact, const Kinematics& kinematics, int patch, bool pairs)
    : contact_(contact),
      kinematics_(kinematics),
      patch_(contact.patches[patch]),
      number_(patch),
      axes_(kIdentity),
      nodes_(contact.has_volume ? kKeptNodes : 0),
      touches_(pairs ? kKeptSoftTouches : kKeptTouches) {
  const std::vector<uint8_t>& in_rows = patch_.volume.in_rows;
  for (size_t j = 0; j < in_rows.size(); j++) {
    if (in_rows[j]) point_.push_back(static_cast<int32_t>(j));
  }
  for (const int32_t j : patch_.point) {
    if (in_rows.empty() || !in_rows[j]) point_.push_back(j);
  }
  constexpr double kNowhere = std::numeric_limits<double>::quiet_NaN();  // equal to nothing
  x_.assign(kinematics.points().size(), {kNowhere, kNowhere, kNowhere});
  vertices_.resize(3 * static_cast<size_t>(patch_.vertices));
  for (Kept& kept : touches_) {
    kept.share.resize(patch_.vertices);
    if (pairs) kept.xi.resize(patch_.vertices);
  }
}

void PatchState::Update(const mjData* d) {
  bool same = true;
  for (const int32_t j : point_) {
    const ControlPoint& point = kinematics_.points()[j];
    const mjtNum* origin = d->xpos + 3 * point.body;
    const Vec3 x = point.offset ? kinematics_.WorldPosition(d, j) : Vec3{origin[0], origin[1], origin[2]};
    same = same && x == x_[j];
    x_[j] = x;
  }
  if (!patch_.offset.empty()) {
    const Mat3 axes = kinematics_.Axes(d);
    same = same && axes == axes_;
    axes_ = axes;
  }
  if (same) return;
  posed_ = skinned_ = false;
  nodes_.Forget();
  version_++;
  kept_ = 0;
}

const PatchPose& PatchState::Pose() {
  if (!posed_ && contact_.has_volume) pose_ = patch_.volume.Pose(contact_.field, x_.data());
  posed_ = true;
  return pose_;
}

const double* PatchState::Vertices() {
  double* out = vertices_.data();
  if (skinned_) return out;
  skinned_ = true;
  SkinVertices(patch_, x_.data(), axes_, out);
  box_ = BoxAround(out, patch_.vertices);
  return out;
}

void PatchState::Keep(const mjData* d, int geom, const PatchState* other, const Touch* touch, int count,
                      const double* share, const Vec3* xi) {
  const auto end = touches_.begin() + kept_;
  const auto found = std::find_if(touches_.begin(), end, [geom](const Kept& kept) { return kept.geom == geom; });
  if (found == touches_.end() || (found == end && count == 0 && !other)) return;
  if (found == end) kept_++;
  found->geom = geom;
  found->count = count;
  found->version = other ? other->version_ : 0;
  found->place = PlaceOf(d, geom);
  std::copy_n(touch, count, found->touch.begin());
  CopyShares(touch, count, share, other ? xi : nullptr, found->share.data(), found->xi.data());
}

int PatchState::Recall(const mjData* d, int geom, const PatchState* other, Touch* touch, double* share,
                       Vec3* xi) const {
  for (int i = 0; i < kept_; i++) {
    const Kept& kept = touches_[i];
    if (kept.geom != geom || kept.version != (other ? other->version_ : 0) || kept.place != PlaceOf(d, geom)) continue;
    std::copy_n(kept.touch.begin(), kept.count, touch);
    CopyShares(touch, kept.count, kept.share.data(), other ? kept.xi.data() : nullptr, share, xi);
    return kept.count;
  }
  return -1;
}

}  // namespace mjframes
