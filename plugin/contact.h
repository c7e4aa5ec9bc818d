// Contacts of patches: where MuJoCo asks for them (collision hook) and what the solver sees (rows).
//
// A vertex s is a sphere of the contact radius that moves with p(s) = Σ_j W_j(s) x_j. A contact row along direction t
// therefore reads tᵀ Σ_j W_j(s) J_j over the degrees of freedom of the soft body: equation (11).

#ifndef MJFRAMES_PLUGIN_CONTACT_H_
#define MJFRAMES_PLUGIN_CONTACT_H_

#include <mujoco/mujoco.h>

#include <cstdint>
#include <vector>

namespace mjframes {

// The contact vertices that hang on one body; never written after creation, so threads may share it.
struct Patch {
  int geom;
  int owner;                   // control point of the geom's body: the deepest that moves a vertex
  int vertices;                // number of vertices n, in order of farthest-point rank
  std::vector<int32_t> point;  // control points, ancestors first              (p)
  std::vector<double> weight;  // W_j(s), one row of n a point                 (p × n)
  std::vector<double> rest;    // rest positions by component [m]              (3 × n)
};

// The collision hook has only the thread's stack to work on.
inline constexpr int kMaxPatchVertices = 1024;

// Memory for the rows of one model; allocated once.
struct ContactScratch {
  explicit ContactScratch(int nv)
      : row(nv), half(nv), sqrt_inverse(nv), share(nv), skinned(3 * kMaxPatchVertices) {}
  std::vector<double> row, half;      // J and D^(−½) L^(−ᵀ) Jᵀ               (nv)
  std::vector<double> sqrt_inverse;   // D^(−½)                               (nv)
  std::vector<double> share;          // weight at and below each depth       (≤ nv)
  std::vector<double> skinned;        // vertices of the current patch        (3 × n)
};

// Puts the plugin's function into the SDF column of mjCOLLISIONFUNC; other pairs keep the function they had.
void InstallCollisionHook();

// Writes the rows of every contact of every soft body and scales their impedance to the effective inertia, which
// has to be complete and factored.
void WriteContactRows(const mjModel* m, mjData* d, ContactScratch* scratch);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_CONTACT_H_
