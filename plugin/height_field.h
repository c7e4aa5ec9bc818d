// Signed distance to a height field: the solid between its triangles and its base, as MuJoCo collides it.
//
// Each square of the grid is cut along the diagonal from its corner (row r, column c) to (r + 1, c + 1). The solid ends
// at four side walls and at the base, size[3] below zero.

#ifndef MJFRAMES_PLUGIN_HEIGHT_FIELD_H_
#define MJFRAMES_PLUGIN_HEIGHT_FIELD_H_

#include <mujoco/mujoco.h>

#include "linear.h"

namespace mjframes {

// Distance [m] from p, in the height field's axes, negative inside; `normal` out of the solid there. Above
// `reach` only that is sure of the distance, that it is above.
double HeightFieldDistance(const mjModel* m, int field, const Vec3& p, double reach, Vec3* normal);

// At most the distance of a point outside: that of the box around the solid.
double HeightFieldBound(const mjModel* m, int field, const Vec3& p);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_HEIGHT_FIELD_H_
