#include "patch.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "constants.h"
#include "kinematics.h"
#include "quadric.h"

namespace mjframes {
namespace {

// Weights of all control points at the vertices of a patch and at the nodes of the cubes below it.
std::vector<std::vector<double>> SampleWeights(const ContactModel& contact, size_t k, int number,
                                               const std::vector<uint8_t>& in_rows) {
  const DistanceField& field = contact.field;
  const Patch& patch = contact.patches[number];
  std::vector<std::vector<double>> samples;
  for (int s = 0; s < patch.vertices; s++) {
    samples.emplace_back(k, 0.0);
    for (size_t a = 0; a < patch.point.size(); a++) {
      samples.back()[patch.point[a]] = patch.weight[a * patch.vertices + s];
    }
  }
  for (const int node : field.NodesBelow(number)) {
    std::vector<double> weight(k, 0.0);
    int total = 0;
    for (int e = field.start[node]; e < field.start[node + 1]; e++) {
      const auto [units, point] = field.weight[e];
      if (!in_rows[point]) continue;
      weight[point] = units;
      total += units;
    }
    if (total < kLeastInRows * field.units[node]) continue;
    for (double& w : weight) w /= total;
    samples.push_back(std::move(weight));
  }
  return samples;
}

// Of each node, to the nearest that the patch has inside or up to a cube outside.
std::vector<uint8_t> StepsToPatch(const DistanceField& field, int patch) {
  std::vector<uint8_t> steps(field.node.size(), 255);
  const int32_t* shape = field.shape.data();
  for (size_t node = 0; node < steps.size(); node++) {
    if (field.patch[node] != patch || field.distance[node] > field.spacing) continue;
    const int x = field.node[node] / (shape[1] * shape[2]), y = field.node[node] / shape[2] % shape[1];
    const int z = field.node[node] % shape[2];
    for (int a = std::max(x - kTrustedCubes, 0); a <= std::min(x + kTrustedCubes, shape[0] - 1); a++) {
      for (int b = std::max(y - kTrustedCubes, 0); b <= std::min(y + kTrustedCubes, shape[1] - 1); b++) {
        for (int c = std::max(z - kTrustedCubes, 0); c <= std::min(z + kTrustedCubes, shape[2] - 1); c++) {
          const int other = field.place[(a * shape[1] + b) * shape[2] + c];
          if (other < 0) continue;
          const int far = std::max({std::abs(a - x), std::abs(b - y), std::abs(c - z)});
          steps[other] = static_cast<uint8_t>(std::min<int>(steps[other], far));
        }
      }
    }
  }
  return steps;
}

// From each vertex to the nearest of its cluster that is left, or else of the next cluster.
std::vector<int32_t> Walk(const std::vector<Vec3>& vertex, const std::vector<int32_t>& cluster) {
  std::vector<int32_t> walk(vertex.size());
  std::iota(walk.begin(), walk.end(), 0);
  auto next = walk.begin();
  for (const int32_t size : cluster) {
    for (const auto end = next + size; next != end; next++) {
      if (next == walk.begin()) continue;
      const Vec3& last = vertex[next[-1]];
      const auto nearer = [&](int a, int b) { return Norm(vertex[a] - last) < Norm(vertex[b] - last); };
      std::iter_swap(next, std::min_element(next, end, nearer));
    }
  }
  return walk;
}

// Of the surface at these vertices, in the lattice; the shorter, the less they agree.
Vec3 MeanNormal(const DistanceField& field, const std::vector<int>& vertices) {
  Vec3 mean{};
  for (const int v : vertices) {
    const Vec3 normal = field.Normal(v);
    mean = mean + (1 / std::max(mjMINVAL, Norm(normal) * static_cast<double>(vertices.size()))) * normal;
  }
  return mean;
}

Vec3 Middle(const std::vector<Vec3>& rest, const std::vector<int>& vertices) {
  Vec3 middle{};
  for (const int v : vertices) middle = middle + (1.0 / static_cast<double>(vertices.size())) * rest[v];
  return middle;
}

// To those of a cluster that are few, the nearest others that face about the same way, out: four beside each other are
// as good as flat, also of a ball.
void AddNeighbours(const DistanceField& field, const std::vector<Vec3>& rest, const Vec3& out, std::vector<int>* some) {
  const auto count = std::ssize(*some);
  if (count >= kRoundVertices) return;
  const Vec3 middle = Middle(rest, *some);
  std::vector<int> others;
  for (int v = 0; v < static_cast<int>(rest.size()); v++) {
    const Vec3 normal = field.Normal(v);
    const bool is_own = v >= some->front() && v <= some->back();
    if (!is_own && Dot(normal, out) > kRoundFacing * Norm(normal)) others.push_back(v);
  }
  const auto nearer = [&](int a, int b) { return Norm(rest[a] - middle) < Norm(rest[b] - middle); };
  const auto more = others.begin() + std::min<ptrdiff_t>(std::ssize(others), 2 * kRoundVertices - count);
  std::partial_sort(others.begin(), more, others.end(), nearer);
  some->insert(some->end(), others.begin(), more);
}

// Whether these vertices are on something smooth and convex, such as a ball or the side of a cylinder: near a
// paraboloid over their plane. out: about which way they face; shorter the less they agree.
bool IsRounded(const std::vector<Vec3>& rest, const std::vector<int>& vertices, const Vec3& out, double reach) {
  if (vertices.size() < kRoundVertices || !(Norm(out) > kRoundFacing)) return false;
  const Vec3 normal = (1 / Norm(out)) * out, middle = Middle(rest, vertices);
  const Tangents tangent(normal);
  Quadric quadric;
  for (const int v : vertices) {
    const Vec3 offset = (1 / reach) * (rest[v] - middle);
    quadric.Add(Dot(offset, tangent.x), Dot(offset, tangent.y), -Dot(offset, normal), 1);
  }
  if (!quadric.Fit()) return false;
  const double most = quadric.Curvature(0);
  return quadric.Curvature(1) > -kLeastRound && most > kLeastRound && most < kMostRound && quadric.Roughness() < kRough;
}

// The square of how far the nearest other one of some is [m²]; mjMAXVAL without any.
double NearestSquare(const Vec3& place, const std::vector<Vec3>& others) {
  double nearest = mjMAXVAL;
  for (const Vec3& other : others) {
    if (const Vec3 offset = other - place; Norm(offset) > 0) nearest = std::min(nearest, Dot(offset, offset));
  }
  return nearest;
}

// From each place to the nearest other one of some, root mean square; `alone` where there is no other [m].
double Spacing(const std::vector<Vec3>& places, const std::vector<Vec3>& others, double alone) {
  double sum = 0;
  for (const Vec3& place : places) {
    const double nearest = NearestSquare(place, others);
    sum += nearest < mjMAXVAL ? nearest : alone * alone;
  }
  return std::sqrt(sum / static_cast<double>(places.size()));
}

}  // namespace

PatchVolume PatchVolume::Create(const mjModel* m, const ContactModel& contact, const Kinematics& kinematics,
                                int number) {
  const std::vector<ControlPoint>& points = kinematics.points();
  const size_t k = points.size();
  PatchVolume volume;
  volume.in_rows.assign(k, 0);
  int deepest = -1;  // mover of the geom's body
  for (const ControlPoint& point : points) {
    if (point.body == m->geom_bodyid[contact.patches[number].geom]) deepest = point.mover;
  }
  for (size_t j = 0; j < k; j++) volume.in_rows[j] = kinematics.IsAbove(points[j].mover, deepest);

  volume.steps = StepsToPatch(contact.field, number);
  const DistanceField& field = contact.field;
  for (size_t node = 0; node < field.node.size(); node++) {
    const auto moves = [&](const NodeWeight& weight) { return volume.in_rows[weight.point] != 0; };
    const NodeWeight* first = field.weight.data();
    volume.whole.push_back(std::all_of(first + field.start[node], first + field.start[node + 1], moves));
  }
  const std::vector<std::vector<double>> samples = SampleWeights(contact, k, number, volume.in_rows);
  std::vector<double> mean(k, 0.0);
  for (const auto& weight : samples) {
    for (size_t j = 0; j < k; j++) mean[j] += weight[j] / static_cast<double>(samples.size());
  }
  const auto place = [&](const std::vector<double>& weight) {
    Vec3 p{};
    for (size_t j = 0; j < k; j++) p = p + weight[j] * points[j].rest;
    return p;
  };
  const Vec3 origin = volume.origin = place(mean);
  std::vector<Vec3> offset;
  Mat3 moment{};
  double size = 0;
  for (const auto& weight : samples) {
    const Vec3 p = place(weight) - origin;
    offset.push_back(p);
    size += Dot(p, p);
    for (int i = 0; i < 3; i++) {
      volume.half[i] = std::max(volume.half[i], std::abs(p[i]));
      for (int c = 0; c < 3; c++) moment[3 * i + c] += p[i] * p[c];
    }
  }
  // a patch without thickness has no slope across
  for (int i = 0; i < 3; i++) moment[4 * i] += 1e-9 * size + mjMINVAL;
  const Mat3 inverse = Inverse(moment);
  for (size_t j = 0; j < k; j++) {
    Vec3 sum{};
    for (size_t s = 0; s < samples.size(); s++) sum = sum + (samples[s][j] - mean[j]) * offset[s];
    const Vec3 slope = Mul(inverse, sum);
    double residual = 0;
    bool moves = false;
    for (size_t s = 0; s < samples.size(); s++) {
      residual = std::max(residual, std::abs(samples[s][j] - mean[j] - Dot(slope, offset[s])));
      moves |= samples[s][j] != 0;
    }
    if (!moves) continue;
    volume.point.push_back(static_cast<int32_t>(j));
    volume.mean.push_back(mean[j]);
    volume.slope.push_back(slope);
    volume.offset.push_back(points[j].rest - origin);
    volume.residual.push_back(residual);
  }
  return volume;
}

std::vector<Vec3> RestVertices(const ContactModel& contact, const Kinematics& kinematics) {
  std::vector<Vec3> vertex;
  for (const Patch& patch : contact.patches) {
    const size_t n = patch.vertices, first = vertex.size();
    vertex.resize(first + n);
    for (size_t s = 0; s < n; s++) {
      Vec3& place = vertex[first + s];
      for (size_t a = 0; a < patch.point.size(); a++) {
        place = place + patch.weight[a * n + s] * kinematics.points()[patch.point[a]].rest;
      }
      for (int c = 0; c < 3 && !patch.offset.empty(); c++) place[c] += patch.offset[c * n + s];
    }
  }
  return vertex;
}

void PatchVolume::SetCover(const ContactModel& contact, const std::vector<Vec3>& rest, int number) {
  for (int i = 0; i < number; i++) first_vertex += contact.patches[i].vertices;
  int vertex = first_vertex;
  const std::vector<Vec3> own(rest.begin() + vertex, rest.begin() + vertex + contact.patches[number].vertices);
  walk = Walk(own, contact.patches[number].cluster);
  spacing = Spacing(own, own, contact.reach);
  const DistanceField& field = contact.field;
  for (const int size : contact.patches[number].cluster) {
    if (!contact.has_volume) break;
    std::vector<int> some(size);
    std::iota(some.begin(), some.end(), vertex);
    const Vec3 mean = MeanNormal(field, some);
    AddNeighbours(field, rest, mean, &some);
    const Vec3 out = MeanNormal(field, some);
    const bool smooth = !(Norm(out) > kFlatSide);
    round.push_back(smooth && IsRounded(rest, some, Mul(ToMat3(field.axes.data()), out), contact.reach));
    facing.push_back(Norm(mean) > kFlatSide && !round.back() ? mean : Vec3{});
    vertex += size;
  }
  for (size_t i = 0; i < field.node.size(); i++) {
    if (field.patch[i] != number || std::abs(field.distance[i]) > field.spacing) continue;
    solid |= field.distance[i] < 0;
    const Vec3 place = field.Place(static_cast<int>(i));
    double nearest = mjMAXVAL;
    for (const Vec3& one : own) nearest = std::min(nearest, Norm(one - place));
    cover = std::max(cover, nearest);
  }
  if (solid) return;
  spread = contact.reach;
  for (const Vec3& one : own) {
    const double nearest = NearestSquare(one, rest);
    spread = std::max(spread, nearest < mjMAXVAL ? std::sqrt(nearest) : 0);
  }
}

double RoundSpacing(const ContactModel& contact, const std::vector<Vec3>& rest) {
  std::vector<Vec3> places;
  auto next = rest.begin();
  for (const Patch& patch : contact.patches) {
    for (size_t c = 0; c < patch.cluster.size(); c++) {
      const auto end = next + patch.cluster[c];
      if (c < patch.volume.round.size() && patch.volume.round[c]) places.insert(places.end(), next, end);
      next = end;
    }
  }
  return places.empty() ? 0 : Spacing(places, rest, contact.reach);
}

Mat3 PatchVolume::SlopeOf(const Vec3* x) const {
  Mat3 B{};
  for (size_t a = 0; a < point.size(); a++) {
    for (int i = 0; i < 3; i++) {
      for (int c = 0; c < 3; c++) B[3 * i + c] += x[point[a]][i] * slope[a][c];
    }
  }
  return B;
}

PatchPose PatchVolume::Pose(const DistanceField& field, const Vec3* positions) const {
  AlignedBox box = {{}, {}};
  const Mat3 B = SlopeOf(positions);
  for (size_t a = 0; a < point.size(); a++) box.centre = box.centre + mean[a] * positions[point[a]];
  Vec3 bend{};
  for (size_t a = 0; a < point.size(); a++) {
    const Vec3& x = positions[point[a]];
    const Vec3 affine = box.centre + Mul(B, offset[a]);
    for (int i = 0; i < 3; i++) bend[i] += residual[a] * std::abs(x[i] - affine[i]);
  }
  for (int i = 0; i < 3; i++) {
    box.half[i] = bend[i];
    for (int c = 0; c < 3; c++) box.half[i] += std::abs(B[3 * i + c]) * half[c];
  }
  PatchPose pose = {box, field.Coordinates(origin), {}, mjMAXVAL, NormBound(B)};
  if (Det(B) > mjMINVAL) {
    const Mat3 inverse = Inverse(B);
    for (int i = 0; i < 9; i++) pose.slope[i] = 0;
    for (int i = 0; i < 3; i++) {
      for (int c = 0; c < 3; c++) {
        for (int e = 0; e < 3; e++) pose.slope[3 * i + c] += field.axes[3 * e + i] * inverse[3 * e + c] / field.spacing;
      }
    }
    Vec3 error{};
    for (int i = 0; i < 3; i++) {
      for (int c = 0; c < 3; c++) error[i] += std::abs(pose.slope[3 * i + c]) * bend[c];
    }
    pose.error = Norm(error);
  }
  return pose;
}

bool PatchVolume::Near(const DistanceField& field, const Vec3& xi, double error) const {
  int64_t node = 0;
  for (int i = 0; i < 3; i++) {
    if (!(xi[i] > -0.5) || !(xi[i] < field.shape[i] - 0.5)) return false;
    node = node * field.shape[i] + static_cast<int64_t>(xi[i] + 0.5);
  }
  // half a cube from ξ to its nearest node, and half a cube from the material to that of the patch
  return field.place[node] >= 0 && steps[field.place[node]] <= error + 1;
}

}  // namespace mjframes
