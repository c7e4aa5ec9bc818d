#include "round_touch.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "constants.h"
#include "deformed.h"
#include "linear.h"
#include "quadric.h"
#include "surface_point.h"
#include "vertices.h"

namespace mjframes {
namespace {

// The vertex of the patch that is deepest in the geom.
int DeepestVertex(const mjModel* m, const mjData* d, int geom, const GeomQuery& query, const Placed& soft) {
  if (m->geom_type[geom] == mjGEOM_SPHERE) return soft.NearestVertex(ToVec3(d->geom_xpos + 3 * geom));
  double distance[kMaxPatchVertices];
  const int n = soft.deformed.patch().vertices;
  query.Distances(soft.state->Vertices(soft.number), n, 0, n, distance);
  return static_cast<int>(std::min_element(distance, distance + n) - distance);
}

// The point of the geom that is farthest along a direction.
Vec3 Farthest(const mjModel* m, const mjData* d, int geom, const Vec3& direction) {
  const mjtNum* size = m->geom_size + 3 * geom;
  const Mat3 axes = ToMat3(d->geom_xmat + 9 * geom);
  const bool sphere = m->geom_type[geom] == mjGEOM_SPHERE;
  const Vec3 half = {size[0], size[sphere ? 0 : 1], size[sphere ? 0 : 2]}, along = MulT(axes, direction);
  Vec3 scaled;
  for (int i = 0; i < 3; i++) scaled[i] = half[i] * along[i];
  const double norm = Norm(scaled);
  for (int i = 0; i < 3; i++) scaled[i] *= half[i] / norm;
  return ToVec3(d->geom_xpos + 3 * geom) + Mul(axes, scaled);
}

// Of the geom at p on its surface, where n is its normal: half of what n turns by along the surface [1/m].
double CurvatureOf(const GeomQuery& geom, const Vec3& p, const Vec3& n, double step) {
  const Tangents tangent(n);
  double sum = 0;
  for (const Vec3& along : {tangent.x, tangent.y}) {
    sum += Dot(along, geom.Normal(p + step * along) - geom.Normal(p - step * along)) / (2 * step);
  }
  return 0.5 * sum;
}

// Of the soft surface at the point, where vertices so near are below its tangent plane [1/m].
double CurvatureOf(const Placed& soft, const SurfacePoint& point, double near) {
  const int n = soft.deformed.patch().vertices;
  const double* vertices = soft.state->Vertices(soft.number);
  double moment = 0, total = 0;
  for (int s = 0; s < n; s++) {
    const Vec3 offset = Vertex(vertices, n, s) - point.position;
    if (!(Dot(offset, offset) < near * near)) continue;
    const double up = Dot(offset, point.normal), square = Dot(offset, offset) - up * up;
    moment -= square * up;
    total += square * square;
  }
  return total > 0 ? 2 * moment / total : 0;
}

// How high p is above the surface, looked for from a point of that on; negative inside, none where that is not found.
std::optional<double> HeightOf(const DeformedPatch& body, const Vec3& p, const SurfacePoint& point) {
  Vec3 xi = point.xi;
  DeformedPatch::Cube cube = point.cube;
  Mat3 slope;
  const auto found = body.Find(p, false, mjMAXVAL, &xi, &cube, &slope);
  if (found == DeformedPatch::Search::kOutside) return mjMAXVAL;
  if (found != DeformedPatch::Search::kFound) return std::nullopt;
  return body.contact().field.Distance(cube.nodes, xi - cube.base);
}

// How far the geom is from the point, and which way is out. That is how deep its tip is below the tangent plane,
// `over`, as far as the tip is in the flesh. At an edge the plane goes on where there is no flesh: there the geom's own
// distance is right. normal: of the surface; becomes the contact's.
double Apart(const DeformedPatch& body, const GeomQuery& geom, const SurfacePoint& point, const Vec3& tip, double over,
             Vec3* normal) {
  if (!(over < 0)) return over;
  const double edge = std::clamp(1 - HeightOf(body, tip, point).value_or(over) / over, 0.0, 1.0);
  Vec3 gradient;
  const double f = geom.Distance(point.position, &gradient);
  const Vec3 mean = (1 - edge) * *normal - edge * gradient;
  *normal = (1 / std::max(mjMINVAL, Norm(mean))) * mean;
  return (1 - edge) * over + edge * f;
}

}  // namespace

bool RoundTouch(const mjModel* m, const mjData* d, int geom, const GeomQuery& query, const Placed& soft, double margin,
                Touch* out) {
  const DeformedPatch body = soft.state->Deformed(kAllPatches);
  const DistanceField& field = body.contact().field;
  const PatchVolume& volume = soft.deformed.patch().volume;
  const mjtNum* size = m->geom_size + 3 * geom;
  const double radius = m->geom_type[geom] == mjGEOM_SPHERE ? size[0] : std::min({size[0], size[1], size[2]});
  SurfacePoint point;
  const auto f = [&query](const Vec3& p, Vec3* up) { return query.Distance(p, up); };
  if (!FindOnSurface(body, f, soft.deformed.VertexPoint(DeepestVertex(m, d, geom, query, soft)), &point)) return false;
  if (point.distance > margin + volume.cover * soft.pose.stretch) return false;
  Descend(body, f, soft.pose.slope, std::abs(radius + point.distance), kRoundStride * field.spacing, &point);
  if (!field.IsNearest(point.cube.nodes, point.xi - point.cube.base, soft.number)) return false;
  // where its centre is inside, the geom's nearest point is not its deepest
  const Vec3 normal = point.normal, centre = ToVec3(d->geom_xpos + 3 * geom);
  const bool is_in = Dot(normal, centre - point.position) < 0;
  if (is_in && HeightOf(body, centre, point).value_or(0) > 0) return false;  // on the other side of something thin
  const Vec3 tip = Farthest(m, d, geom, -1 * normal);
  const double over = Dot(normal, tip - point.position);
  Vec3 out_of_flesh = normal;
  const double distance = is_in ? over : Apart(body, query, point, tip, over, &out_of_flesh);
  if (!(distance < margin)) return false;
  const Vec3 place = point.position + 0.5 * distance * out_of_flesh;
  *out = {distance, place, out_of_flesh, -1, 0, 0, 0, 0, point.xi};
  if (soft.deformed.patch().dent.empty() || !(distance < 0)) return true;
  const double curvature = std::max(0.0, CurvatureOf(query, tip, -1 * normal, kRoundStep * radius) +
                                             CurvatureOf(soft, point, kRoundFit * volume.spacing));
  SpreadPressure(curvature, std::min(radius, kWidest * volume.spacing), out);
  return true;
}

void SpreadPressure(double curvature, double widest, Touch* touch) {
  if (!(touch->distance < 0)) return;
  const double square = std::min(widest * widest, -touch->distance / std::max(curvature, mjMINVAL));
  touch->distance += curvature * square / 5;
  touch->variance = static_cast<float>(kRoundPressure * square);
}

}  // namespace mjframes
