#include "patch.h"

#include <algorithm>
#include <cmath>

#include "kinematics.h"

namespace mjframes {
namespace {

constexpr int kReach = static_cast<int>(kTrusted) + 1;  // [cells]

// Weights of all control points at the vertices of a patch and at the nodes of the cells below it.
std::vector<std::vector<double>> SampleWeights(const ContactModel& contact, size_t k, int number,
                                               const std::vector<uint8_t>& holds) {
  const Lattice& lattice = contact.lattice;
  const Patch& patch = contact.patches[number];
  std::vector<std::vector<double>> samples;
  for (int s = 0; s < patch.vertices; s++) {
    samples.emplace_back(k, 0.0);
    for (size_t a = 0; a < patch.point.size(); a++) {
      samples.back()[patch.point[a]] = patch.weight[a * patch.vertices + s];
    }
  }
  std::vector<uint8_t> below(lattice.node.size(), 0);
  const int32_t* shape = lattice.shape.data();
  for (const int32_t place : lattice.node) {
    const Vec3 corner = {static_cast<double>(place / (shape[1] * shape[2])),
                         static_cast<double>(place / shape[2] % shape[1]), static_cast<double>(place % shape[2])};
    int nodes[8];
    Vec3 fraction;
    if (!lattice.Cell(corner, nodes, &fraction)) continue;
    const bool owned = std::any_of(nodes, nodes + 8, [&](int node) { return lattice.patch[node] == number; });
    const bool inside = std::any_of(nodes, nodes + 8, [&](int node) { return lattice.distance[node] < 0; });
    for (const int node : nodes) below[node] |= owned && inside;
  }
  for (size_t node = 0; node < below.size(); node++) {
    if (!below[node]) continue;
    std::vector<double> weight(k, 0.0);
    double held = 0;
    for (int e = lattice.start[node]; e < lattice.start[node + 1]; e++) {
      if (!holds[lattice.point[e]]) continue;
      weight[lattice.point[e]] = lattice.weight[e];
      held += lattice.weight[e];
    }
    if (held < kHeld) continue;
    for (double& w : weight) w /= held;
    samples.push_back(std::move(weight));
  }
  return samples;
}

// Of each node, to the nearest that the patch has inside or up to a cell outside.
std::vector<uint8_t> StepsToPatch(const Lattice& lattice, int patch) {
  std::vector<uint8_t> steps(lattice.node.size(), 255);
  const int32_t* shape = lattice.shape.data();
  for (size_t node = 0; node < steps.size(); node++) {
    if (lattice.patch[node] != patch || lattice.distance[node] > lattice.spacing) continue;
    const int x = lattice.node[node] / (shape[1] * shape[2]), y = lattice.node[node] / shape[2] % shape[1];
    const int z = lattice.node[node] % shape[2];
    for (int a = std::max(x - kReach, 0); a <= std::min(x + kReach, shape[0] - 1); a++) {
      for (int b = std::max(y - kReach, 0); b <= std::min(y + kReach, shape[1] - 1); b++) {
        for (int c = std::max(z - kReach, 0); c <= std::min(z + kReach, shape[2] - 1); c++) {
          const int other = lattice.place[(a * shape[1] + b) * shape[2] + c];
          if (other < 0) continue;
          const int far = std::max({std::abs(a - x), std::abs(b - y), std::abs(c - z)});
          steps[other] = static_cast<uint8_t>(std::min<int>(steps[other], far));
        }
      }
    }
  }
  return steps;
}

}  // namespace

PatchVolume PatchVolume::Create(const mjModel* m, const ContactModel& contact, const Kinematics& kinematics,
                                int number) {
  const std::vector<ControlPoint>& points = kinematics.points();
  const size_t k = points.size();
  PatchVolume volume;
  volume.holds.assign(k, 0);
  for (int i = 0; i < number; i++) volume.first_vertex += contact.patches[i].vertices;
  int deepest = -1;  // node of the geom's body
  for (const ControlPoint& point : points) {
    if (point.body == m->geom_bodyid[contact.patches[number].geom]) deepest = point.node;
  }
  for (size_t j = 0; j < k; j++) volume.holds[j] = kinematics.IsAbove(points[j].node, deepest);

  volume.steps = StepsToPatch(contact.lattice, number);
  const std::vector<std::vector<double>> samples = SampleWeights(contact, k, number, volume.holds);
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
    double rest = 0;
    bool moves = false;
    for (size_t s = 0; s < samples.size(); s++) {
      rest = std::max(rest, std::abs(samples[s][j] - mean[j] - Dot(slope, offset[s])));
      moves |= samples[s][j] != 0;
    }
    if (!moves) continue;
    volume.point.push_back(static_cast<int32_t>(j));
    volume.mean.push_back(mean[j]);
    volume.slope.push_back(slope);
    volume.offset.push_back(points[j].rest - origin);
    volume.rest.push_back(rest);
  }
  return volume;
}

