// The signed distance of hull.h as C functions.

#include <vector>

#include "hull.h"

extern "C" __attribute__((visibility("default"))) void hull_distances(int vertices, const double* vertex, int faces,
                                                                      const int* face, int n, const double* point,
                                                                      double reach, int all, double* distance,
                                                                      double* normal) {
  std::vector<mjframes::Vec3> positions;
  for (int v = 0; v < vertices; v++) positions.push_back({vertex[3 * v], vertex[3 * v + 1], vertex[3 * v + 2]});
  std::vector<std::array<int, 3>> triangles;
  for (int f = 0; f < faces; f++) triangles.push_back({face[3 * f], face[3 * f + 1], face[3 * f + 2]});
  const mjframes::Hull hull(positions, triangles);
  for (int i = 0; i < n; i++) {
    const mjframes::Vec3 p = {point[3 * i], point[3 * i + 1], point[3 * i + 2]};
    mjframes::Vec3 out;
    distance[i] = all ? hull.DistanceByAll(p, reach, &out) : hull.Distance(p, reach, &out);
    for (int c = 0; c < 3; c++) normal[3 * i + c] = out[c];
  }
}
