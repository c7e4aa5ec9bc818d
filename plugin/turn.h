// How a region turns: the rotation of least energy (corotational.h), searched for among all.
//
// With z_j = R₀ᵀ x_j for some rotation R₀ and R = R₀ D, D = 1 + Δ, strains are linear in Δ and the energy of a region
// is
//
//   E(D) = ½ Δ·A Δ + b·Δ + Σ_q V_q ψ(F_q + M_q Δ) + ψ(ε + N Δ)
//
// but for a constant, the last ψ that of pressed.h. Newton's method on SO(3), D ← D exp([a]×), from several rotations;
// the least of what it finds.
//
// Index letters: r, s rows of D; a, b its columns; entry 3r + a of Δ.

#ifndef MJFRAMES_PLUGIN_TURN_H_
#define MJFRAMES_PLUGIN_TURN_H_

#include <vector>

#include "laws/laws.h"
#include "linear.h"
#include "pressed.h"
#include "simd.h"

namespace mjframes {

// Four cells of a hyperelastic law side by side; those without volume fill up.
struct TurnCells {
  Lanes F[9];       // F_q for Δ = 0 [-]
  Lanes slope[81];  // M_q [-], row by row
  Lanes volume;     // V_q [m³]
  LawParameters material[kLanes];
};

// What is pressed.
struct TurnPressed {
  double firmness;             // c of pressed.h [J]
  double strain[kStrains];     // ε for Δ = 0 [-]
  double slope[9 * kStrains];  // N [-], row by row
};

// The terms of E; memory for the largest region of a body, allocated once.
struct Turn {
  double curvature[81];          // A [J]
  double slope[9];               // b [J]
  Mat3 S;                        // R₀ᵀ F, F the region's own gradient [-]
  bool solid;                    // whether F tells how the region is turned
  TurnPressed pressed;           //
  Law law;                       // of the cells
  int groups = 0;                // of `cells` that count
  std::vector<TurnCells> cells;  //
};

// Δ of least energy: near D = 1, or anywhere where the region is folded there.
Mat3 LeastTurn(const Turn& turn);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_TURN_H_
