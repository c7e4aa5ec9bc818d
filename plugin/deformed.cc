#include "deformed.h"

#include <algorithm>
#include <cmath>

#include "soft.h"

namespace mjframes {
namespace {

constexpr double kFound = 1e-13;     // [m] rounding of a world position
constexpr int kSteps = 20;           // of Newton's method; four are usual
constexpr int kFullSteps = 6;        // after these it is damped: it may swing between cells of unlike slope
constexpr double kStride = 3;        // [cells] longest step
constexpr double kHeld = 0.5;        // [-] a node of which the rows hold less weight belongs to another branch
constexpr int kClimbs = 3;           // steps up to the surface along the distance's gradient
constexpr double kFlat = 0.05;       // [-] a gradient shorter than this has no direction: midway between two sides
constexpr double kOnSurface = 1e-6;  // [cells]
constexpr double kCollapsed = 1e-6;  // [-] of a cell's rest volume: turned inside out or flat

const mjtNum* Position(const SoftBody& body, const mjData* d, int j) { return d->xpos + 3 * body.points()[j].body; }

// Σ_n c_n x(n) and its derivative by ξ.
Vec3 Interpolate(const Vec3* x, const Vec3& f, Mat3* F) {
  Vec3 along_x[4], slope_x[4], value{};
  for (int k = 0; k < 4; k++) {
    slope_x[k] = x[2 * k + 1] - x[2 * k];
    along_x[k] = x[2 * k] + f[0] * slope_x[k];
  }
  const Vec3 low = along_x[0] + f[1] * (along_x[1] - along_x[0]);
  const Vec3 high = along_x[2] + f[1] * (along_x[3] - along_x[2]);
  value = low + f[2] * (high - low);
  const Vec3 dx = (1 - f[2]) * (slope_x[0] + f[1] * (slope_x[1] - slope_x[0])) +
                  f[2] * (slope_x[2] + f[1] * (slope_x[3] - slope_x[2]));
  const Vec3 dy = (1 - f[2]) * (along_x[1] - along_x[0]) + f[2] * (along_x[3] - along_x[2]);
  const Vec3 dz = high - low;
  for (int i = 0; i < 3; i++) {
    (*F)[3 * i] = dx[i];
    (*F)[3 * i + 1] = dy[i];
    (*F)[3 * i + 2] = dz[i];
  }
  return value;
}

}  // namespace

PatchVolume PatchVolume::Create(const SoftBody& body, int number) {
  const std::vector<ControlPoint>& points = body.points();
  const Lattice& lattice = body.lattice();
  const Patch& patch = body.patches()[number];
  const size_t k = points.size();
  PatchVolume volume = {std::vector<uint8_t>(k, 0), 0, 0, {}, {}, {}};
  for (int i = 0; i < number; i++) volume.first_vertex += body.patches()[i].vertices;
  for (size_t j = 0; j < k; j++) volume.holds[j] = !points[j].moves();
  for (int j = patch.owner; j >= 0; j = points[j].parent) volume.holds[j] = 1;

  const int n = patch.vertices;
  std::vector<double> mean(k, 0.0), spread(k, 0.0), weight(k);
  for (size_t a = 0; a < patch.point.size(); a++) {
    for (int s = 0; s < n; s++) mean[patch.point[a]] += patch.weight[a * n + s] / n;
  }
  for (size_t a = 0; a < patch.point.size(); a++) {
    const int j = patch.point[a];
    for (int s = 0; s < n; s++) spread[j] = std::max(spread[j], std::abs(patch.weight[a * n + s] - mean[j]));
  }
  // a point under the patch is in a cell with one of its nodes
  const int32_t* shape = lattice.shape.data();
  for (const int32_t place : lattice.node) {
    const Vec3 corner = {static_cast<double>(place / (shape[1] * shape[2])),
                         static_cast<double>(place / shape[2] % shape[1]), static_cast<double>(place % shape[2])};
    int nodes[8];
    Vec3 fraction;
    if (!lattice.Cell(corner, nodes, &fraction)) continue;
    const bool owned = std::any_of(nodes, nodes + 8, [&](int node) { return lattice.patch[node] == number; });
    const bool inside = std::any_of(nodes, nodes + 8, [&](int node) { return lattice.distance[node] < 0; });
    if (!owned || !inside) continue;
    for (const int node : nodes) {
      if (lattice.patch[node] == number) volume.depth = std::max(volume.depth, -lattice.distance[node]);
      std::fill(weight.begin(), weight.end(), 0.0);
      double held = 0;
      for (int e = lattice.start[node]; e < lattice.start[node + 1]; e++) {
        if (!volume.holds[lattice.point[e]]) continue;
        weight[lattice.point[e]] = lattice.weight[e];
        held += lattice.weight[e];
      }
      if (held < kHeld) continue;
      for (size_t j = 0; j < k; j++) spread[j] = std::max(spread[j], std::abs(weight[j] / held - mean[j]));
    }
  }
  for (size_t j = 0; j < k; j++) {
    if (spread[j] == 0 && mean[j] == 0) continue;
    volume.point.push_back(static_cast<int32_t>(j));
    volume.mean.push_back(mean[j]);
    volume.spread.push_back(spread[j]);
  }
  return volume;
}

DeformedPatch::DeformedPatch(const SoftBody& body, int patch, const mjData* d)
    : body_(body), data_(d), lattice_(body.lattice()), volume_(body.volumes()[patch]), patch_(patch) {}

const Patch& DeformedPatch::patch() const { return body_.patches()[patch_]; }

Vec3 DeformedPatch::VertexPoint(int s) const {
  const double* xi = lattice_.vertex.data() + 3 * (volume_.first_vertex + s);
  return {xi[0], xi[1], xi[2]};
}

Sphere DeformedPatch::Bounds() const {
  Sphere sphere = {{}, body_.contact_radius()};
  for (size_t a = 0; a < volume_.point.size(); a++) {
    const mjtNum* x = Position(body_, data_, volume_.point[a]);
    sphere.centre = sphere.centre + volume_.mean[a] * Vec3{x[0], x[1], x[2]};
  }
  for (size_t a = 0; a < volume_.point.size(); a++) {
    const mjtNum* x = Position(body_, data_, volume_.point[a]);
    sphere.radius += volume_.spread[a] * Norm(Vec3{x[0], x[1], x[2]} - sphere.centre);
  }
  return sphere;
}

bool DeformedPatch::Deform(const int* nodes, Cell* cell) const {
  for (int corner = 0; corner < 8; corner++) {
    const int node = nodes[corner];
    cell->nodes[corner] = node;
    double held = 0;
    Vec3 sum{};
    for (int e = lattice_.start[node]; e < lattice_.start[node + 1]; e++) {
      const int j = lattice_.point[e];
      if (!volume_.holds[j]) continue;
      const double weight = lattice_.weight[e];
      const mjtNum* x = Position(body_, data_, j);
      held += weight;
      for (int i = 0; i < 3; i++) sum[i] += weight * x[i];
    }
    if (held < kHeld) return false;
    cell->x[corner] = (1 / held) * sum;
  }
  return true;
}

bool DeformedPatch::Find(const Vec3& p, Vec3* xi) const {
  const double volume = lattice_.spacing * lattice_.spacing * lattice_.spacing;
  Cell cell;
  cell.nodes[0] = -1;
  for (int step = 0; step < kSteps; step++) {
    int nodes[8];
    Vec3 fraction;
    if (!lattice_.Cell(*xi, nodes, &fraction)) return false;
    if (nodes[0] != cell.nodes[0] && !Deform(nodes, &cell)) return false;
    Mat3 F;
    const Vec3 gap = p - Interpolate(cell.x, fraction, &F);
    if (Norm(gap) < kFound) return true;
    if (!(Det(F) > kCollapsed * volume)) return false;
    const Vec3 move = Mul(Inverse(F), gap);
    const double limit = kStride / std::max(kStride, Norm(move));
    *xi = *xi + (step < kFullSteps ? limit : 0.5 * limit) * move;
  }
  return false;
}

bool DeformedPatch::Surface(const Vec3& xi, bool own, Vec3* position, Vec3* normal) const {
  Vec3 q = xi, fraction, gradient;
  int nodes[8];
  for (int climb = 0;; climb++) {
    if (!lattice_.Cell(q, nodes, &fraction)) return false;
    const double height = lattice_.Distance(nodes, fraction, &gradient) / lattice_.spacing;
    const double length = Norm(gradient);
    if (!(length > kFlat * lattice_.spacing)) return false;
    if (climb == kClimbs || std::abs(height) < kOnSurface) break;
    q = q - (height / length) * gradient;
  }
  const int nearest = (fraction[0] > 0.5) + 2 * (fraction[1] > 0.5) + 4 * (fraction[2] > 0.5);
  if (own && lattice_.patch[nodes[nearest]] != patch_) return false;
  Cell cell;
  Mat3 F;
  if (!Deform(nodes, &cell)) return false;
  *position = Interpolate(cell.x, fraction, &F);
  if (!(Det(F) > 0)) return false;
  const Vec3 out = MulT(Inverse(F), gradient);
  *normal = (1 / Norm(out)) * out;
  return true;
}

bool DeformedPatch::Distance(const Vec3& p, Vec3* xi, double* distance, Vec3* normal) const {
  Vec3 surface;
  if (!Find(p, xi) || !Surface(*xi, true, &surface, normal)) return false;
  *distance = Dot(*normal, p - surface);
  return true;
}

void DeformedPatch::AddWeights(const Vec3& xi, double scale, double* weight) const {
  int nodes[8];
  Vec3 fraction;
  if (!lattice_.Cell(xi, nodes, &fraction)) return;
  const std::array<double, 8> share = Shares(fraction);
  for (int corner = 0; corner < 8; corner++) {
    double held = 0;
    const int begin = lattice_.start[nodes[corner]], end = lattice_.start[nodes[corner] + 1];
    for (int e = begin; e < end; e++) held += volume_.holds[lattice_.point[e]] * lattice_.weight[e];
    for (int e = begin; e < end; e++) {
      if (volume_.holds[lattice_.point[e]])
        weight[lattice_.point[e]] += scale * share[corner] / held * lattice_.weight[e];
    }
  }
}

}  // namespace mjframes
