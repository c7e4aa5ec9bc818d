#include "geom_features.h"

#include <algorithm>
#include <cmath>

namespace mjframes {
namespace {

constexpr int kEdgePoints = 3;      // between the corners of a box: quarters
constexpr int kRimPoints = 16;      // of a cylinder: between them the rim bulges by 2 % of the radius
constexpr int kCapsulePoints = 17;  // at most
constexpr double kPi = 3.14159265358979323846;

int Octant(const Vec3& p) { return (p[0] > 0) + 2 * (p[1] > 0) + 4 * (p[2] > 0); }

void AddBox(const mjtNum* half, Features* out) {
  for (int corner = 0; corner < 8; corner++) {
    Vec3 p;
    for (int i = 0; i < 3; i++) p[i] = corner >> i & 1 ? half[i] : -half[i];
    out->points.push_back({p, corner});
  }
  for (int axis = 0; axis < 3; axis++) {
    for (int corner = 0; corner < 8; corner++) {
      if (corner >> axis & 1) continue;
      for (int step = 1; step <= kEdgePoints; step++) {
        Vec3 p = out->points[corner].position;
        p[axis] = half[axis] * (2.0 * step / (kEdgePoints + 1) - 1);
        out->points.push_back({p, Octant(p)});
      }
    }
  }
}

void AddCylinder(double radius, double half, Features* out) {
  for (int step = 0; step < kRimPoints; step++) {
    const double angle = 2 * kPi * (step + 0.5) / kRimPoints;
    for (const double z : {-half, half}) {
      const Vec3 p = {radius * std::cos(angle), radius * std::sin(angle), z};
      out->points.push_back({p, Octant(p)});
    }
  }
}

void AddCapsule(double radius, double half, Features* out) {
  out->radius = radius;
  const int count = std::clamp(2 + static_cast<int>(2 * half / radius), 2, kCapsulePoints);
  for (int i = 0; i < count; i++) {
    const Vec3 p = {0, 0, half * (2.0 * i / (count - 1) - 1)};
    out->points.push_back({p, p[2] > 0});
  }
}

void FindClusters(Features* out) {
  std::vector<Feature>& points = out->points;
  std::stable_sort(points.begin(), points.end(),
                   [](const Feature& a, const Feature& b) { return a.cluster < b.cluster; });
  for (size_t begin = 0, end; begin < points.size(); begin = end) {
    Vec3 low = points[begin].position, high = low;
    for (end = begin; end < points.size() && points[end].cluster == points[begin].cluster; end++) {
      for (int i = 0; i < 3; i++) {
        low[i] = std::min(low[i], points[end].position[i]);
        high[i] = std::max(high[i], points[end].position[i]);
      }
    }
    out->clusters.push_back({begin, end, {0.5 * (low + high), 0.5 * (high - low)}});
  }
}

}  // namespace

std::vector<Features> GeomFeatures(const mjModel* m, const Hulls& hulls) {
  std::vector<Features> features(m->ngeom);
  for (int geom = 0; geom < m->ngeom; geom++) {
    Features& out = features[geom];
    const mjtNum* size = m->geom_size + 3 * geom;
    const int mesh = m->geom_plugin[geom] < 0 ? m->geom_dataid[geom] : -1;
    switch (m->geom_type[geom]) {
      case mjGEOM_SPHERE:
        out.radius = size[0];
        out.points.push_back({{0, 0, 0}, 0});
        break;
      case mjGEOM_ELLIPSOID:
        out.round = true;
        out.points.push_back({{0, 0, 0}, 0});
        break;
      case mjGEOM_CAPSULE:
        AddCapsule(size[0], size[1], &out);
        break;
      case mjGEOM_CYLINDER:
        AddCylinder(size[0], size[1], &out);
        break;
      case mjGEOM_BOX:
        AddBox(size, &out);
        break;
      case mjGEOM_MESH:
      case mjGEOM_SDF:
        if (mesh < 0 || !hulls[mesh]) break;
        for (const Vec3& p : hulls[mesh]->vertices()) out.points.push_back({p, Octant(p)});
        break;
      default:
        break;
    }
    FindClusters(&out);
  }
  return features;
}

Vec3 EllipsoidSupport(const mjtNum* size, const Vec3& direction) {
  Vec3 scaled;
  for (int i = 0; i < 3; i++) scaled[i] = size[i] * direction[i];
  const double norm = std::max(Norm(scaled), mjMINVAL);
  for (int i = 0; i < 3; i++) scaled[i] *= size[i] / norm;
  return scaled;
}

}  // namespace mjframes
