// Where a sphere or an ellipsoid touches a patch: at the place of the surface that is deepest in it.
//
// A ball may touch on less than what is between two vertices. So the place q where the geom's distance f is least is
// looked for, by steps of Barzilai and Borwein along the surface, down the gradient of f. Beside q the geom is farther
// away by κ r²/2, with κ of the geom and of the vertices around q. At the depth d = −f it touches a circle of radius
// a = √(d/κ). The contact stands for the pressure on this circle. Its distance is the mean over that pressure, and its
// variance the one with which a dent (dents.h) answers with Hertz's force,
//
//   −d + κ a²/5,   F = 4/3 E* d^(3/2) / √κ.
//
// On circles wider than kWidest the vertices tell how much touches: a ends there, and at the geom's own radius.
// Source: J. Barzilai, J. M. Borwein, Two-point step size gradient methods (1988); K. L. Johnson, Contact Mechanics
// (1985), §4.2.

#ifndef MJFRAMES_PLUGIN_ROUND_TOUCH_H_
#define MJFRAMES_PLUGIN_ROUND_TOUCH_H_

#include <mujoco/mujoco.h>

#include "geom_distance.h"
#include "placed.h"
#include "touch.h"

namespace mjframes {

// Whether geoms of this type touch so.
inline bool IsRound(int type) { return type == mjGEOM_SPHERE || type == mjGEOM_ELLIPSOID; }

// Where the geom touches the patch, if it does and is no farther than `margin`; the normal points out of the soft body.
bool RoundTouch(const mjModel* m, const mjData* d, int geom, const GeomQuery& query, const Placed& soft, double margin,
                Touch* out);

// Makes a touch of the deepest place, where the geom is farther beside it by κ r²/2, one of the pressure around it.
// widest: radius of that at most [m].
void SpreadPressure(double curvature, double widest, Touch* touch);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_ROUND_TOUCH_H_
