#include "geom_features.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "constants.h"
#include "interned.h"

namespace mjframes {
namespace {

int Octant(const Vec3& p) { return (p[0] > 0) + 2 * (p[1] > 0) + 4 * (p[2] > 0); }

// Puts points into the order of their clusters, of those of a cluster that of before.
FeatureClusters Sort(const Vec3* points, const int* cluster, size_t n, Vec3* sorted) {
  size_t next[kMaxFeatureClusters + 1] = {};  // where the next point of each cluster goes
  for (size_t i = 0; i < n; i++) next[cluster[i] + 1]++;
  for (int c = 0; c < kMaxFeatureClusters; c++) next[c + 1] += next[c];
  for (size_t i = 0; i < n; i++) sorted[next[cluster[i]]++] = points[i];
  FeatureClusters out;
  size_t begin = 0;
  for (int c = 0; c < kMaxFeatureClusters; begin = next[c++]) {
    if (next[c] == begin) continue;
    out.cluster[out.count++] = {begin, next[c]};
  }
  return out;
}

// The features of a box whose half sizes are 1, in clusters.
struct UnitBox {
  static constexpr int kCount = 8 + 12 * kEdgePoints;

  UnitBox() {
    Vec3 added[kCount];
    int cluster[kCount], count = 0;
    const auto add = [&](const Vec3& p, int c) {
      added[count] = p;
      cluster[count++] = c;
    };
    for (int corner = 0; corner < 8; corner++) {
      Vec3 p;
      for (int i = 0; i < 3; i++) p[i] = corner >> i & 1 ? 1 : -1;
      add(p, corner);
    }
    for (int axis = 0; axis < 3; axis++) {
      for (int corner = 0; corner < 8; corner++) {
        if (corner >> axis & 1) continue;
        for (int step = 1; step <= kEdgePoints; step++) {
          Vec3 p = added[corner];
          p[axis] = 2.0 * step / (kEdgePoints + 1) - 1;
          add(p, Octant(p));
        }
      }
    }
    clusters = Sort(added, cluster, count, points);
  }

  Vec3 points[kCount];
  FeatureClusters clusters;
};

const UnitBox kUnitBox;

}  // namespace

MeshFeatures::MeshFeatures(const Hull& hull) {
  const std::vector<Vec3> corners = hull.Corners();
  std::vector<int> octant(corners.size());
  std::transform(corners.begin(), corners.end(), octant.begin(), Octant);
  points.resize(corners.size());
  clusters = Sort(corners.data(), octant.data(), corners.size(), points.data());
}

CollisionMeshes FindCollisionMeshes(const mjModel* m) {
  CollisionMeshes meshes(m->nmesh);
  for (int geom = 0; geom < m->ngeom; geom++) {
    const int mesh = m->geom_dataid[geom];
    const bool used = m->geom_type[geom] == mjGEOM_MESH || m->geom_type[geom] == mjGEOM_SDF;
    if (!used || mesh < 0 || meshes[mesh] || m->mesh_graphadr[mesh] < 0) continue;
    const int* graph = m->mesh_graph + m->mesh_graphadr[mesh];
    Key key;
    key.Add(m->mesh_vert + 3 * m->mesh_vertadr[mesh], 3 * static_cast<size_t>(m->mesh_vertnum[mesh]));
    key.Add(graph, 2 + 3 * static_cast<size_t>(graph[0]) + 6 * static_cast<size_t>(graph[1]));
    meshes[mesh] = Interned<CollisionMesh>(key.text(), [&] { return std::make_unique<const CollisionMesh>(m, mesh); });
  }
  return meshes;
}

void Features::Add(const Vec3& p, int cluster) {
  added_[count_] = p;
  cluster_[count_++] = cluster;
}

void Features::SetBox(const mjtNum* half) {
  const auto scaled = [half](const Vec3& p) { return Vec3{half[0] * p[0], half[1] * p[1], half[2] * p[2]}; };
  std::transform(kUnitBox.points, kUnitBox.points + UnitBox::kCount, sorted_, scaled);
  points = sorted_;
  clusters = kUnitBox.clusters;
}

void Features::AddCylinder(double radius, double half) {
  for (int step = 0; step < kRimPoints; step++) {
    const double angle = 2 * std::numbers::pi * (step + 0.5) / kRimPoints;
    for (const double z : {-half, half}) {
      const Vec3 p = {radius * std::cos(angle), radius * std::sin(angle), z};
      Add(p, Octant(p));
    }
  }
}

void Features::AddCapsule(double radius, double half) {
  const bool few = 2 * half < kCapsulePoints * radius;
  const int count = few ? std::min(2 + static_cast<int>(2 * half / radius), kCapsulePoints) : kCapsulePoints;
  for (int i = 0; i < count; i++) {
    const Vec3 p = {0, 0, half * (2.0 * i / (count - 1) - 1)};
    Add(p, p[2] > 0);
  }
}

double Features::Radius(const mjModel* m, int geom) {
  return m->geom_type[geom] == mjGEOM_CAPSULE ? m->geom_size[3 * geom] : 0;
}

Features::Features(const mjModel* m, const CollisionMeshes& meshes, int geom) {
  const mjtNum* size = m->geom_size + 3 * geom;
  const int mesh = m->geom_plugin[geom] < 0 ? m->geom_dataid[geom] : -1;
  switch (m->geom_type[geom]) {
    case mjGEOM_CAPSULE:
      AddCapsule(size[0], size[1]);
      break;
    case mjGEOM_CYLINDER:
      AddCylinder(size[0], size[1]);
      break;
    case mjGEOM_BOX:
      SetBox(size);
      return;
    case mjGEOM_MESH:
    case mjGEOM_SDF:
      if (mesh < 0 || !meshes[mesh]) break;
      points = meshes[mesh]->features.points.data();
      clusters = meshes[mesh]->features.clusters;
      return;
    default:
      break;
  }
  clusters = Sort(added_, cluster_, count_, sorted_);
  points = sorted_;
}

}  // namespace mjframes
