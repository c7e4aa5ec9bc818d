#include "distance_field.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "constants.h"

namespace mjframes {
namespace {

bool Within(const std::vector<int32_t>& values, int64_t end) {
  return std::all_of(values.begin(), values.end(), [end](int32_t v) { return v >= 0 && v < end; });
}

}  // namespace

std::string DistanceField::Finish(int patches, int vertices) {
  const size_t n = node.size();
  if (!(spacing > 0) || axes.size() != 9 || origin.size() != 3 || shape.size() != 3 ||
      *std::min_element(shape.begin(), shape.end()) < 2) {
    return "its lattice has no valid shape";
  }
  int64_t total = 1;
  for (const int32_t length : shape) total = total > kMaxLatticeNodes ? total : total * length;
  const bool ascend = std::adjacent_find(node.begin(), node.end(), std::greater_equal()) == node.end();
  if (total > kMaxLatticeNodes || !Within(node, total) || !ascend) {
    return "its lattice's nodes are not in the lattice, in order";
  }
  start.assign(1, 0);
  for (const int32_t entries : count) start.push_back(start.back() + std::max(entries, 0));
  if (distance.size() != n || patch.size() != n || count.size() != n ||
      static_cast<size_t>(start.back()) != weight.size() || vertex.size() != 3 * static_cast<size_t>(vertices) ||
      normal.size() != vertex.size()) {
    return "its lattice arrays do not match each other";
  }
  if (!Within(patch, patches)) return "its lattice names patches it has not";
  place.assign(total, -1);
  for (size_t i = 0; i < n; i++) {
    place[node[i]] = static_cast<int32_t>(i);
  }
  return "";
}

Vec3 DistanceField::Coordinates(const Vec3& p) const {
  Vec3 xi{};
  for (int i = 0; i < 3; i++) {
    for (int c = 0; c < 3; c++) xi[i] += axes[3 * c + i] * (p[c] - origin[c]) / spacing;
  }
  return xi;
}

double DistanceField::Volume() const {
  double cubes = 0;
  for (const double height : distance) cubes += std::clamp(0.5 - height / spacing, 0.0, 1.0);
  return cubes * spacing * spacing * spacing;
}

Vec3 DistanceField::Place(int number) const {
  const int32_t at = node[number], plane = shape[1] * shape[2];
  const double xi[3] = {static_cast<double>(at / plane), static_cast<double>(at / shape[2] % shape[1]),
                        static_cast<double>(at % shape[2])};
  Vec3 p;
  for (int c = 0; c < 3; c++) {
    p[c] = origin[c];
    for (int i = 0; i < 3; i++) p[c] += spacing * axes[3 * c + i] * xi[i];
  }
  return p;
}

bool DistanceField::CubeAt(const Vec3& xi, int* nodes, Vec3* fraction) const {
  int64_t base[3];
  for (int i = 0; i < 3; i++) {
    if (!(xi[i] >= 0) || !(xi[i] < shape[i] - 1)) return false;
    base[i] = static_cast<int64_t>(xi[i]);
    (*fraction)[i] = xi[i] - static_cast<double>(base[i]);
  }
  const int64_t first = (base[0] * shape[1] + base[1]) * shape[2] + base[2];
  for (int corner = 0; corner < 8; corner++) {
    const int dx = corner & 1, dy = corner >> 1 & 1, dz = corner >> 2;
    nodes[corner] = place[first + (dx * static_cast<int64_t>(shape[1]) + dy) * shape[2] + dz];
    if (nodes[corner] < 0) return false;
  }
  return true;
}

std::array<double, 8> TrilinearWeights(const Vec3& f) {
  const double x[2] = {1 - f[0], f[0]}, y[2] = {1 - f[1], f[1]}, z[2] = {1 - f[2], f[2]};
  std::array<double, 8> weight;
  for (int corner = 0; corner < 8; corner++) weight[corner] = x[corner & 1] * y[corner >> 1 & 1] * z[corner >> 2];
  return weight;
}

bool DistanceField::IsNearest(const int* nodes, const Vec3& fraction, int of) const {
  for (int corner = 0; corner < 8; corner++) {
    bool near = true;
    for (int i = 0; i < 3; i++) near &= corner >> i & 1 ? fraction[i] > 0.5 - kTie : fraction[i] < 0.5 + kTie;
    if (near && patch[nodes[corner]] == of) return true;
  }
  return false;
}

std::vector<int> DistanceField::NodesBelow(int of) const {
  std::vector<uint8_t> below(node.size(), 0);
  for (const int32_t at : node) {
    const Vec3 corner = {static_cast<double>(at / (shape[1] * shape[2])), static_cast<double>(at / shape[2] % shape[1]),
                         static_cast<double>(at % shape[2])};
    int nodes[8];
    Vec3 fraction;
    if (!CubeAt(corner, nodes, &fraction)) continue;
    const bool owned = std::any_of(nodes, nodes + 8, [&](int some) { return patch[some] == of; });
    const bool reaches = std::any_of(nodes, nodes + 8, [&](int some) { return distance[some] < 0; });
    for (const int some : nodes) below[some] |= owned && reaches;
  }
  std::vector<int> found;
  for (size_t some = 0; some < below.size(); some++) {
    if (below[some]) found.push_back(static_cast<int>(some));
  }
  return found;
}

double DistanceField::Distance(const int* nodes, const Vec3& f) const {
  double along_x[4];
  for (int k = 0; k < 4; k++) {
    const double low = distance[nodes[2 * k]], high = distance[nodes[2 * k + 1]];
    along_x[k] = low + f[0] * (high - low);
  }
  const double low = along_x[0] + f[1] * (along_x[1] - along_x[0]);
  const double high = along_x[2] + f[1] * (along_x[3] - along_x[2]);
  return low + f[2] * (high - low);
}

double DistanceField::Distance(const int* nodes, const Vec3& f, Vec3* gradient) const {
  const double x[2] = {1 - f[0], f[0]}, y[2] = {1 - f[1], f[1]}, z[2] = {1 - f[2], f[2]};
  double value = 0;
  *gradient = {};
  for (int corner = 0; corner < 8; corner++) {
    const int a = corner & 1, b = corner >> 1 & 1, c = corner >> 2;
    const double phi = distance[nodes[corner]];
    value += x[a] * y[b] * z[c] * phi;
    (*gradient)[0] += (2 * a - 1) * y[b] * z[c] * phi;
    (*gradient)[1] += x[a] * (2 * b - 1) * z[c] * phi;
    (*gradient)[2] += x[a] * y[b] * (2 * c - 1) * phi;
  }
  return value;
}

}  // namespace mjframes
