// Where points of a soft body's material are, and how fast they move.
//
//   x(p̄) = Σ_j W_j x_j + (p̄ − Σ_j W_j x̄_j) + R L y      R, y of the point's region (sensor.h), L = Φ T
//
// W_j are the weights that move the surfaces, R L y what the body moves beyond them, and the part in brackets what
// frames that cannot turn leave. Index letters: n point; j control point.

#ifndef MJFRAMES_PLUGIN_PLACES_H_
#define MJFRAMES_PLUGIN_PLACES_H_

#include <mujoco/mujoco.h>

#include <cstdint>
#include <vector>

#include "attributes.h"
#include "linear.h"
#include "soft_body.h"
#include "weights.h"

namespace mjframes {

struct Place {
  int32_t region;
  std::vector<double> lift;  // L, row by row (3 × 3m of its region's control points); none where it is zero
};

class Places {
 public:
  // Reads a sensor's points, of a soft body with these attributes. What is wrong is told to `reader`.
  void Read(Reader* soft, Reader* reader);

  // Of all points, in the world [m], [m/s]; after Locate.
  void StorePositions(SoftBody* body, const mjData* d, mjtNum* out) const;
  void StoreVelocities(SoftBody* body, const mjModel* m, const mjData* d, mjtNum* out);

 private:
  Vec3 LocalPosition(const SoftBody& body, const std::vector<Mat3>& rotation, int n) const;
  double Step(const std::vector<Vec3>& x) const;
  void Differ(SoftBody* body, const std::vector<Vec3>& x, double time, std::vector<Vec3>* lifted);

  Weights weights_;  // W
  std::vector<Place> places_;
  std::vector<Vec3> velocity_;        // of the control points, as seen from the holder   (k)
  std::vector<Vec3> moved_;           // control points, a little later or earlier        (k)
  std::vector<Vec3> after_, before_;  // R L y of each point then                   (n)
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PLACES_H_
