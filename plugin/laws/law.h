// What the hyperelastic laws have in common. Each is isotropic, a function of the invariants of C = Fᵀ F,
//
//   ψ = f(I₁) + c₂ (I₂ − 3) − d (J − 1) + κ/2 (J − 1)²,   I₁ = tr C,  I₂ = ½ (I₁² − tr C²),  J = det F,
//
// so it needs no strain, no inverse and no logarithm of J: it is finite for every F, inverted ones too. With μ, K the
// shear and bulk modulus of small strains, ∂ψ/∂F = 0 at rest and Hooke's law near it ask for
//
//   2 f'(3) + 4 c₂ = d,   2 f'(3) + 2 c₂ = μ,   4 f''(3) − 2 f'(3) + κ = K − 2/3 μ.
//
// Nothing brings back a collapsed point at F = 0 if f'(0) = 0: there, ψ of F = s I falls with s all the way to s = 1.

#ifndef MJFRAMES_PLUGIN_LAWS_LAW_H_
#define MJFRAMES_PLUGIN_LAWS_LAW_H_

#include "../constants.h"

namespace mjframes {

// Of one material. scale and shape are what f needs, see the law.
struct LawParameters {
  double scale;   // [Pa]
  double shape;   // see the law
  double second;  // c₂ [Pa]
  double linear;  // d [Pa]
  double volume;  // κ [Pa]
};

// Of a material with `factor` times its moduli.
inline LawParameters Scaled(const LawParameters& p, double factor) {
  return {factor * p.scale, p.shape, factor * p.second, factor * p.linear, factor * p.volume};
}

// f, f', f'' at some I₁ [Pa]
struct Stretch {
  double value, slope, curvature;
};

// I₁ for those laws whose own f'(0) is not 0: ρ = I₁ from I₁ = kCollapsing on, which J ≥ 0.36 is enough for, and below
// that a cubic with ρ'(0) = 0 and continuous ρ''.
inline Stretch RegularInvariant(double i1) {
  const double x = i1 / kCollapsing;
  if (x >= 1) return {i1, 1, 0};
  return {kCollapsing * (x * x * (1 - x / 3) + 1.0 / 3), x * (2 - x), 2 * (1 - x) / kCollapsing};
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_LAWS_LAW_H_
