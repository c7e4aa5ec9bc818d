// Hyperelastic laws on quadrature points: a region's energy is Σ_q V_q ψ(F_q), F_q = Σ_j x_j ∇W_j(q)ᵀ, so that
//
//   f_j = −Σ_q V_q P ∇W_j,   K_jk = Σ_q V_q ∇W_jᵀ (∂P/∂F) ∇W_k
//
// with ∂P/∂F projected (hessian.h), hence K positive semi-definite (the paper, equations (9) and (10); design: f, K of
// §6). The stiffness of a step is Pᵀ K P, P = I − Z (Zᵀ Z)⁻¹ Zᵀ, (Z a)_j = a × z_j about the points' mean: blind to
// rotations of the current shape, which K itself resists where there is stress. A step that saw that would take angular
// momentum away. P is that of all points of a region, of which others may have the same: how regions turn against each
// other is left in. A region that is stretched beyond kCalm, or inverted, keeps K: there long steps that nothing held
// back threw bodies apart. Index letters: j, k control point; q quadrature point; r, s rows of F; a, b its columns.

#ifndef MJFRAMES_PLUGIN_QUADRATURE_H_
#define MJFRAMES_PLUGIN_QUADRATURE_H_

#include <cstdint>
#include <vector>

#include "laws/laws.h"
#include "linear.h"

namespace mjframes {

// One region: m control points, q quadrature points. Points are padded to multiples of four, which add nothing.
struct QuadratureRegion {
  // gradient: ∇W_j (q × m × 3) [1/m].  volume: (q) [m³].  material: (q).  pair: as in Region (corotational.h).  factor:
  // (q), which one each material's moduli follow.
  QuadratureRegion(Law law, std::vector<int32_t> point, const double* gradient, const double* volume,
                   const LawParameters* material, int q, std::vector<int32_t> pair, std::vector<int32_t> factor);

  Law law;
  int quadrature_points;                // q
  std::vector<int32_t> point;           // control points, ancestors first                        (m)
  std::vector<double> by_point;         // ∇W_j, four quadrature points side by side             (q/4 × m × 3 × 4)
  std::vector<double> by_quadrature;    // ∇W_j again, all control points side by side           (q × 3 × m)
  std::vector<double> volume;           // V_q [m³]                                              (q)
  std::vector<LawParameters> material;  //                                                       (q)
  std::vector<int32_t> pair;            // global pair of each block (j, k ≤ j), −1 for none     (m(m+1)/2)
  std::vector<int32_t> factor;          // which one the material's moduli follow                (q)

  int size() const { return static_cast<int>(point.size()); }
};

// What is computed of all points of all regions, in a row that is filled up to whole registers of eight, and memory
// for the largest region; allocated once.
struct QuadratureScratch {
  explicit QuadratureScratch(const std::vector<QuadratureRegion>& regions);

  // Takes the regions' materials with these factors of their moduli.
  void Scale(const std::vector<QuadratureRegion>& regions, const std::vector<double>& factors);

  std::vector<int> first;               // of each region's points
  std::vector<double> volume;           // V_q [m³]                                         (n)
  std::vector<LawParameters> material;  // with the factors of today                        (n)
  std::vector<double> gradient;         // F                                                (n/8 × 9 × 8)
  std::vector<double> stress;           // V_q P                                            (n/8 × 9 × 8)
  std::vector<double> hessian;          // V_q ∂P/∂F                                        (n/8 × 81 × 8)
  std::vector<Vec3> x;                  // positions, centred                               (m)
  std::vector<Mat3> block;              // K of calm regions with the same points, k ≤ j    (m(m+1)/2)
  std::vector<Mat3> plain;              // K of a region that is not calm                   (m(m+1)/2)
  std::vector<Mat3> turned;             // K Z, and C of ProjectBlocks                      (m)
  std::vector<double> force;            // by component                                     (3 × m)
  std::vector<double> products;         // V_q (∂P/∂F) ∇W_k                                 (q × 27 × m)
};

// At one quadrature point.
struct PointState {
  Mat3 F;         // deformation gradient [-]
  Mat3 cauchy;    // P Fᵀ / J [Pa]; |J| counts as 1e-6 where it is less
  double energy;  // density [J/m³]
};

// Adds the elastic force of all regions to `force` and, where `stiffness` is given, their stiffness, one row-major 3×3
// block a pair of control points (deeper, shallower), to it. Regions with the same points should follow each other. x:
// all control points of the body [m]. scratch: of these regions.
void AddQuadrature(const std::vector<QuadratureRegion>& regions, const Vec3* x, QuadratureScratch* scratch, Vec3* force,
                   double* stiffness);

// force = P force, of all points of a body at x: takes their torque about the points' mean.
void TakeTorque(const Vec3* x, std::vector<Vec3>* force);

// Σ_q V_q ψ of region `e` [J], 0 at rest.
double QuadratureEnergy(const std::vector<QuadratureRegion>& regions, size_t e, const Vec3* x,
                        QuadratureScratch* scratch);

// The state of each quadrature point (q).
void QuadratureStates(const QuadratureRegion& region, const Vec3* x, QuadratureScratch* scratch, PointState* states);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_QUADRATURE_H_
