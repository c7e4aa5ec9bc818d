// St. Venant–Kirchhoff: Hooke's law of Green and Lagrange's strain E = ½ (C − I), with the volume from J.
//
//   ψ = μ |dev E|² + K/2 (J − 1)²,   |dev E|² = (I₁² − 3 I₂) / 6
//
// Hooke's K/2 (tr E)² cannot tell an inverted F from its mirror image; K/2 (J − 1)² can, and agrees with it to first
// order in E. So f = μ/6 I₁², c₂ = −μ/2, d = 0, κ = K; f'(0) = 0.

#ifndef MJFRAMES_PLUGIN_LAWS_GREEN_LAGRANGE_H_
#define MJFRAMES_PLUGIN_LAWS_GREEN_LAGRANGE_H_

#include "law.h"

namespace mjframes::green_lagrange {

// mu, bulk: of small strains [Pa].
inline LawParameters Parameters(double mu, double bulk) { return {mu / 6, 0, -mu / 2, 0, bulk}; }

inline Stretch Respond(const LawParameters& p, double i1) {
  return {p.scale * (i1 * i1 - 9), 2 * p.scale * i1, 2 * p.scale};
}

}  // namespace mjframes::green_lagrange

#endif  // MJFRAMES_PLUGIN_LAWS_GREEN_LAGRANGE_H_
