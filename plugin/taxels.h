// Where on its surface a soft body is pressed: the forces of its contacts, spread over taxels.
//
// A contact stands for a cluster of vertices; taxels are finer. The contacts with one object say how much it presses:
// N = Σ N_c along the normals, F in all. Its shape says where. With x̂ the surface without the dent, f solves
//
//   min ½ fᵀ C f + gᵀ f   over f ≥ 0, Σ f = N          C_ts = β² K(|p̄_t − p̄_s|), g_t = distance of x̂_t from the object
//
// K is the response of an elastic layer, as thick as the flesh, that is glued below. x̂ is the affine map of the rest
// places p̄ that fits where they are now, over some thicknesses around the contacts: what the frames show of the dent
// itself is the part of C f that they can make, and would count twice. Where the object turns freely, or the soft body
// on one that stands still, the contacts' normal forces have the moment M that keeps it from turning, and ½ c |Σ f ℓ −
// M|² is added, with a large c and ℓ = (x̂ − pivot) × n: it tilts until the moment is that. The force on a place is
//
//   −f n + (f / N) (F + Σ f n) + τ f m × (x − x̂_f)
//
// along its normal n, the rest as friction, with the twist τ about the mean normal m that the contacts have. So the
// forces of all places sum to F. Places are the taxels, coarser cells around them, and the contact vertices beyond.
// Sources: K. L. Johnson, Contact Mechanics (1985), §3.2 and §5.8. Index letters: t, s place; c contact.

#ifndef MJFRAMES_PLUGIN_TAXELS_H_
#define MJFRAMES_PLUGIN_TAXELS_H_

#include <mujoco/mujoco.h>

#include <cstdint>
#include <vector>

#include "attributes.h"
#include "linear.h"
#include "soft_body.h"
#include "weights.h"

namespace mjframes {

class Taxels {
 public:
  // Reads a sensor's taxels, of a soft body with these attributes. What is wrong is told to `reader`.
  void Read(Reader* soft, Reader* reader);

  // After the constraint solver and SoftBody::Locate.
  void Compute(const mjModel* m, mjData* d, const SoftBody& body);

  // Of each taxel: the force on it in the world [N]; pressure and friction along two axes of the surface [Pa].
  void StoreForces(mjtNum* out) const;
  void StorePressures(mjtNum* out) const;
  void StoreTractions(mjtNum* out) const;
  // Of all: the force [N], and the mean of where it presses, the middle of all while nothing does [m]; in the world.
  void StoreResultant(mjtNum* out) const;
  void StoreCentre(mjtNum* out) const;

 private:
  struct Load;
  struct Fit;

  void Place(const mjData* d, const SoftBody& body);
  void Spread(const mjModel* m, mjData* d, const SoftBody& body, const Load& load);
  bool FitAround(const Vec3& centre, Fit* fit);
  void FindGaps(const mjModel* m, const mjData* d, const SoftBody& body, const Load& load);
  double Response(int t, int s) const;
  int Likely(double load, double softness) const;
  int Bear(mjData* d, const Load& load, double softness);
  void Share(const Load& load, const Fit& fit, int bearing);

  Weights weights_;  // of each taxel and cell
  // of each taxel
  std::vector<Vec3> along_;   // an axis of the surface
  std::vector<double> area_;  // [m²]
  // of each place: taxels, then cells, then vertices
  std::vector<Vec3> rest_;       // p̄ [m]
  std::vector<Vec3> normal_;     // at rest
  std::vector<double> widened_;  // [m²] of a distance's square, as the place is larger than K's
  std::vector<int32_t> vertex_;  // of those behind the cells: number among the body's contact vertices
  std::vector<double> kernel_;   // K at distances 0, step, 2 step … [1/m]
  double step_ = 0;              // [m]
  double softness_ = 0;          // β² [1/Pa]
  double thickness_ = 0;         // [m]
  double mean_area_ = 0;         // [m²]
  int factor_ = 0;               // of the materials' that β² follows
  bool told_memory_ = false;

  // of this step
  std::vector<Vec3> x_;        // where the places are [m]
  std::vector<Vec3> force_;    // on the taxels [N]
  std::vector<Vec3> local_;    // pressure, friction [Pa]
  std::vector<double> press_;  // Σ f of each taxel [N]
  // of this object
  std::vector<int32_t> near_;   // places that face it, nearest first
  std::vector<double> fitted_;  // x̂ of these, by component
  std::vector<double> gap_;     // g of each place
  std::vector<Vec3> lever_;     // (x̂ − pivot) × n of each place, where something turns freely [m]
  std::vector<double> f_;       // of those that may bear
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_TAXELS_H_
