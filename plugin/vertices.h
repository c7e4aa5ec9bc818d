// The contact vertices of a patch where they are now, by component: [c n + s].

#ifndef MJFRAMES_PLUGIN_VERTICES_H_
#define MJFRAMES_PLUGIN_VERTICES_H_

#include <algorithm>
#include <vector>

#include "linear.h"
#include "patch.h"
#include "simd.h"

namespace mjframes {

// out = Σ_j W_j(s) x_j, and what frames that do not turn leave of it. x: of the control points in the world, by control
// point; axes: of the soft body there.
void SkinVertices(const Patch& patch, const Vec3* x, const Mat3& axes, double* out);

// Vertex s of n.
inline Vec3 Vertex(const double* vertices, int n, int s) { return {vertices[s], vertices[n + s], vertices[2 * n + s]}; }

// Around n of them.
AlignedBox BoxAround(const double* vertices, int n);

// Boxes, several of which are measured together.
class Boxes {
 public:
  explicit Boxes(size_t count)
      : count_(count), padded_(PadToWide(static_cast<int>(count))), bounds_(6 * padded_), square_(padded_) {}

  void Set(size_t i, const AlignedBox& box) {
    for (int c = 0; c < 3; c++) {
      bounds_[(2 * c) * padded_ + i] = box.centre[c] - box.half[c];
      bounds_[(2 * c + 1) * padded_ + i] = box.centre[c] + box.half[c];
    }
  }

  // The squares of how far p is from each, zero inside.
  const double* SquaresTo(const Vec3& p);

  // Whether p is in one of them or no farther away than `margin`.
  bool AnyWithin(const Vec3& p, double margin) {
    const double* squares = SquaresTo(p);
    return std::any_of(squares, squares + count_, [=](double square) { return square <= margin * margin; });
  }

 private:
  size_t count_, padded_;
  std::vector<double> bounds_;  // least, then largest, of each component
  std::vector<double> square_;
};

// The one of n that is nearest to p, and the square of how far it is, if that is less than `square` is; else −1.
int NearestVertex(const double* vertices, int n, const Vec3& p, double* square);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_VERTICES_H_
