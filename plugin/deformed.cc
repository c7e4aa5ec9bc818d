#include "deformed.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "constants.h"

namespace mjframes {
namespace {

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

void DeformedNodes::Forget() {
  if (++version_ != 0) return;
  for (Node& node : nodes_) node.node = -1;
}

DeformedNodes::Node DeformedNodes::Deform(const DistanceField& field, const PatchVolume& volume, const Vec3* x,
                                          int number) const {
  double total = 0;
  Vec3 sum{};
  for (int e = field.start[number]; e < field.start[number + 1]; e++) {
    const int j = field.point[e];
    if (!volume.in_rows[j]) continue;
    const double weight = field.weight[e];
    total += weight;
    sum = sum + weight * x[j];
  }
  return {total < kLeastInRows ? Vec3{} : (1 / total) * sum, total, number, version_};
}

DeformedPatch::DeformedPatch(const ContactModel& contact, int patch, const Vec3* x, DeformedNodes* nodes)
    : contact_(contact),
      x_(x),
      nodes_(nodes),
      field_(contact.field),
      volume_(contact.patches[patch].volume),
      patch_(patch) {}

Vec3 DeformedPatch::VertexPoint(int s) const {
  const double* xi = field_.vertex.data() + 3 * (volume_.first_vertex + s);
  return {xi[0], xi[1], xi[2]};
}

// Whether any of the nodes is under this patch, and any within a cube of the inside.
bool DeformedPatch::Owns(const int* nodes) const {
  const bool owned = std::any_of(nodes, nodes + 8, [this](int node) { return field_.patch[node] == patch_; });
  return owned && std::any_of(nodes, nodes + 8, [this](int node) { return field_.distance[node] < field_.spacing; });
}

// Whether the nearest of the nodes is under this patch; of several that are as near, any.
bool DeformedPatch::Nearest(const int* nodes, const Vec3& fraction) const {
  for (int corner = 0; corner < 8; corner++) {
    bool near = true;
    for (int i = 0; i < 3; i++) near &= corner >> i & 1 ? fraction[i] > 0.5 - kTie : fraction[i] < 0.5 + kTie;
    if (near && field_.patch[nodes[corner]] == patch_) return true;
  }
  return false;
}

bool DeformedPatch::Deform(const int* nodes, Cube* cube) const {
  if (nodes[0] == cube->nodes[0]) return true;
  cube->nodes[0] = -1;
  for (int corner = 0; corner < 8; corner++) {
    const DeformedNodes::Node& node = nodes_->At(nodes[corner], field_, volume_, x_);
    if (node.total < kLeastInRows) return false;
    cube->x[corner] = node.x;
  }
  std::copy(nodes, nodes + 8, cube->nodes);
  return true;
}

bool DeformedPatch::Find(const Vec3& p, bool own, Vec3* xi, Cube* cube) const {
  const double volume = field_.spacing * field_.spacing * field_.spacing;
  for (int step = 0; step < kFindSteps; step++) {
    int nodes[8];
    Vec3 fraction;
    if (!field_.CubeAt(*xi, nodes, &fraction)) return false;
    // the first step may still be off by a cube or two
    if (own && step > 1 && !Owns(nodes)) return false;
    if (!Deform(nodes, cube)) return false;
    Mat3 F;
    const Vec3 gap = p - Interpolate(cube->x, fraction, &F);
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

bool DeformedPatch::Surface(const Vec3& xi, Cube* cube, Vec3* position, Vec3* normal) const {
  Vec3 q = xi, fraction, gradient;
  int nodes[8];
  for (int climb = 0;; climb++) {
    if (!field_.CubeAt(q, nodes, &fraction)) return false;
    const double height = field_.Distance(nodes, fraction, &gradient) / field_.spacing;
    const double length = Norm(gradient);
    if (!(length > kFlatDistance * field_.spacing)) return false;
    if (climb == kClimbs || std::abs(height) < kOnSurface) break;
    q = q - (height / length) * gradient;
  }
  Mat3 F;
  if (!Deform(nodes, cube)) return false;
  *position = Interpolate(cube->x, fraction, &F);
  if (!(Det(F) > 0)) return false;
  const Vec3 out = MulT(Inverse(F), gradient);
  *normal = (1 / Norm(out)) * out;
  return true;
}

bool DeformedPatch::Distance(const Vec3& p, bool own, Vec3* xi, double* distance, Vec3* normal) const {
  Cube cube;
  Vec3 surface;
  if (!Find(p, own, xi, &cube) || !Surface(*xi, &cube, &surface, normal)) return false;
  *distance = Dot(*normal, p - surface);
  return true;
}

void DeformedPatch::AddWeights(const Vec3& xi, double scale, double* weight) const {
  int nodes[8];
  Vec3 fraction;
  if (!field_.CubeAt(xi, nodes, &fraction)) return;
  const std::array<double, 8> trilinear = TrilinearWeights(fraction);
  for (int corner = 0; corner < 8; corner++) {
    const double share = scale * trilinear[corner] / nodes_->At(nodes[corner], field_, volume_, x_).total;
    for (int e = field_.start[nodes[corner]]; e < field_.start[nodes[corner] + 1]; e++) {
      if (volume_.in_rows[field_.point[e]]) weight[field_.point[e]] += share * field_.weight[e];
    }
  }
}

}  // namespace mjframes
