#include "patch_state.h"

#include <algorithm>
#include <limits>

#include "constants.h"
#include "kinematics.h"
#include "simd.h"

namespace mjframes {
namespace {

// Blend for `Blocks` registers of vertices from s on.
template <typename V, int Blocks>
MJFRAMES_INLINE void BlendSome(const double* weight, const int32_t* point, size_t points, const Vec3* x, int n, int s,
                               bool adds, double* out) {
  V sum[3][Blocks];
  for (int c = 0; c < 3; c++) {
    for (int b = 0; b < Blocks; b++) sum[c][b] = adds ? Load<V>(out + c * n + s + kWidth<V> * b) : V{};
  }
  for (size_t a = 0; a < points; a++) {
    const Vec3& position = x[point[a]];
    for (int c = 0; c < 3; c++) {
      for (int b = 0; b < Blocks; b++) sum[c][b] += Load<V>(weight + a * n + s + kWidth<V> * b) * position[c];
    }
  }
  for (int c = 0; c < 3; c++) {
    for (int b = 0; b < Blocks; b++) Store(sum[c][b], out + c * n + s + kWidth<V> * b);
  }
}

// out[c n + s] = Σ_a weight[a n + s] x[point[a]][c], or `adds` that to it
void Blend(const double* weight, const int32_t* point, size_t points, const Vec3* x, int n, bool adds, double* out) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    constexpr int kBlocks = 3;  // their nine sums stay in registers
    int s = 0;
    for (; s + kBlocks * kWidth<V> <= n; s += kBlocks * kWidth<V>) {
      BlendSome<V, kBlocks>(weight, point, points, x, n, s, adds, out);
    }
    for (; s + kLanes <= n; s += kLanes) BlendSome<Lanes, 1>(weight, point, points, x, n, s, adds, out);
    for (; s < n; s++) {
      for (int c = 0; c < 3; c++) {
        double sum = adds ? out[c * n + s] : 0;
        for (size_t a = 0; a < points; a++) sum += weight[a * n + s] * x[point[a]][c];
        out[c * n + s] = sum;
      }
    }
  });
}

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
      nodes_(!contact.has_volume ? 0
             : pairs             ? kKeptSoftNodes
                                 : kKeptNodes),
      touches_(pairs ? kKeptSoftTouches : kKeptTouches) {
  if (contact.has_volume && pairs) below_ = contact.field.NodesBelow(patch, false);
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
  posed_ = skinned_ = bounded_ = false;
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
  const int n = patch_.vertices;
  Blend(patch_.weight.data(), patch_.point.data(), patch_.point.size(), x_.data(), n, false, out);
  if (!patch_.offset.empty()) {
    const Mat3 turned = Transpose(axes_);
    const Vec3 axis[3] = {
        {turned[0], turned[1], turned[2]}, {turned[3], turned[4], turned[5]}, {turned[6], turned[7], turned[8]}};
    constexpr int32_t kAxes[3] = {0, 1, 2};
    Blend(patch_.offset.data(), kAxes, 3, axis, n, true, out);
  }
  for (int c = 0; c < 3; c++) {
    const Extremes of = ExtremesOf(out + c * n, n);
    box_.centre[c] = 0.5 * (of.least + of.largest);
    box_.half[c] = 0.5 * (of.largest - of.least);
  }
  return out;
}

const AlignedBox& PatchState::MaterialBox() {
  if (bounded_) return material_;
  bounded_ = true;
  Vec3 low = {mjMAXVAL, mjMAXVAL, mjMAXVAL}, high = {-mjMAXVAL, -mjMAXVAL, -mjMAXVAL};
  for (const int number : below_) {
    const DeformedNodes::Node& node = nodes_.At(number, contact_.field, patch_.volume, x_.data());
    if (node.total < kLeastInRows) continue;
    for (int c = 0; c < 3; c++) {
      low[c] = std::min(low[c], node.x[c]);
      high[c] = std::max(high[c], node.x[c]);
    }
  }
  material_ = {0.5 * (low + high), 0.5 * (high - low)};
  return material_;
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
