#include "height_field.h"

#include <algorithm>
#include <cmath>

#include "constants.h"
#include "triangle.h"

namespace mjframes {
namespace {

// A height field's grid. Columns run along x, rows along y.
struct Grid {
  const float* data;
  int rows, columns;
  double sx, sy, height, base;  // half sizes, elevation of data 1, depth of the base [m]
  double dx, dy;                // of a square [m]

  Vec3 Corner(int r, int c) const { return {dx * c - sx, dy * r - sy, height * data[r * columns + c]}; }

  int Column(double x) const { return std::clamp(static_cast<int>((x + sx) / dx), 0, columns - 2); }
  int Row(double y) const { return std::clamp(static_cast<int>((y + sy) / dy), 0, rows - 2); }

  // Height of the triangles above or below a point inside the walls.
  double Height(double x, double y) const {
    const int c = Column(x), r = Row(y);
    const double u = (x + sx) / dx - c, v = (y + sy) / dy - r;
    const double near = Corner(r, c)[2], far = Corner(r + 1, c + 1)[2];
    // on either side of the diagonal: slopes along the two edges of the square that the triangle has
    return u > v ? near + u * (Corner(r, c + 1)[2] - near) + v * (far - Corner(r, c + 1)[2])
                 : near + v * (Corner(r + 1, c)[2] - near) + u * (far - Corner(r + 1, c)[2]);
  }
};

Grid GridOf(const mjModel* m, int field) {
  const mjtNum* size = m->hfield_size + 4 * field;
  const int rows = m->hfield_nrow[field], columns = m->hfield_ncol[field];
  return {m->hfield_data + m->hfield_adr[field],
          rows,
          columns,
          size[0],
          size[1],
          size[2],
          size[3],
          2 * size[0] / (columns - 1),
          2 * size[1] / (rows - 1)};
}

double Outside(double x, double low, double high) { return std::max({low - x, x - high, 0.0}); }

// Brings `closest` to the nearest point of the triangles if that is nearer than `best`, and `best` with it. Squares are
// searched in rings around p; a ring that is farther than `best` or `reach` ends the search.
void SearchTriangles(const Grid& grid, const Vec3& p, double reach, double* best, Vec3* closest, Vec3* up) {
  const int column = grid.Column(p[0]), row = grid.Row(p[1]);
  const double step = std::min(grid.dx, grid.dy);
  const int rings = std::max({column, grid.columns - 2 - column, row, grid.rows - 2 - row});
  for (int ring = 0; ring <= rings && (ring - 1) * step < std::min(*best, reach); ring++) {
    for (int r = std::max(row - ring, 0); r <= std::min(row + ring, grid.rows - 2); r++) {
      // the rows at the ends of the ring are full, of the others only the two ends belong to it
      const int stride = r == row - ring || r == row + ring || ring == 0 ? 1 : 2 * ring;
      for (int c = column - ring; c <= column + ring; c += stride) {
        if (c < 0 || c > grid.columns - 2) continue;
        const Vec3 near = grid.Corner(r, c), far = grid.Corner(r + 1, c + 1);
        const Vec3 right = grid.Corner(r, c + 1), back = grid.Corner(r + 1, c);
        const auto [low, high] = std::minmax({near[2], far[2], right[2], back[2]});
        const double gx = Outside(p[0], near[0], far[0]), gy = Outside(p[1], near[1], far[1]);
        const double gz = Outside(p[2], low, high);
        if (gx * gx + gy * gy + gz * gz >= *best * *best) continue;
        for (const Vec3* third : {&right, &back}) {
          const Vec3 q = ClosestOnTriangle(p, near, far, *third);
          const double distance = Norm(p - q);
          if (!(distance < *best)) continue;
          *best = distance;
          *closest = q;
          const Vec3 normal = Cross(far - near, *third - near);
          *up = (1 / std::copysign(Norm(normal), normal[2])) * normal;
        }
      }
    }
  }
}

}  // namespace

double HeightFieldBound(const mjModel* m, int field, const Vec3& p) {
  const mjtNum* size = m->hfield_size + 4 * field;
  return Norm({Outside(p[0], -size[0], size[0]), Outside(p[1], -size[1], size[1]), Outside(p[2], -size[3], size[2])});
}

double HeightFieldDistance(const mjModel* m, int field, const Vec3& p, double reach, Vec3* normal) {
  const Grid grid = GridOf(m, field);
  const double bound = HeightFieldBound(m, field, p);
  if (bound > reach) {
    *normal = {0, 0, 1};
    return bound;
  }
  Vec3 closest = {std::clamp(p[0], -grid.sx, grid.sx), std::clamp(p[1], -grid.sy, grid.sy), 0};
  const double height = grid.Height(closest[0], closest[1]);
  closest[2] = std::clamp(p[2], -grid.base, height);
  double best = Norm(p - closest);
  const bool inside = best == 0;
  Vec3 up = {0, 0, 1};
  if (inside) {
    // the way out: up, or through a wall or the base
    best = height - p[2];
    closest[2] = height;
    const double ways[3] = {grid.sx - std::abs(p[0]), grid.sy - std::abs(p[1]), p[2] + grid.base};
    const Vec3 out[3] = {{std::copysign(1.0, p[0]), 0, 0}, {0, std::copysign(1.0, p[1]), 0}, {0, 0, -1}};
    for (int i = 0; i < 3; i++) {
      if (ways[i] < best) {
        best = ways[i];
        closest = p + ways[i] * out[i];
        up = out[i];
      }
    }
  }
  SearchTriangles(grid, p, inside ? mjMAXVAL : reach, &best, &closest, &up);
  const double sign = inside ? -1 : 1;
  *normal = best > kOnTerrain ? (sign / best) * (p - closest) : up;
  return sign * best;
}

}  // namespace mjframes
