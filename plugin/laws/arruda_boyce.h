// Arruda–Boyce, eight chains of N segments each, the first five terms of its series (JMPS 41(2), 1993):
//
//   ψ = μ₁ Σ_k a_k N^(1−k) (ρᵏ − 3ᵏ) − μ (J − 1) + κ/2 (J − 1)²,   a = 1/2, 1/20, 11/1050, 19/7000, 519/673750,
//   μ = 2 f'(3) = μ₁ (1 + 3/(5N) + 99/(175N²) + 513/(875N³) + 42039/(67375N⁴)),   κ = K + μ/3 − 4 f''(3)
//
// in compressible form, with ρ(I₁) of law.h: I₁ except near collapse.

#ifndef MJFRAMES_PLUGIN_LAWS_ARRUDA_BOYCE_H_
#define MJFRAMES_PLUGIN_LAWS_ARRUDA_BOYCE_H_

#include "law.h"

namespace mjframes::arruda_boyce {

// f, f', f'' of ρ itself for μ₁ = 1; inverse = 1/N.
inline Stretch Series(double rho, double inverse) {
  const double t = rho * inverse;  // each term is a_k ρ tᵏ⁻¹
  const double c[5] = {1.0 / 2, 1.0 / 20, 11.0 / 1050, 19.0 / 7000, 519.0 / 673750};
  return {rho * (c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4])))),
          c[0] + t * (2 * c[1] + t * (3 * c[2] + t * (4 * c[3] + t * 5 * c[4]))),
          inverse * (2 * c[1] + t * (6 * c[2] + t * (12 * c[3] + t * 20 * c[4])))};
}

// mu, bulk: of small strains [Pa].  segments: N ≥ 2; chains are straight where I₁ = 3 N.
inline LawParameters Parameters(double mu, double segments, double bulk) {
  const Stretch rest = Series(3, 1 / segments);
  const double scale = mu / (2 * rest.slope);
  return {scale, 1 / segments, 0, mu, bulk + mu / 3 - 4 * scale * rest.curvature};
}

inline Stretch Respond(const LawParameters& p, double i1) {
  const Stretch rho = RegularInvariant(i1);
  const Stretch f = Series(rho.value, p.shape), rest = Series(3, p.shape);
  return {p.scale * (f.value - rest.value), p.scale * f.slope * rho.slope,
          p.scale * (f.curvature * rho.slope * rho.slope + f.slope * rho.curvature)};
}

}  // namespace mjframes::arruda_boyce

#endif  // MJFRAMES_PLUGIN_LAWS_ARRUDA_BOYCE_H_
