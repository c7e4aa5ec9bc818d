// A place of the deformed surface, and the way over it to where a distance f from something else is least.

#ifndef MJFRAMES_PLUGIN_SURFACE_POINT_H_
#define MJFRAMES_PLUGIN_SURFACE_POINT_H_

#include <algorithm>

#include "constants.h"
#include "deformed.h"
#include "linear.h"

namespace mjframes {

struct SurfacePoint {
  Vec3 xi, position, normal;
  DeformedPatch::Cube cube;
  double distance;  // f [m]
  Vec3 slope;       // its gradient along the surface [-]
};

// Next to the material point ξ; false midway between two sides. f: (position, its gradient) → distance.
template <typename Field>
bool FindOnSurface(const DeformedPatch& body, const Field& f, const Vec3& xi, SurfacePoint* point) {
  double doubt;
  point->xi = xi;
  if (!body.Surface(&point->xi, &point->cube, &point->position, &point->normal, &doubt)) return false;
  Vec3 up;
  point->distance = f(point->position, &up);
  point->slope = up - Dot(up, point->normal) * point->normal;
  return true;
}

// Goes to where f is least. cubes: ∂ξ/∂x near there. step: the first, over the slope [m]; longest: of all [m].
template <typename Field>
void Descend(const DeformedPatch& body, const Field& f, const Mat3& cubes, double step, double longest,
             SurfacePoint* point) {
  for (int i = 0; i < kRoundSteps; i++) {
    const double steep = Norm(point->slope);
    if (!(step * steep > kRoundSure * longest)) return;
    step = std::min(step, longest / steep);
    SurfacePoint next;
    const Vec3 xi = point->xi - Mul(cubes, step * point->slope);
    if (!FindOnSurface(body, f, xi, &next) || next.distance > point->distance) {
      step *= 0.25;
      continue;
    }
    const Vec3 moved = next.position - point->position;
    const double bend = Dot(moved, next.slope - point->slope);
    step = bend > 0 ? Dot(moved, moved) / bend : 2 * step;
    *point = next;
  }
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SURFACE_POINT_H_
