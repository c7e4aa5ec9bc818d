// mjframes.sensor: energies of a soft body, and stress, strain, positions and velocities at points of its material, as
// MuJoCo sensors; mjframes.force_sensor: the contact force on it, and how that is spread over taxels (taxels.h).
//
//   F = Σ_j x_j ∇W_jᵀ + (I − Σ_j x̄_j ∇W_jᵀ) + R L y
//   ε = sym(Σ_j y_j ∇W_jᵀ + L y), y_j = Rᵀ x_j − x̄_j        corotational, R of the point's region
//   ψ = λ/2 (tr ε)² + μ ε : ε, σ = R (λ tr ε I + 2 μ ε) Rᵀ   or, for the other laws, ψ(F), σ = P Fᵀ / J at
//   F = R (I + Σ_j y_j ∇W_jᵀ + L y), without L at the F above
//
// The sensor's object is the body that the soft body hangs on. F maps volume coordinates to the world, σ is in the
// world's axes. Each sensor has an instance of its own. Computed in the velocity stage, from positions and velocities
// alone; contact forces in the acceleration stage, after the constraint solver. Positions: see places.h.
// Index letters: n material point; j control point.

#ifndef MJFRAMES_PLUGIN_SENSOR_H_
#define MJFRAMES_PLUGIN_SENSOR_H_

#include <mujoco/mujoco.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "attributes.h"
#include "linear.h"
#include "places.h"
#include "quadrature.h"
#include "soft_body.h"
#include "taxels.h"

namespace mjframes {

inline constexpr char kSensorName[] = "mjframes.sensor";
inline constexpr char kForceSensorName[] = "mjframes.force_sensor";

// A point of the material.
struct Sample {
  int32_t region;
  std::vector<int32_t> point;  // control points of the region              (m)
  std::vector<Vec3> gradient;  // ∇W_j there, or ḡ_j [1/m]                   (m)
  std::vector<double> lift;    // L, slopes of what the body moves beyond W_j [1/m], or none         (9 × 3m)
  Mat3 slack;                  // I − Σ_j x̄_j ∇W_jᵀ, 0 where all frames can turn
  double lam, mu;              // of the corotational law [Pa]
  int32_t factor;              // which one its material follows
};

class Sensor {
 public:
  // Validates instance `instance` of the model; on failure warns in one sentence and returns null.
  static std::unique_ptr<Sensor> Create(const mjModel* m, int instance);

  // Number of values that the instance's sensor has, 0 where its configuration is not valid.
  static int Size(const mjModel* m, int instance);

  void Compute(const mjModel* m, mjData* d);

 private:
  Sensor() = default;

  void Read(const mjModel* m, Reader* reader);
  void ReadSamples(const mjModel* m, Reader* reader);
  PointState StateOf(const SoftBody& body, const std::vector<Mat3>& rotation, size_t n);
  static void AddHookeState(const Sample& sample, const Mat3& R, const Mat3& slope, PointState* state);
  void AddLawState(size_t n, const Mat3& F, PointState* state);
  void StoreTaxels(const mjModel* m, mjData* d, const SoftBody& body, mjtNum* out);
  void StoreMarkers(SoftBody* body, const mjData* d, mjtNum* out) const;

  int instance_ = -1;                         // of the plugin
  int quantity_ = 0;                          // place in the table of quantities
  int soft_ = -1;                             // the soft body's plugin instance
  int address_ = 0;                           // in sensordata
  std::vector<Sample> samples_;               // none for quantities of the whole body, positions and velocities
  std::vector<QuadratureRegion> quadrature_;  // one a sample, of another law than the corotational one
  std::unique_ptr<QuadratureScratch> scratch_;
  Places places_;                    // of positions, velocities and markers
  std::vector<double> marker_rest_;  // p̄ [m]                            (n × 3)
  Mat3 marker_axes_{};               // to the axes of the map
  std::unique_ptr<Taxels> taxels_;   // of their quantities
};

void RegisterSensor();

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SENSOR_H_
