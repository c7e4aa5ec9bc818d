#include "places.h"

#include <algorithm>
#include <cmath>

#include "corotational.h"
#include "elasticity.h"

namespace mjframes {
namespace {

constexpr char kMismatch[] = "its points are not those of the soft body: write the sensor again";

// R L y [m].
Vec3 Lifted(const Region& region, const std::vector<double>& lift, const Mat3& R, const Vec3* x) {
  const int m = region.size();
  Vec3 mean{}, sum{};
  for (const int32_t j : region.point) mean = mean + (1.0 / m) * x[j];
  for (int j = 0; j < m; j++) {
    const Vec3 y = MulT(R, x[region.point[j]] - mean) - region.rest[j];
    for (int r = 0; r < 3; r++) sum[r] += Dot(ToVec3(lift.data() + 3 * (r * m + j)), y);
  }
  return Mul(R, sum);
}

}  // namespace

// x of point n in the soft body's own axes.
Vec3 Places::LocalPosition(const SoftBody& body, const std::vector<Mat3>& rotation, int n) const {
  const std::vector<Vec3>& x = body.kinematics().x();
  const Place& place = places_[n];
  const Vec3 p = weights_.Position(n, x);
  if (place.lift.empty()) return p;
  return p + Lifted(body.elasticity().FindRegion(place.region), place.lift, rotation[place.region], x.data());
}

void Places::Read(Reader* soft, Reader* reader) {
  const size_t k = soft->Array<double>("point_mass").size();
  const auto region_size = soft->Array<int32_t>("region_size");
  const auto region = reader->Array<int32_t>("region");
  const size_t count = region.size();
  weights_ = ReadWeights(k, reader);
  const bool lifted = reader->Has("rise");
  const auto lift = lifted ? reader->Array<double>("rise") : std::vector<double>();
  // regions of a law at quadrature points have no rotation
  const bool fits =
      soft->ok() && weights_.size() == static_cast<int>(count) && !(lifted && soft->Has("quadrature_count"));
  if (!reader->Check(fits, kMismatch)) return;
  size_t of_lift = 0;
  for (const int32_t e : region) {
    if (!reader->Check(e >= 0 && e < static_cast<int32_t>(region_size.size()), kMismatch)) return;
    const size_t lift_end = of_lift + (lifted ? 9 * std::max(region_size[e], 0) : 0);
    if (!reader->Check(lift_end <= lift.size(), kMismatch)) return;
    places_.push_back({e, {lift.begin() + of_lift, lift.begin() + lift_end}});
    of_lift = lift_end;
  }
  reader->Check(of_lift == lift.size(), kMismatch);
  velocity_.resize(k);
  moved_.resize(k);
  after_.resize(places_.size());
  before_.resize(places_.size());
}

void Places::StorePositions(SoftBody* body, const mjData* d, mjtNum* out) const {
  const std::vector<Mat3>& rotation = body->RegionRotations();
  for (int n = 0; n < weights_.size(); n++) {
    const Vec3 p = body->kinematics().PositionToWorld(d, LocalPosition(*body, rotation, n));
    out = std::copy(p.begin(), p.end(), out);
  }
}

void Places::StoreVelocities(SoftBody* body, const mjModel* m, const mjData* d, mjtNum* out) {
  const Kinematics& kinematics = body->kinematics();
  const Mat3 axes = kinematics.Axes(d);
  mjtNum twist[6];
  mj_objectVelocity(m, d, mjOBJ_XBODY, kinematics.holder(), twist, 0);
  const Vec3 spin = ToVec3(twist), drift = ToVec3(twist + 3);
  for (size_t j = 0; j < velocity_.size(); j++) {
    const Vec3 arm = Mul(axes, kinematics.x()[j]);
    velocity_[j] = MulT(axes, kinematics.WorldVelocity(m, d, static_cast<int>(j)) - drift - Cross(spin, arm));
  }
  // d/dt R L y, by central differences: how R changes has a singular closed form where a region is folded over
  const std::vector<Vec3>& x = kinematics.x();
  const double step = Step(x);
  Differ(body, x, step, &after_);
  Differ(body, x, -step, &before_);
  const std::vector<Mat3>& rotation = body->RegionRotations();
  for (int n = 0; n < weights_.size(); n++) {
    const Vec3 own = weights_.Sum(n, velocity_) + (0.5 / step) * (after_[n] - before_[n]);
    const Vec3 v = drift + Cross(spin, Mul(axes, LocalPosition(*body, rotation, n))) + Mul(axes, own);
    out = std::copy(v.begin(), v.end(), out);
  }
}

// In which the control points move by kDifference of the body's size [s].
double Places::Step(const std::vector<Vec3>& x) const {
  double size = 0, speed = 0;
  for (size_t j = 0; j < x.size(); j++) {
    size = std::max(size, Norm(x[j] - x[0]));
    speed = std::max(speed, Norm(velocity_[j] - velocity_[0]));
  }
  return speed > 0 && size > 0 ? kDifference * size / speed : kDifference;
}

// R L y of all points a little later; what all control points have in common moves nothing here.
void Places::Differ(SoftBody* body, const std::vector<Vec3>& x, double time, std::vector<Vec3>* lifted) {
  for (size_t j = 0; j < x.size(); j++) moved_[j] = x[j] + time * (velocity_[j] - velocity_[0]);
  const std::vector<Mat3>& rotation = body->RegionRotationsAt(moved_.data());
  for (size_t n = 0; n < places_.size(); n++) {
    const Place& place = places_[n];
    (*lifted)[n] = {};
    if (place.lift.empty()) continue;
    const Region& region = body->elasticity().FindRegion(place.region);
    (*lifted)[n] = Lifted(region, place.lift, rotation[place.region], moved_.data());
  }
}

}  // namespace mjframes
