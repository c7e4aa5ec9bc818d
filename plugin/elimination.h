// Symmetric elimination, from the last unknown up: M = Lᵀ D L.
//
// Unknowns in a row are eliminated together:
//
//   U = their rows once those below are eliminated,   D their pivots,   M_ab −= Σ_k U_ka U_kb / D_k   above them,
//
// one product of rank p instead of p of rank one, so that an entry is loaded and stored once a chain. L_ka = U_ka /
// D_k. Index letters: k unknown of a chain; a, b those above it.

#ifndef MJFRAMES_PLUGIN_ELIMINATION_H_
#define MJFRAMES_PLUGIN_ELIMINATION_H_

#include "constants.h"
#include "simd.h"

namespace mjframes {

// How many numbers a row of n entries takes: eliminations write beyond its end.
constexpr int PadToTile(int n) { return PadToWide(n + kTile - 1); }

// Eliminates a chain of `size`. U: its rows, `above` entries each before the chain's own; row: those above it. scaled:
// memory (size × (above + size)). inverse becomes 1 / D of the chain.
void Eliminate(double* const* U, int size, double* const* row, int above, double* scaled, double* inverse);

// A symmetric matrix of n unknowns, positive definite: its rows from their first entry to the diagonal, all between
// them. What is left of that is zero, most of a matrix of things that hang together like a chain, and nobody reads it;
// where elimination fills it in, rows begin earlier.
struct Envelope {
  // How many numbers it takes, and its memory.
  static constexpr size_t Entries(int n) { return static_cast<size_t>(n) * PadToTile(n); }
  static constexpr size_t Memory(int n) { return static_cast<size_t>(kMaxChain + 1) * n; }

  int n;           // kMostRows at most
  double* matrix;  // Entries(n); its factors after Solve
  double* memory;  // Memory(n)
  int* begin;      // of each row (n), multiples of kWideLanes

  double* Row(int k) const { return matrix + static_cast<size_t>(k) * PadToTile(n); }

  // x = matrix⁻¹ x; false where the matrix is not positive definite.
  bool Solve(double* x) const;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_ELIMINATION_H_