void PatchVolume::SetCover(const ContactModel& contact, const Kinematics& kinematics, int number) {
  const Patch& patch = contact.patches[number];
  const size_t n = patch.vertices;
  std::vector<Vec3> vertex(n);
  for (size_t s = 0; s < n; s++) {
    for (size_t a = 0; a < patch.point.size(); a++) {
      vertex[s] = vertex[s] + patch.weight[a * n + s] * kinematics.points()[patch.point[a]].rest;
    }
    for (int c = 0; c < 3 && !patch.offset.empty(); c++) vertex[s][c] += patch.offset[c * n + s];
  }
  const auto from_nearest = [&vertex](const Vec3& p, size_t but) {
    double nearest = mjMAXVAL;
    for (size_t s = 0; s < vertex.size(); s++) {
      if (s != but) nearest = std::min(nearest, Norm(vertex[s] - p));
    }
    return nearest;
  };
  const Lattice& lattice = contact.lattice;
  for (size_t i = 0; i < lattice.node.size(); i++) {
    if (lattice.patch[i] != number || std::abs(lattice.distance[i]) > lattice.spacing) continue;
    solid |= lattice.distance[i] < 0;
    cover = std::max(cover, from_nearest(lattice.Place(static_cast<int>(i)), n));
  }
  if (solid) return;
  cover = contact.radius;
  for (size_t s = 0; s < n && n > 1; s++) cover = std::max(cover, from_nearest(vertex[s], s));
}

PatchPose PatchVolume::Pose(const Lattice& lattice, const Vec3* positions) const {
  AlignedBox box = {{}, {}};
  Mat3 B{};
  for (size_t a = 0; a < point.size(); a++) {
    const Vec3& x = positions[point[a]];
    for (int i = 0; i < 3; i++) {
      box.centre[i] += mean[a] * x[i];
      for (int c = 0; c < 3; c++) B[3 * i + c] += x[i] * slope[a][c];
    }
  }
  Vec3 bend{};
  for (size_t a = 0; a < point.size(); a++) {
    const Vec3& x = positions[point[a]];
    const Vec3 affine = box.centre + Mul(B, offset[a]);
    for (int i = 0; i < 3; i++) bend[i] += rest[a] * std::abs(x[i] - affine[i]);
  }
  for (int i = 0; i < 3; i++) {
    box.half[i] = bend[i];
    for (int c = 0; c < 3; c++) box.half[i] += std::abs(B[3 * i + c]) * half[c];
  }
  PatchPose pose = {box, lattice.Coordinates(origin), {}, mjMAXVAL, NormBound(B)};
  if (Det(B) > mjMINVAL) {
    const Mat3 inverse = Inverse(B);
    for (int i = 0; i < 9; i++) pose.slope[i] = 0;
    for (int i = 0; i < 3; i++) {
      for (int c = 0; c < 3; c++) {
        for (int e = 0; e < 3; e++)
          pose.slope[3 * i + c] += lattice.axes[3 * e + i] * inverse[3 * e + c] / lattice.spacing;
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

bool PatchVolume::Near(const Lattice& lattice, const Vec3& xi, double error) const {
  int64_t node = 0;
  for (int i = 0; i < 3; i++) {
    if (!(xi[i] > -0.5) || !(xi[i] < lattice.shape[i] - 0.5)) return false;
    node = node * lattice.shape[i] + static_cast<int64_t>(xi[i] + 0.5);
  }
  // half a cell from ξ to its nearest node, and half a cell from the material to that of the patch
  return lattice.place[node] >= 0 && steps[lattice.place[node]] <= error + 1;
}

}  // namespace mjframes
