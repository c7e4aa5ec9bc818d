#include "geom_distance.h"

#include <algorithm>
#include <cmath>

#include "constants.h"
#include "height_field.h"
#include "simd.h"

namespace mjframes {
namespace {

// Unit vector along v, or `otherwise` where v vanishes.
Vec3 Direction(const Vec3& v, const Vec3& otherwise) {
  const double norm = Norm(v);
  return norm > kNoDirection ? (1 / norm) * v : otherwise;
}

double Sign(double x) { return x < 0 ? -1 : 1; }

double Ball(const Vec3& offset, double radius, Vec3* normal) {
  *normal = Direction(offset, {0, 0, 1});
  return Norm(offset) - radius;
}

double Box(const Vec3& p, const Vec3& half, Vec3* normal) {
  const Vec3 q = {std::abs(p[0]) - half[0], std::abs(p[1]) - half[1], std::abs(p[2]) - half[2]};
  const int face = q[0] > q[1] ? (q[0] > q[2] ? 0 : 2) : (q[1] > q[2] ? 1 : 2);
  Vec3 axis{};
  axis[face] = Sign(p[face]);
  if (q[face] <= 0) {
    *normal = axis;
    return q[face];
  }
  const Vec3 outside = {std::max(q[0], 0.0), std::max(q[1], 0.0), std::max(q[2], 0.0)};
  *normal = Direction({Sign(p[0]) * outside[0], Sign(p[1]) * outside[1], Sign(p[2]) * outside[2]}, axis);
  return Norm(outside);
}

double Cylinder(const Vec3& p, double radius, double half, Vec3* normal) {
  const double rho = std::sqrt(p[0] * p[0] + p[1] * p[1]);
  const Vec3 radial = rho > kNoDirection ? Vec3{p[0] / rho, p[1] / rho, 0} : Vec3{1, 0, 0};
  const Vec3 axial = {0, 0, Sign(p[2])};
  const double side = rho - radius, cap = std::abs(p[2]) - half;
  if (side <= 0 || cap <= 0) {
    *normal = side > cap ? radial : axial;
    return std::max(side, cap);
  }
  *normal = Direction(side * radial + cap * axial, axial);
  return std::sqrt(side * side + cap * cap);
}

// Closest point on an ellipsoid: x_i = r_i² p_i / (r_i² + t) with t the largest root of Σ (r_i p_i / (r_i² + t))² = 1.
double Ellipsoid(const Vec3& p, const Vec3& radius, Vec3* normal) {
  const auto shortest = std::min_element(radius.begin(), radius.end()) - radius.begin();
  double t = -radius[shortest] * radius[shortest];
  for (int i = 0; i < 3; i++) t = std::max(t, radius[i] * std::abs(p[i]) - radius[i] * radius[i]);
  Vec3 closest{};
  double excess = 0;
  // the sum falls convexly in t, so Newton from its steep side converges monotonically
  for (int step = 0; step < kNewtonSteps; step++) {
    double slope = 0;
    excess = -1;
    for (int i = 0; i < 3; i++) {
      const double denominator = radius[i] * radius[i] + t;
      const double a = denominator > 0 ? radius[i] * p[i] / denominator : 0;
      closest[i] = radius[i] * a;
      excess += a * a;
      if (denominator > 0) slope -= 2 * a * a / denominator;
    }
    if (!(excess > kConverged) || slope == 0) break;
    t -= excess / slope;
  }
  // on the plane across the shortest axis the closest point may lie off that plane, on either side
  if (excess < -kConverged) closest[shortest] = radius[shortest] * std::sqrt(-excess);
  Vec3 gradient;
  double level = -1;
  for (int i = 0; i < 3; i++) {
    gradient[i] = closest[i] / (radius[i] * radius[i]);
    level += p[i] * p[i] / (radius[i] * radius[i]);
  }
  *normal = Direction(gradient, {0, 0, 1});
  return (level < 0 ? -1 : 1) * Norm(p - closest);
}

MJFRAMES_INLINE void PlaneDistances(const double* __restrict p, int n, const Vec3& position, const Mat3& axes,
                                    int begin, int end, double* __restrict out) {
  for (int s = begin; s < end; s++) {
    out[s] =
        axes[2] * (p[s] - position[0]) + axes[5] * (p[n + s] - position[1]) + axes[8] * (p[2 * n + s] - position[2]);
  }
}

// As Box, without normals.
MJFRAMES_INLINE void BoxDistances(const double* __restrict p, int n, const Vec3& position, const Mat3& axes,
                                  const Vec3& half, int begin, int end, double* __restrict out) {
  for (int s = begin; s < end; s++) {
    const double x = p[s] - position[0], y = p[n + s] - position[1], z = p[2 * n + s] - position[2];
    const double a = std::abs(axes[0] * x + axes[3] * y + axes[6] * z) - half[0];
    const double b = std::abs(axes[1] * x + axes[4] * y + axes[7] * z) - half[1];
    const double c = std::abs(axes[2] * x + axes[5] * y + axes[8] * z) - half[2];
    const double u = a > 0 ? a : 0, v = b > 0 ? b : 0, w = c > 0 ? c : 0;
    const double most = a > b ? a : b, face = most > c ? most : c;
    out[s] = std::sqrt(u * u + v * v + w * w) + (face < 0 ? face : 0);
  }
}

}  // namespace

GeomQuery::GeomQuery(const mjModel* m, const mjData* d, const CollisionMeshes& meshes, int geom, double reach)
    : valid(true),
      model(m),
      data(d),
      type(m->geom_type[geom]),
      size(ToVec3(m->geom_size + 3 * geom)),
      position(ToVec3(d->geom_xpos + 3 * geom)),
      orientation(ToMat3(d->geom_xmat + 9 * geom)),
      sdf_id(-1),
      plugin(nullptr),
      hull(nullptr),
      reach(reach),
      bound(m->geom_rbound[geom]),
      middle(ToVec3(m->geom_aabb + 6 * geom)),
      extent(ToVec3(m->geom_aabb + 6 * geom + 3)) {
  SetExtent();
  if (type == mjGEOM_SDF && m->geom_plugin[geom] >= 0) {
    plugin = mjc_getSDF(m, geom);
    sdf_id = m->geom_plugin[geom];
    valid = plugin->sdf_distance && plugin->sdf_gradient;
  } else if (type == mjGEOM_SDF || type == mjGEOM_MESH || type == mjGEOM_HFIELD) {
    sdf_id = m->geom_dataid[geom];
    if (type == mjGEOM_MESH && m->mesh_octadr[sdf_id] < 0) hull = meshes[sdf_id] ? &meshes[sdf_id]->hull : nullptr;
    valid = sdf_id >= 0 && (type == mjGEOM_HFIELD || hull || m->mesh_octadr[sdf_id] >= 0);
  }
}

// MuJoCo keeps the bounds of the size that was compiled.
void GeomQuery::SetExtent() {
  switch (type) {
    case mjGEOM_SPHERE:
      extent = {size[0], size[0], size[0]};
      bound = size[0];
      break;
    case mjGEOM_CAPSULE:
      extent = {size[0], size[0], size[0] + size[1]};
      bound = size[0] + size[1];
      break;
    case mjGEOM_CYLINDER:
      extent = {size[0], size[0], size[1]};
      bound = std::sqrt(size[0] * size[0] + size[1] * size[1]);
      break;
    case mjGEOM_ELLIPSOID:
      extent = size;
      bound = std::max({size[0], size[1], size[2]});
      break;
    case mjGEOM_BOX:
      extent = size;
      bound = Norm(size);
      break;
    default:
      break;
  }
}

void GeomQuery::Distances(const double* points, int n, int begin, int end, double* out) const {
  if (type == mjGEOM_PLANE) {
    Dispatch([&]<typename V>() MJFRAMES_KERNEL { PlaneDistances(points, n, position, orientation, begin, end, out); });
  } else if (type == mjGEOM_BOX) {
    Dispatch([&]<typename V>()
                 MJFRAMES_KERNEL { BoxDistances(points, n, position, orientation, size, begin, end, out); });
  } else {
    for (int s = begin; s < end; s++) out[s] = Distance({points[s], points[n + s], points[2 * n + s]}, nullptr);
  }
}

double GeomQuery::LowerBound(const AlignedBox& box) const {
  const Vec3 local = MulT(orientation, box.centre - position);
  if (bounded()) {
    Vec3 to_middle, between;
    for (int i = 0; i < 3; i++) {
      to_middle[i] = std::max(0.0, std::abs(position[i] - box.centre[i]) - box.half[i]);
      double half = extent[i];
      for (int c = 0; c < 3; c++) half += std::abs(orientation[3 * c + i]) * box.half[c];
      between[i] = std::max(0.0, std::abs(local[i] - middle[i]) - half);
    }
    return std::max(Norm(to_middle) - bound, Norm(between));
  }
  if (type == mjGEOM_HFIELD) return HeightFieldBound(model, sdf_id, local) - Norm(box.half);
  double below = 0;
  for (int i = 0; i < 3; i++) below += std::abs(orientation[3 * i + 2]) * box.half[i];
  return local[2] - below;
}

double GeomQuery::Distance(const Vec3& p, Vec3* normal) const {
  const Vec3 local = MulT(orientation, p - position);
  double distance = 0;
  Vec3 n{};
  switch (type) {
    case mjGEOM_PLANE:
      distance = local[2];
      n = {0, 0, 1};
      break;
    case mjGEOM_SPHERE:
      distance = Ball(local, size[0], &n);
      break;
    case mjGEOM_CAPSULE:
      distance = Ball({local[0], local[1], local[2] - std::clamp(local[2], -size[1], size[1])}, size[0], &n);
      break;
    case mjGEOM_ELLIPSOID:
      distance = Ellipsoid(local, size, &n);
      break;
    case mjGEOM_CYLINDER:
      distance = Cylinder(local, size[0], size[1], &n);
      break;
    case mjGEOM_BOX:
      distance = Box(local, size, &n);
      break;
    case mjGEOM_HFIELD:
      distance = HeightFieldDistance(model, sdf_id, local, reach, &n);
      break;
    default: {
      if (hull) {
        distance = hull->Distance(local, reach, &n);
        break;
      }
      mjtGeom geom_type = static_cast<mjtGeom>(type);
      const mjpPlugin* sdf_plugin = plugin;
      int id = sdf_id;
      mjSDF sdf = {&sdf_plugin, &id, mjSDFTYPE_SINGLE, nullptr, nullptr, &geom_type};
      mjtNum gradient[3];
      distance = mjc_distance(model, data, &sdf, local.data());
      mjc_gradient(model, data, &sdf, gradient, local.data());
      n = Direction(ToVec3(gradient), {0, 0, 1});
    }
  }
  if (normal) *normal = Mul(orientation, n);
  return distance;
}

}  // namespace mjframes
