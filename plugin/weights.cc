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
  const auto offset = reader->ArrayOr<double>("offset", 0, 3 * size.size());
  Weights out = {{0}, reader->Array<int32_t>("weight_point"), reader->Array<double>("weight"), {}};
  const auto below = [](size_t end) { return [=](int32_t i) { return i >= 0 && static_cast<size_t>(i) < end; }; };
  bool fits = std::all_of(out.point.begin(), out.point.end(), below(count)) && out.weight.size() == out.point.size() &&
              std::all_of(size.begin(), size.end(), below(count + 1));
  for (size_t n = 0; fits && n < size.size(); n++) {
    out.first.push_back(out.first.back() + size[n]);
    fits = static_cast<size_t>(out.first.back()) <= out.point.size();
    if (reader->Has("offset")) out.offset.push_back(ToVec3(offset.data() + 3 * n));
  }
  fits = fits && static_cast<size_t>(out.first.back()) == out.point.size();
  return reader->Check(fits, "its points are not those of the soft body: write it again") ? out
                                                                                          : Weights{{0}, {}, {}, {}};
}

}  // namespace mjframes
