#include "surface_state.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>
#include <map>

#include "constants.h"
#include "kinematics.h"
#include "vertices.h"

namespace mjframes {
namespace {

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

size_t KeptNodes(const ContactModel& contact, bool wide) {
  return std::min(std::bit_ceil(contact.field.node.size()), wide ? kKeptSoftNodes : kKeptNodes);
}

}  // namespace

GeomPlace PlaceOf(const mjData* d, int geom) {
  GeomPlace place;
  std::copy_n(d->geom_xpos + 3 * geom, 3, place.begin());
  std::copy_n(d->geom_xmat + 9 * geom, 9, place.begin() + 3);
  return place;
}

SurfaceState::SurfaceState(const ContactModel& contact, const Kinematics& kinematics, bool pairs, bool wide)
    : contact_(contact),
      kinematics_(kinematics),
      x_(kinematics.points().size()),
      patches_(contact.patches.size()),
      nodes_(KeptNodes(contact, wide)),
      asked_(wide ? kKeptFieldPoints : 1) {
  std::map<int, bool> bodies;  // whether points of each are elsewhere than at its origin
  for (const ControlPoint& point : kinematics.points()) {
    if (point.body > 0) bodies[point.body] |= point.offset;
  }
  size_t size = 0;
  for (const auto& [body, turns] : bodies) {
    if (runs_.empty() || body != runs_.back().first + runs_.back().count || turns != runs_.back().turns) {
      runs_.push_back({body, 0, turns});
    }
    runs_.back().count++;
    size += turns ? 12 : 3;
  }
  placed_.assign(size, std::numeric_limits<double>::quiet_NaN());  // equal to nothing
  size_t numbers = 0;
  for (size_t i = 0; i < patches_.size(); i++) {
    const size_t n = contact.patches[i].vertices;
    offsets_ = offsets_ || !contact.patches[i].offset.empty();
    patches_[i].first = numbers;
    patches_[i].touches.resize(pairs ? kKeptSoftTouches : kKeptTouches);
    numbers += 3 * n;
    for (Kept& kept : patches_[i].touches) {
      kept.share.resize(n);
      if (pairs) kept.xi.resize(n);
    }
  }
  vertices_.resize(numbers);
}

bool SurfaceState::Moved(const mjData* d) const {
  const mjtNum* placed = placed_.data();
  const auto differs = [&](const mjtNum* now, int count) {
    placed += count;
    return std::memcmp(placed - count, now, count * sizeof(mjtNum)) != 0;
  };
  for (const auto& [first, count, turns] : runs_) {
    if (differs(d->xpos + 3 * first, 3 * count) || (turns && differs(d->xmat + 9 * first, 9 * count))) return true;
  }
  return offsets_ && kinematics_.Axes(d) != axes_;
}

void SurfaceState::Update(const mjData* d) {
  if (!Moved(d)) return;
  mjtNum* placed = placed_.data();
  for (const auto& [first, count, turns] : runs_) {
    placed = std::copy_n(d->xpos + 3 * first, 3 * count, placed);
    if (turns) placed = std::copy_n(d->xmat + 9 * first, 9 * count, placed);
  }
  if (offsets_) axes_ = kinematics_.Axes(d);
  version_++;
  for (size_t j = 0; j < x_.size(); j++) x_[j] = kinematics_.WorldPosition(d, static_cast<int>(j));
  nodes_.Forget();
  for (OfPatch& patch : patches_) {
    patch.posed = patch.skinned = false;
    patch.cube.nodes[0] = -1;
    patch.kept = 0;
  }
}

const PatchPose& SurfaceState::Pose(int patch) {
  OfPatch& one = patches_[patch];
  if (!one.posed && contact_.has_volume) one.pose = contact_.patches[patch].volume.Pose(contact_.field, x_.data());
  one.posed = true;
  return one.pose;
}

const double* SurfaceState::Vertices(int patch) {
  OfPatch& one = patches_[patch];
  double* out = vertices_.data() + one.first;
  if (one.skinned) return out;
  one.skinned = true;
  SkinVertices(contact_.patches[patch], x_.data(), axes_, out);
  one.box = BoxAround(out, contact_.patches[patch].vertices);
  return out;
}

SurfaceState::FieldPoint* SurfaceState::Asked(int patch, const Vec3& place) {
  uint64_t hash = static_cast<uint64_t>(patch);
  for (const double component : place) hash = (hash ^ std::bit_cast<uint64_t>(component)) * kHash;
  FieldPoint* point = &asked_[hash >> 32 & (asked_.size() - 1)];
  if (point->version != version_ || point->patch != patch || point->place != place) {
    *point = {version_, patch, false, place, 0, {}};
  }
  return point;
}

void SurfaceState::Keep(const mjData* d, int patch, int geom, const SurfaceState* other, const Touch* touch, int count,
                        const double* share, const Vec3* xi) {
  OfPatch& one = patches_[patch];
  const auto end = one.touches.begin() + one.kept;
  const auto found = std::find_if(one.touches.begin(), end, [geom](const Kept& kept) { return kept.geom == geom; });
  if (found == one.touches.end() || (found == end && count == 0 && !other)) return;
  if (found == end) one.kept++;
  found->geom = geom;
  found->count = count;
  found->version = other ? other->version_ : 0;
  found->place = PlaceOf(d, geom);
  std::copy_n(touch, count, found->touch.begin());
  CopyShares(touch, count, share, other ? xi : nullptr, found->share.data(), found->xi.data());
}

int SurfaceState::Recall(const mjData* d, int patch, int geom, const SurfaceState* other, Touch* touch, double* share,
                         Vec3* xi) const {
  const OfPatch& one = patches_[patch];
  for (int i = 0; i < one.kept; i++) {
    const Kept& kept = one.touches[i];
    if (kept.geom != geom || kept.version != (other ? other->version_ : 0) || kept.place != PlaceOf(d, geom)) continue;
    std::copy_n(kept.touch.begin(), kept.count, touch);
    CopyShares(touch, kept.count, kept.share.data(), other ? kept.xi.data() : nullptr, share, xi);
    return kept.count;
  }
  return -1;
}

}  // namespace mjframes
