// Elasticity of a soft body: force f = −∂W/∂x on its control points and stiffness K, of all regions (the paper,
// equations (9) and (10)).

#ifndef MJFRAMES_PLUGIN_ELASTICITY_H_
#define MJFRAMES_PLUGIN_ELASTICITY_H_

#include <vector>

#include "corotational.h"
#include "kinematics.h"
#include "linear.h"
#include "quadrature.h"

namespace mjframes {

// What never changes.
struct ElasticModel {
  std::vector<Region> regions;               // of the law `corotational`, or with cells
  std::vector<RegionBatch> batches;          // the same, side by side
  std::vector<QuadratureRegion> quadrature;  // of another law at quadrature points
  double enlargement = 1;                    // of their stiffness where d->M has no room for all of it [-]
  bool enlarges = false;                     // whether d->M gets another stiffness than K
  int factors = 1;                           // as many materials whose moduli can be scaled
};

class Elasticity {
 public:
  Elasticity(const ElasticModel& model, const std::vector<PointPair>& pairs);

  // From now on f, K and W are those of moduli that are so many times the model's, a factor a material. A common one is
  // free; others cost something when they change.
  void Scale(const std::vector<double>& factors);

  // Computes f and, if asked for, K. x: the control points [m].
  void Evaluate(const Vec3* x, bool stiffness, std::vector<Vec3>* force);

  // force −= K u. Neighbours among the pairs have the same first point.
  void SubtractProduct(const Vec3* u, Vec3* force) const;

  // K as d->M gets it: 3×3 row-major block a pair.
  const double* StiffnessForInertia() const { return model_.enlarges ? enlarged_.data() : stiffness_.data(); }

  // The force of the places `ahead`, turned back to x: of a region −R Pᵀ ŵ (step_correction.h), of laws at quadrature
  // points Pᵀ f̂.
  void EvaluateAhead(const Vec3* x, const Vec3* ahead, std::vector<Vec3>* force);

  // W [J]
  double Energy(const Vec3* x);

  // The region of this number, which has to be there; not of a law at quadrature points.
  const Region& FindRegion(int number) const;

  // R of each of these regions, by their numbers.
  const std::vector<Mat3>& Rotations(const Vec3* x);

 private:
  // K_e of a region with the factors of today (3m × 3m).
  const double* ScaledStiffness(const Region& region);
  void AddRegions(const Vec3* x, const Wanted& wanted);

  const ElasticModel& model_;
  const std::vector<PointPair>& pairs_;
  BatchScratch batch_scratch_;
  QuadratureScratch quadrature_scratch_;
  double factor_ = 1;           // common to all materials [-]
  bool apart_ = false;          // whether they have different ones
  std::vector<double> scaled_;  // factors of the materials that the batches and the scratch memory have [-]
  std::vector<RegionBatch::Moduli> moduli_;  // of the model's batches, with these; none where there is one material
  std::vector<double> matrix_;               // K_e of a region with these [N/m], for the largest
  std::vector<double> rows_;                 // scratch memory for it
  std::vector<Mat3> rotation_;               // R of each region
  std::vector<double> stiffness_;            // K, 3×3 row-major block a pair
  std::vector<double> enlarged_;             // empty where d->M has room for K
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_ELASTICITY_H_
