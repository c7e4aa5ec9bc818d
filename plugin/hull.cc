#include "hull.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "constants.h"
#include "triangle.h"

namespace mjframes {
namespace {

Vec3 Fill3(double value) { return {value, value, value}; }

void Include(const Vec3& p, Vec3* low, Vec3* high) {
  for (int i = 0; i < 3; i++) {
    (*low)[i] = std::min((*low)[i], p[i]);
    (*high)[i] = std::max((*high)[i], p[i]);
  }
}

// How far p is outside of a box.
double Outside(const Vec3& low, const Vec3& high, const Vec3& p) {
  Vec3 gap;
  for (int i = 0; i < 3; i++) gap[i] = std::max({0.0, low[i] - p[i], p[i] - high[i]});
  return Norm(gap);
}

// The largest of the distances n · p − offset.
double Farthest(const double* nx, const double* ny, const double* nz, const double* offset, int n, const Vec3& p) {
  // eight running maxima: one alone would be a chain that the compiler must not reorder
  double largest[8];
  std::fill(largest, largest + 8, -mjMAXVAL);
  const double x = p[0], y = p[1], z = p[2];
  int f = 0;
  for (; f + 8 <= n; f += 8) {
    for (int lane = 0; lane < 8; lane++) {
      const double distance = nx[f + lane] * x + ny[f + lane] * y + nz[f + lane] * z - offset[f + lane];
      largest[lane] = largest[lane] > distance ? largest[lane] : distance;
    }
  }
  for (; f < n; f++) largest[0] = std::max(largest[0], nx[f] * x + ny[f] * y + nz[f] * z - offset[f]);
  return *std::max_element(largest, largest + 8);
}

}  // namespace

Hull::Hull(const mjModel* m, int mesh) {
  const int* graph = m->mesh_graph + m->mesh_graphadr[mesh];
  const int vertices = graph[0], faces = graph[1];
  const int* global = graph + 2 + vertices;
  const int* corners = global + vertices + vertices + 3 * faces;
  const float* xyz = m->mesh_vert + 3 * m->mesh_vertadr[mesh];
  std::vector<int> local(m->mesh_vertnum[mesh], -1);
  std::vector<Vec3> positions;
  for (int v = 0; v < vertices; v++) {
    local[global[v]] = v;
    const float* at = xyz + 3 * global[v];
    positions.push_back({at[0], at[1], at[2]});
  }
  std::vector<std::array<int, 3>> triangles;
  for (int f = 0; f < faces; f++) {
    triangles.push_back({local[corners[3 * f]], local[corners[3 * f + 1]], local[corners[3 * f + 2]]});
  }
  *this = Hull(std::move(positions), triangles);
}

Hull::Hull(std::vector<Vec3> vertices, const std::vector<std::array<int, 3>>& faces) : vertices_(std::move(vertices)) {
  Vec3 middle{};
  for (const Vec3& vertex : vertices_) middle = middle + (1.0 / static_cast<int>(vertices_.size())) * vertex;
  for (const std::array<int, 3>& face : faces) {
    const Vec3& a = vertices_[face[0]];
    Vec3 normal = Cross(vertices_[face[1]] - a, vertices_[face[2]] - a);
    const double area = Norm(normal);
    if (!(area > 0)) continue;
    normal = (Dot(normal, a - middle) < 0 ? -1 / area : 1 / area) * normal;
    faces_.push_back(face);
    nx_.push_back(normal[0]);
    ny_.push_back(normal[1]);
    nz_.push_back(normal[2]);
    offset_.push_back(Dot(normal, a));
  }
  const int n = static_cast<int>(faces_.size());
  if (n <= kFewFaces) return;
  order_.resize(n);
  std::iota(order_.begin(), order_.end(), 0);
  AddBranch(0, n);
}

void Hull::AddBranch(int begin, int end) {
  const size_t number = branches_.size();
  Branch branch = {begin, end, -1, Fill3(mjMAXVAL), Fill3(-mjMAXVAL), Fill3(mjMAXVAL), Fill3(-mjMAXVAL), mjMAXVAL};
  for (int i = begin; i < end; i++) {
    const int f = order_[i];
    for (const int v : faces_[f]) Include(vertices_[v], &branch.low, &branch.high);
    Include({nx_[f], ny_[f], nz_[f]}, &branch.n_low, &branch.n_high);
    branch.offset_low = std::min(branch.offset_low, offset_[f]);
  }
  branches_.push_back(branch);
  if (end - begin <= kLeafFaces) return;
  const Vec3 size = branch.high - branch.low;
  const auto axis = std::max_element(size.begin(), size.end()) - size.begin();
  const auto along = [&](int f) {
    return vertices_[faces_[f][0]][axis] + vertices_[faces_[f][1]][axis] + vertices_[faces_[f][2]][axis];
  };
  const int half = (begin + end) / 2;
  std::nth_element(order_.begin() + begin, order_.begin() + half, order_.begin() + end,
                   [&](int f, int g) { return along(f) < along(g) || (along(f) == along(g) && f < g); });
  AddBranch(begin, half);
  branches_[number].second = static_cast<int>(branches_.size());
  AddBranch(half, end);
}

std::vector<Vec3> Hull::Corners() const {
  if (vertices_.size() <= kMostCorners) return vertices_;
  std::vector<bool> sharp(vertices_.size(), false);
  for (size_t i = 0; i < kMostCorners; i++) {  // along a spiral from pole to pole
    const double z = (2 * static_cast<double>(i) + 1) / kMostCorners - 1, angle = kGoldenAngle * static_cast<double>(i);
    const double radius = std::sqrt(1 - z * z);
    const Vec3 along = {radius * std::cos(angle), radius * std::sin(angle), z};
    const auto farthest = std::max_element(vertices_.begin(), vertices_.end(), [&along](const Vec3& a, const Vec3& b) {
      return Dot(along, a) < Dot(along, b);
    });
    sharp[farthest - vertices_.begin()] = true;
  }
  std::vector<Vec3> corners;
  for (size_t v = 0; v < vertices_.size(); v++) {
    if (sharp[v]) corners.push_back(vertices_[v]);
  }
  return corners;
}

double Hull::HighestPlane(const Branch& branch, const Vec3& p) {
  double sum = 0;
  for (int i = 0; i < 3; i++) sum += std::max(branch.n_low[i] * p[i], branch.n_high[i] * p[i]);
  return sum - branch.offset_low;
}

void Hull::Nearer(int f, const Vec3& p, double* best, int* found, Vec3* normal) const {
  const double above = Plane(f, p);
  if (above <= 0 || above > *best) return;
  const Vec3 offset =
      p - ClosestOnTriangle(p, vertices_[faces_[f][0]], vertices_[faces_[f][1]], vertices_[faces_[f][2]]);
  const double distance = Norm(offset);
  if (!(distance < *best || (distance == *best && f < *found))) return;
  *best = distance;
  *found = f;
  // just above a face the offset is rounding, the plane is not
  *normal = distance > 1e-9 ? (1 / distance) * offset : Vec3{nx_[f], ny_[f], nz_[f]};
}

double Hull::DistanceByAll(const Vec3& p, double reach, Vec3* normal) const {
  const int n = static_cast<int>(faces_.size());
  const double farthest = Farthest(nx_.data(), ny_.data(), nz_.data(), offset_.data(), n, p);
  if (farthest <= 0 || farthest > reach) {
    int face = 0;
    for (int f = 1; f < n; f++) {
      if (Plane(f, p) > Plane(face, p)) face = f;
    }
    *normal = {nx_[face], ny_[face], nz_[face]};
    return farthest;
  }
  double best = mjMAXVAL;
  int found = -1;
  for (int f = 0; f < n; f++) Nearer(f, p, &best, &found, normal);
  return best;
}

double Hull::Distance(const Vec3& p, double reach, Vec3* normal) const {
  if (branches_.empty()) return DistanceByAll(p, reach, normal);
  const Branch& whole = branches_.front();
  *normal = {0, 0, 1};
  if (Outside(whole.low, whole.high, p) > reach) return mjMAXVAL;
  int stack[kMostDepth], waiting = 0;
  double best = reach;
  int found = -1;
  for (stack[waiting++] = 0; waiting > 0;) {
    const int number = stack[--waiting];
    const Branch& branch = branches_[number];
    if (Outside(branch.low, branch.high, p) > best || !(HighestPlane(branch, p) > 0)) continue;
    if (branch.second < 0) {
      for (int i = branch.begin; i < branch.end; i++) Nearer(order_[i], p, &best, &found, normal);
      continue;
    }
    const Branch &first = branches_[number + 1], &second = branches_[branch.second];
    const bool swap = Outside(second.low, second.high, p) < Outside(first.low, first.high, p);
    stack[waiting++] = swap ? number + 1 : branch.second;  // the nearer one is next
    stack[waiting++] = swap ? branch.second : number + 1;
  }
  if (found >= 0) return best;
  double farthest = -mjMAXVAL;
  int face = 0;
  for (stack[waiting++] = 0; waiting > 0;) {
    const int number = stack[--waiting];
    const Branch& branch = branches_[number];
    if (HighestPlane(branch, p) < farthest) continue;
    if (branch.second < 0) {
      for (int i = branch.begin; i < branch.end; i++) {
        const double above = Plane(order_[i], p);
        if (!(above > farthest || (above == farthest && order_[i] < face))) continue;
        farthest = above;
        face = order_[i];
      }
      if (farthest > 0) return mjMAXVAL;  // outside, and no face is within reach
      continue;
    }
    const bool swap = HighestPlane(branches_[branch.second], p) > HighestPlane(branches_[number + 1], p);
    stack[waiting++] = swap ? number + 1 : branch.second;
    stack[waiting++] = swap ? branch.second : number + 1;
  }
  *normal = {nx_[face], ny_[face], nz_[face]};
  return farthest;
}

}  // namespace mjframes
