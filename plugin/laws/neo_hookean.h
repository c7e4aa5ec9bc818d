// Stable neo-Hookean (Smith, de Goes, Kim, ACM TOG 37(2), 2018), μ and K those of small strains:
//
//   ψ = 2/3 μ (I₁ − 3 − ln((I₁ + 1) / 4)) − μ (J − 1) + κ/2 (J − 1)²,   κ = K + μ/6
//
// Their μ is 4/3 of Hooke's and their λ is κ; λ/2 (J − α)² is multiplied out. f'(0) = 0.

#ifndef MJFRAMES_PLUGIN_LAWS_NEO_HOOKEAN_H_
#define MJFRAMES_PLUGIN_LAWS_NEO_HOOKEAN_H_

#include <cmath>

#include "law.h"

namespace mjframes::neo_hookean {

// mu, bulk: of small strains [Pa].
inline LawParameters Parameters(double mu, double bulk) { return {2 * mu / 3, 0, 0, mu, bulk + mu / 6}; }

inline Stretch Respond(const LawParameters& p, double i1) {
  const double inverse = 1 / (i1 + 1);
  return {p.scale * (i1 - 3 - std::log((i1 + 1) / 4)), p.scale * (1 - inverse), p.scale * inverse * inverse};
}

}  // namespace mjframes::neo_hookean

#endif  // MJFRAMES_PLUGIN_LAWS_NEO_HOOKEAN_H_
