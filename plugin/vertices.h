// The contact vertices of a patch where they are now, by component: [c n + s].

#ifndef MJFRAMES_PLUGIN_VERTICES_H_
#define MJFRAMES_PLUGIN_VERTICES_H_

#include "linear.h"
#include "patch.h"

namespace mjframes {

// out = Σ_j W_j(s) x_j, and what frames that do not turn leave of it. x: of the control points in the world, by control
// point; axes: of the soft body there.
void SkinVertices(const Patch& patch, const Vec3* x, const Mat3& axes, double* out);

// Around n of them.
AlignedBox BoxAround(const double* vertices, int n);

// The one of n that is nearest to p, and the square of how far it is, if that is less than `square` is; else −1.
int NearestVertex(const double* vertices, int n, const Vec3& p, double* square);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_VERTICES_H_
