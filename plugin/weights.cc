#include "weights.h"

#include <algorithm>

namespace mjframes {

Vec3 Weights::Sum(int n, const std::vector<Vec3>& values) const {
  Vec3 sum{};
  for (int32_t i = first[n]; i < first[n + 1]; i++) sum = sum + weight[i] * values[point[i]];
  return sum;
}

Vec3 Weights::Position(int n, const std::vector<Vec3>& x) const {
  return offset.empty() ? Sum(n, x) : Sum(n, x) + offset[n];
}

Weights ReadWeights(size_t count, Reader* reader) {
  const auto size = reader->Array<int32_t>("weight_size");
  Weights out = {{0}, reader->Array<int32_t>("weight_point"), reader->Array<double>("weight"), {}};
  const auto below = [](size_t end) { return [=](int32_t i) { return i >= 0 && static_cast<size_t>(i) < end; }; };
  bool fits = !size.empty() && out.weight.size() == out.point.size() &&
              std::all_of(out.point.begin(), out.point.end(), below(count)) &&
              std::all_of(size.begin(), size.end(), below(count + 1));
  for (size_t n = 0; fits && n < size.size(); n++) {
    out.first.push_back(out.first.back() + size[n]);
    fits = static_cast<size_t>(out.first.back()) <= out.point.size();
  }
  fits = fits && static_cast<size_t>(out.first.back()) == out.point.size();
  if (!reader->Check(fits, "its points are not those of the soft body: write it again")) return {{0}, {}, {}, {}};
  const auto offset = reader->ArrayOr<double>("offset", 0, 3 * size.size());
  for (size_t e = 0; reader->Has("offset") && e < offset.size(); e += 3) {
    out.offset.push_back(ToVec3(offset.data() + e));
  }
  return out;
}

}  // namespace mjframes
