#include "deformed.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "constants.h"
#include "simd.h"

namespace mjframes {
namespace {

// Σ_n c_n x(n) and its derivative by ξ. x: three numbers and another a node.
Vec3 Interpolate(const double (*x)[4], const Vec3& f, Mat3* F) {
  Vec3 value;
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    Lanes along_x[4], slope_x[4];
    for (int k = 0; k < 4; k++) {
      const Lanes low = Load(x[2 * k]);
      slope_x[k] = Load(x[2 * k + 1]) - low;
      along_x[k] = low + f[0] * slope_x[k];
    }
    const Lanes along_y[2] = {along_x[1] - along_x[0], along_x[3] - along_x[2]};
    const Lanes low = along_x[0] + f[1] * along_y[0], dz = along_x[2] + f[1] * along_y[1] - low;
    const Lanes dx_low = slope_x[0] + f[1] * (slope_x[1] - slope_x[0]);
    const Lanes dx_high = slope_x[2] + f[1] * (slope_x[3] - slope_x[2]);
    const Lanes dx = (1 - f[2]) * dx_low + f[2] * dx_high, dy = (1 - f[2]) * along_y[0] + f[2] * along_y[1];
    const Lanes at = low + f[2] * dz;
    for (int i = 0; i < 3; i++) {
      value[i] = at[i];
      (*F)[3 * i] = dx[i];
      (*F)[3 * i + 1] = dy[i];
      (*F)[3 * i + 2] = dz[i];
    }
  });
  return value;
}

}  // namespace

DeformedNode DeformedNode::Create(const DistanceField& field, const uint8_t* in_rows, const Vec3* x, int number) {
  int units = 0;
  Vec3 sum{};
  const NodeWeight* weights = field.weight.data();
  for (int e = field.start[number], end = field.start[number + 1]; e < end; e++) {
    const auto [part, j] = weights[e];
    if (in_rows && !in_rows[j]) continue;
    units += part;
    sum = sum + static_cast<double>(part) * x[j];
  }
  const double total = static_cast<double>(units) / field.units[number];
  const Vec3 mean = total < kLeastInRows ? Vec3{} : (1.0 / units) * sum;
  return {{mean[0], mean[1], mean[2], total}};
}

DeformedPatch::DeformedPatch(const ContactModel& contact, int patch, const Vec3* x, DeformedNodes* nodes)
    : contact_(contact),
      x_(x),
      nodes_(nodes),
      field_(contact.field),
      in_rows_(patch == kAllPatches ? nullptr : contact.patches[patch].volume.in_rows.data()),
      patch_(patch) {}

Vec3 DeformedPatch::VertexPoint(int s) const {
  return ToVec3(field_.vertex.data() + 3 * (patch().volume.first_vertex + s));
}

Vec3 DeformedPatch::VertexNormal(int s) const {
  Cube cube;
  Vec3 fraction;
  Mat3 F;
  if (!Enter(VertexPoint(s), &cube, &fraction) || !Deform(&cube)) return {};
  Interpolate(cube.x, fraction, &F);
  if (!(Det(F) > 0)) return {};
  const Vec3 out = MulT(Inverse(F), field_.Normal(patch().volume.first_vertex + s));
  const double length = Norm(out);
  return length > 0 ? (1 / length) * out : Vec3{};
}

// Whether any of the nodes is under this patch, and any within a cube of the inside.
bool DeformedPatch::Owns(const int* nodes) const {
  const bool owned = std::any_of(nodes, nodes + 8, [this](int node) { return field_.patch[node] == patch_; });
  return owned && std::any_of(nodes, nodes + 8, [this](int node) { return field_.distance[node] < field_.spacing; });
}

bool DeformedPatch::Enter(const Vec3& xi, Cube* cube, Vec3* fraction) const {
  if (cube->nodes[0] >= 0) {
    bool same = true;
    for (int i = 0; i < 3; i++) {
      (*fraction)[i] = xi[i] - cube->base[i];
      same &= (*fraction)[i] >= 0 && (*fraction)[i] < 1;
    }
    if (same) return true;
  }
  cube->nodes[0] = -1;
  int nodes[8];
  if (!field_.CubeAt(xi, nodes, fraction)) return false;
  std::copy(nodes, nodes + 8, cube->nodes);
  cube->base = xi - *fraction;
  cube->deformed = false;
  return true;
}

