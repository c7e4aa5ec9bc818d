// Where a region of one frame evaluates a hyperelastic law: its cells. With y = Rᵀ x − x̄ of its control points,
//
//   W = ½ yᵀ K_e y + Σ_q V_q ψ(F_q),   F_q = I + E_q y
//
// K_e is what the law leaves of the stiffness at rest, Σ_q V_q E_qᵀ C E_q + K_e (mjframes/whole_body/cells.py). A step
// needs the slope of W in y, and H with H_q = ∂P/∂F projected (hessian.h), in place of K_e y and K_e:
//
//   K_e y + Σ_q V_q E_qᵀ P_q,   H = K_e + Σ_q V_q E_qᵀ H_q E_q
//
// Index letters: j, k control point of the region; q cell; r, s rows of F; a, b its columns.

#ifndef MJFRAMES_PLUGIN_CELLS_H_
#define MJFRAMES_PLUGIN_CELLS_H_

#include <vector>

#include "laws/laws.h"

namespace mjframes {

// One cell of a region with m points.
struct Cell {
  double volume;              // V_q [m³]
  LawParameters material;     //
  std::vector<double> slope;  // E_q [1/m], row 3r + a for F_ra (9 × 3m)
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_CELLS_H_
