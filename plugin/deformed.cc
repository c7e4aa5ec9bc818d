#include "deformed.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace mjframes {
namespace {

constexpr double kFound = 1e-13;     // [m] rounding of a world position
constexpr int kSteps = 20;           // of Newton's method; four are usual
constexpr int kFullSteps = 6;        // after these it is damped: it may swing between cells of unlike slope
constexpr double kStride = 3;        // [cells] longest step
constexpr double kTie = 1e-3;        // [cells] two patches may both have what is midway: neither would be worse
constexpr int kClimbs = 3;           // steps up to the surface along the distance's gradient
constexpr double kFlat = 0.05;       // [-] a gradient shorter than this has no direction: midway between two sides
constexpr double kOnSurface = 1e-6;  // [cells]
constexpr double kCollapsed = 1e-6;  // [-] of a cell's rest volume: turned inside out or flat

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

DeformedPatch::DeformedPatch(const ContactModel& contact, int patch, const Vec3* x)
    : contact_(contact), x_(x), lattice_(contact.lattice), volume_(contact.patches[patch].volume), patch_(patch) {}

Vec3 DeformedPatch::VertexPoint(int s) const {
  const double* xi = lattice_.vertex.data() + 3 * (volume_.first_vertex + s);
  return {xi[0], xi[1], xi[2]};
}

// Whether any of the nodes is under this patch, and any within a cell of the inside.
bool DeformedPatch::Owns(const int* nodes) const {
  const bool owned = std::any_of(nodes, nodes + 8, [this](int node) { return lattice_.patch[node] == patch_; });
  return owned &&
         std::any_of(nodes, nodes + 8, [this](int node) { return lattice_.distance[node] < lattice_.spacing; });
}

// Whether the nearest of the nodes is under this patch; of several that are as near, any.
bool DeformedPatch::Nearest(const int* nodes, const Vec3& fraction) const {
  for (int corner = 0; corner < 8; corner++) {
    bool near = true;
    for (int i = 0; i < 3; i++) near &= corner >> i & 1 ? fraction[i] > 0.5 - kTie : fraction[i] < 0.5 + kTie;
    if (near && lattice_.patch[nodes[corner]] == patch_) return true;
  }
  return false;
}

bool DeformedPatch::Deform(const int* nodes, Cell* cell) const {
  if (nodes[0] == cell->nodes[0]) return true;
  cell->nodes[0] = -1;
  for (int corner = 0; corner < 8; corner++) {
    const int node = nodes[corner];
    double held = 0;
    Vec3 sum{};
    for (int e = lattice_.start[node]; e < lattice_.start[node + 1]; e++) {
      const int j = lattice_.point[e];
      if (!volume_.holds[j]) continue;
      const double weight = lattice_.weight[e];
      held += weight;
      sum = sum + weight * x_[j];
    }
    if (held < kHeld) return false;
    cell->x[corner] = (1 / held) * sum;
  }
  std::copy(nodes, nodes + 8, cell->nodes);
  return true;
}

bool DeformedPatch::Find(const Vec3& p, bool own, Vec3* xi, Cell* cell) const {
  const double volume = lattice_.spacing * lattice_.spacing * lattice_.spacing;
  for (int step = 0; step < kSteps; step++) {
    int nodes[8];
    Vec3 fraction;
    if (!lattice_.Cell(*xi, nodes, &fraction)) return false;
    // the first step may still be off by a cell or two
    if (own && step > 1 && !Owns(nodes)) return false;
    if (!Deform(nodes, cell)) return false;
    Mat3 F;
    const Vec3 gap = p - Interpolate(cell->x, fraction, &F);
    if (Norm(gap) < kFound) {
      return !own || Nearest(nodes, fraction);
    }
    if (!(Det(F) > kCollapsed * volume)) return false;
    const Vec3 move = Mul(Inverse(F), gap);
    const double limit = kStride / std::max(kStride, Norm(move));
    *xi = *xi + (step < kFullSteps ? limit : 0.5 * limit) * move;
  }
  return false;
}

bool DeformedPatch::Surface(const Vec3& xi, Cell* cell, Vec3* position, Vec3* normal) const {
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
  Mat3 F;
  if (!Deform(nodes, cell)) return false;
  *position = Interpolate(cell->x, fraction, &F);
  if (!(Det(F) > 0)) return false;
  const Vec3 out = MulT(Inverse(F), gradient);
  *normal = (1 / Norm(out)) * out;
  return true;
}

bool DeformedPatch::Distance(const Vec3& p, bool own, Vec3* xi, double* distance, Vec3* normal) const {
  Cell cell;
  Vec3 surface;
  if (!Find(p, own, xi, &cell) || !Surface(*xi, &cell, &surface, normal)) return false;
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
