// What each material has of a region's stiffness, and K with other moduli. With factors s_m of the materials' moduli
// and R = [Y, C] the rows of K of the region's own points, the last ones,
//
//   R(s) = s_M R + Σ_{m<M} (s_m − s_M) R_m,   K(s) = R(s)ᵀ C(s)⁻¹ R(s) + s̄ Q,   Q = K − Rᵀ C⁻¹ R
//
// to first order in s but for Q, of which s̄ = tr C(s) / tr C, and positive semi-definite for all s > 0
// (mjframes/elasticity/shares.py). Where all points are the region's own, K(s) = R(s). Index letters: m material; M the
// last; r row of R.

#ifndef MJFRAMES_PLUGIN_SHARES_H_
#define MJFRAMES_PLUGIN_SHARES_H_

#include <cstddef>
#include <vector>

namespace mjframes {

// n is three times the number of control points that are not the region's own, o that of its own.
struct Shares {
  int own = 0;  // o
  std::vector<double>
      rows;  // R_m of each material but the last, up to the diagonal [N/m]  ((M − 1) × o (2n + o + 1)/2)
  std::vector<double> rest;  // Q of the other points, 0 beyond, up to the diagonal [N/m]     (n (n + 1)/2)
};

// How many entries a material has in `rows`; width: n + o.
inline size_t ShareSize(int width, int own) { return static_cast<size_t>(own) * (2 * width - own + 1) / 2; }

// Q of a stiffness (width × width). Allocates.
std::vector<double> RestOf(const std::vector<double>& stiffness, int width, int own);

// K(s) (width × width) into `scaled`. built: K, of `width` rows.  factors: of all M materials.  scratch: room for o ×
// width.
void ScaleStiffness(const std::vector<double>& built, int width, const Shares& shares,
                    const std::vector<double>& factors, double* scratch, double* scaled);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SHARES_H_
