#include "hull.h"

#include <algorithm>

#include "multiversion.h"
#include "triangle.h"

namespace mjframes {
namespace {

// The largest of the distances n · p − offset.
MJFRAMES_MULTIVERSION
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

std::unique_ptr<const Hull> Hull::Create(const mjModel* m, int mesh) {
  const int address = m->mesh_graphadr[mesh];
  if (address < 0) return nullptr;
  const int* graph = m->mesh_graph + address;
  const int vertices = graph[0], faces = graph[1];
  const int* global = graph + 2 + vertices;
  const int* corners = global + vertices + vertices + 3 * faces;
  const float* xyz = m->mesh_vert + 3 * m->mesh_vertadr[mesh];
  auto hull = std::make_unique<Hull>();
  const auto at = [xyz](int v) { return Vec3{xyz[3 * v], xyz[3 * v + 1], xyz[3 * v + 2]}; };
  std::vector<int> local(m->mesh_vertnum[mesh], -1);
  Vec3 middle{};
  for (int v = 0; v < vertices; v++) {
    local[global[v]] = v;
    hull->vertices_.push_back(at(global[v]));
    middle = middle + (1.0 / vertices) * hull->vertices_.back();
  }
  for (int f = 0; f < faces; f++) {
    std::array<int, 3> face = {local[corners[3 * f]], local[corners[3 * f + 1]], local[corners[3 * f + 2]]};
    const Vec3& a = hull->vertices_[face[0]];
    Vec3 normal = Cross(hull->vertices_[face[1]] - a, hull->vertices_[face[2]] - a);
    const double area = Norm(normal);
    if (!(area > 0)) continue;
    normal = (Dot(normal, a - middle) < 0 ? -1 / area : 1 / area) * normal;
    hull->faces_.push_back(face);
    hull->nx_.push_back(normal[0]);
    hull->ny_.push_back(normal[1]);
    hull->nz_.push_back(normal[2]);
    hull->offset_.push_back(Dot(normal, a));
  }
  return hull;
}

double Hull::Distance(const Vec3& p, double reach, Vec3* normal) const {
  const int n = static_cast<int>(faces_.size());
  const double farthest = Farthest(nx_.data(), ny_.data(), nz_.data(), offset_.data(), n, p);
  const auto plane = [&](int f) { return nx_[f] * p[0] + ny_[f] * p[1] + nz_[f] * p[2] - offset_[f]; };
  if (farthest <= 0 || farthest > reach) {
    int face = 0;
    for (int f = 1; f < n; f++) {
      if (plane(f) > plane(face)) face = f;
    }
    *normal = {nx_[face], ny_[face], nz_[face]};
    return farthest;
  }
  double best = mjMAXVAL;
  for (int f = 0; f < n; f++) {
    const double above = plane(f);
    if (above <= 0 || above >= best) continue;
    const Vec3 offset =
        p - ClosestOnTriangle(p, vertices_[faces_[f][0]], vertices_[faces_[f][1]], vertices_[faces_[f][2]]);
    const double distance = Norm(offset);
    if (!(distance < best)) continue;
    best = distance;
    // just above a face the offset is rounding, the plane is not
    *normal = distance > 1e-9 ? (1 / distance) * offset : Vec3{nx_[f], ny_[f], nz_[f]};
  }
  return best;
}

std::vector<std::unique_ptr<const Hull>> CollisionHulls(const mjModel* m) {
  std::vector<std::unique_ptr<const Hull>> hulls(m->nmesh);
  for (int geom = 0; geom < m->ngeom; geom++) {
    const int mesh = m->geom_dataid[geom];
    const bool used = m->geom_type[geom] == mjGEOM_MESH || m->geom_type[geom] == mjGEOM_SDF;
    if (used && mesh >= 0 && !hulls[mesh]) hulls[mesh] = Hull::Create(m, mesh);
  }
  return hulls;
}

}  // namespace mjframes
