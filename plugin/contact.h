// Contacts of patches: where MuJoCo asks for them (collision hook) and what the solver sees (rows).
//
// A vertex s of the surface moves with p(s) = Σ_j W_j(s) x_j. The vertices of a cluster that are nearly as deep as its
// deepest share one contact, at p = Σ_s a_s p(s) with shares a_s that go to zero continuously: choosing single vertices
// instead makes a resting body flip between choices for ever. A contact row along t reads tᵀ Σ_j ω_j J_j with ω_j = Σ_s
// a_s W_j(s) over the degrees of freedom of the soft body: equation (11). Where vertices do not reach, features of
// geoms and other soft bodies do (touch.h).

#ifndef MJFRAMES_PLUGIN_CONTACT_H_
#define MJFRAMES_PLUGIN_CONTACT_H_

#include <mujoco/mujoco.h>

#include <array>
#include <vector>

#include "dents.h"
#include "kinematics.h"
#include "linear.h"

namespace mjframes {

// Memory for the rows of one model; allocated once.
struct ContactScratch {
  explicit ContactScratch(const mjModel* m);
  std::vector<double> omega;                    // ω of each control point
  std::array<std::vector<Moments>, 2> moments;  // by side: of the movers         (≤ nv)
};

// Puts the plugin's function into the SDF column of mjCOLLISIONFUNC; other pairs keep the function they had.
void InstallCollisionHook();

// Writes the rows of every contact of every soft body. dents, lies: of each contact, filled in (touch.h).
void WriteContactRows(const mjModel* m, mjData* d, ContactScratch* scratch, ContactDents* dents, double* lies);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_CONTACT_H_
