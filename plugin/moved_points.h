// Points of a soft body's material, many at once: where control points move them, and what forces on them do there.
//
//   p_n = Σ_j W_nj x_j + A o_n,   G_j = Σ_n W_nj g_n          o: what frames that do not turn leave, in the axes A
//
// Index letters: n point; j control point, i its place among those that move any of the points.

#ifndef MJFRAMES_PLUGIN_MOVED_POINTS_H_
#define MJFRAMES_PLUGIN_MOVED_POINTS_H_

#include <mujoco/mujoco.h>

#include <cstdint>
#include <vector>

#include "attributes.h"
#include "linear.h"

namespace mjframes {

// What never changes of n points.
struct PointWeights {
  // Reads those of an instance, of a soft body with `count` control points; also: more of these to be among `point`.
  // What is wrong is told to `reader`.
  void Read(int count, const std::vector<int32_t>& also, Reader* reader);

  int size = 0;                // n
  int padded = 0;              // to whole blocks of kBlock
  std::vector<int32_t> point;  // the control points that move any of them, ascending
  std::vector<double> weight;  // W: block by block of points, i by i, point by point
  std::vector<Vec3> offset;    // o [m], none where all are zero
};

// The points of one mjData. x, y and z of the points are one after the other, `padded` each.
class MovedPoints {
 public:
  explicit MovedPoints(const PointWeights& weights);  // which are to outlive it

  // Where the points are with the control points (of weights.point) at x, in a coordinate system with axes A.
  void Place(const std::vector<Vec3>& x, const Mat3& A);

  Vec3 Position(int n) const { return At(position_, n); }
  const double* position() const { return position_.data(); }

  // The gradient g of what is measured, to be filled in.
  double* gradient() { return gradient_.data(); }
  void AddGradient(int n, const Vec3& g) {
    for (int r = 0; r < 3; r++) gradient_[r * weights_.padded + n] += g[r];
  }

  // G of the control points, and the torque Σ A o_n × g_n of the offsets.
  Vec3 Gather(const Mat3& A, std::vector<Vec3>* G) const;

 private:
  Vec3 At(const std::vector<double>& values, int n) const {
    return {values[n], values[weights_.padded + n], values[2 * weights_.padded + n]};
  }

  const PointWeights& weights_;
  std::vector<double> position_, gradient_;  // (3 × padded)
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_MOVED_POINTS_H_
