// Mooney–Rivlin in compressible form, polyconvex but for ρ (law.h), which is I₁ except near collapse:
//
//   ψ = c₁₀ (ρ(I₁) − 3) + c₀₁ (I₂ − 3) − d (J − 1) + κ/2 (J − 1)²,
//   d = 2 c₁₀ + 4 c₀₁,   κ = K + (2 c₁₀ − 4 c₀₁)/3,   μ = 2 (c₁₀ + c₀₁)
//
// The usual I₁ J^(−2/3) and I₂ J^(−4/3) grow without bound as J → 0 and mean nothing below. For J = 1 both forms agree.

#ifndef MJFRAMES_PLUGIN_LAWS_MOONEY_RIVLIN_H_
#define MJFRAMES_PLUGIN_LAWS_MOONEY_RIVLIN_H_

#include "law.h"

namespace mjframes::mooney_rivlin {

// c10, c01: [Pa], sum > 0.  bulk: of small strains [Pa], above (4 c01 − 2 c10) / 3.
inline LawParameters Parameters(double c10, double c01, double bulk) {
  return {c10, 0, c01, 2 * c10 + 4 * c01, bulk + (2 * c10 - 4 * c01) / 3};
}

inline Stretch Respond(const LawParameters& p, double i1) {
  const Stretch rho = RegularInvariant(i1);
  return {p.scale * (rho.value - 3), p.scale * rho.slope, p.scale * rho.curvature};
}

}  // namespace mjframes::mooney_rivlin

#endif  // MJFRAMES_PLUGIN_LAWS_MOONEY_RIVLIN_H_