bool DeformedPatch::Deform(Cube* cube) const {
  if (cube->deformed) return true;
  for (int corner = 0; corner < 8; corner++) {
    const int node = cube->nodes[corner];
    const bool whole = !in_rows_ || patch().volume.whole[node];
    const DeformedNode& deformed = nodes_->At(node, field_, whole ? nullptr : in_rows_, patch_, x_);
    if (deformed.x[3] < kLeastInRows) return false;
    std::copy_n(deformed.x, 4, cube->x[corner]);
  }
  cube->deformed = true;
  return true;
}

DeformedPatch::Search DeformedPatch::Find(const Vec3& p, bool own, double height, Vec3* xi, Cube* cube, Mat3* slope,
                                          bool* found_own) const {
  const double volume = field_.spacing * field_.spacing * field_.spacing;
  bool owned = own || found_own;
  for (int step = 0; step < kFindSteps; step++) {
    Vec3 fraction;
    if (!Enter(*xi, cube, &fraction)) return Search::kOutside;
    // the first step may still be off by a cube or two
    if (owned && step > 1) owned = Owns(cube->nodes);
    if (own && !owned) return Search::kNowhere;
    if (!Deform(cube)) return Search::kNowhere;
    Mat3 F;
    const Vec3 gap = p - Interpolate(cube->x, fraction, &F);
    if (Dot(gap, gap) < kFound * kFound) {
      owned = owned && field_.IsNearest(cube->nodes, fraction, patch_);
      if (found_own) *found_own = owned;
      return owned || !own ? Search::kFound : Search::kNowhere;
    }
    if (!(Det(F) > kCollapsed * volume)) return Search::kNowhere;
    *slope = Inverse(F);
    const Vec3 move = Mul(*slope, gap);
    const double length = Norm(move), limit = kStride / std::max(kStride, length);
    // p is about as far from ξ as the step is long; the surface bends, so twice that, and twice the cubes a metre
    const bool above = height < mjMAXVAL && field_.Distance(cube->nodes, fraction) / field_.spacing - 2 * length >
                                                2 * height * NormBound(*slope);
    *xi = *xi + (step < kFullSteps ? limit : 0.5 * limit) * move;
    if (above) return Search::kAbove;
  }
  return Search::kNowhere;
}

bool DeformedPatch::Surface(Vec3* xi, Cube* cube, Vec3* position, Vec3* normal, double* doubt) const {
  Vec3 &q = *xi, fraction, gradient;
  for (int climb = 0;; climb++) {
    if (!Enter(q, cube, &fraction)) return false;
    const double height = field_.Distance(cube->nodes, fraction, &gradient) / field_.spacing;
    const double length = Norm(gradient);
    if (!(length > kFlatDistance * field_.spacing)) return false;
    *doubt = std::abs(length / field_.spacing - 1);
    if (climb == kClimbs || std::abs(height) < kOnSurface) break;
    q = q - (height / length) * gradient;
  }
  Mat3 F;
  if (!Deform(cube)) return false;
  *position = Interpolate(cube->x, fraction, &F);
  if (!(Det(F) > 0)) return false;
  const Vec3 out = MulT(Inverse(F), gradient);
  *normal = (1 / Norm(out)) * out;
  return true;
}

bool DeformedPatch::Distance(const Vec3& p, Cube* cube, Vec3* xi, double* distance, Vec3* normal, bool* own) const {
  Mat3 slope;
  Vec3 surface;
  double doubt;
  if (Find(p, false, mjMAXVAL, xi, cube, &slope, own) != Search::kFound) return false;
  Vec3 at = *xi;
  if (!Surface(&at, cube, &surface, normal, &doubt)) return false;
  *distance = Dot(*normal, p - surface);
  return true;
}

void DeformedPatch::AddWeights(const Vec3& xi, double scale, double* weight) const {
  int nodes[8];
  Vec3 fraction;
  if (!field_.CubeAt(xi, nodes, &fraction)) return;
  const std::array<double, 8> trilinear = TrilinearWeights(fraction);
  for (int corner = 0; corner < 8; corner++) {
    const NodeWeight *begin = field_.weight.data() + field_.start[nodes[corner]],
                     *end = field_.weight.data() + field_.start[nodes[corner] + 1];
    int total = 0;
    for (const NodeWeight* some = begin; some < end; some++) {
      if (in_rows_[some->point]) total += some->units;
    }
    const double unit = scale * trilinear[corner] / total;
    for (const NodeWeight* some = begin; some < end; some++) {
      if (in_rows_[some->point]) weight[some->point] += unit * some->units;
    }
  }
}

}  // namespace mjframes
