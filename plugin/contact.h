// Contacts of patches: where MuJoCo asks for them (collision hook) and what the solver sees (rows).
//
// A vertex s of the surface moves with p(s) = Σ_j W_j(s) x_j. The vertices of a cluster that are nearly as deep as its
// deepest share one contact, at p = Σ_s a_s p(s) with shares a_s that go to zero continuously: choosing single vertices
// instead makes a resting body flip between choices for ever. A contact row along t reads tᵀ Σ_j ω_j J_j with ω_j = Σ_s
// a_s W_j(s) over the degrees of freedom of the soft body: equation (11). Where vertices do not reach, features of
// geoms and other soft bodies do (touch.h).
//
// Control points that slide do not turn, but the material between them does. Its motion at a contact is the affine one
// that fits theirs best, with slopes ∇N_j (affine_fit.h).
// A row of torsional or rolling friction about a reads half of its curl, Σ_j ½ (a × ∇N_j) J_j. Beside a rigid body,
// friction acts half way between the surfaces, at r from the point: its rows have ω_j + r · ∇N_j, or it would make a
// torque. As Σ_j x_j ∇N_jᵀ = 1, both keep the angular momentum.

#ifndef MJFRAMES_PLUGIN_CONTACT_H_
#define MJFRAMES_PLUGIN_CONTACT_H_

#include <mujoco/mujoco.h>

#include <array>
#include <vector>

#include "dents.h"
#include "kinematics.h"
#include "linear.h"
#include "touch.h"

namespace mjframes {

// Memory for the rows of one model; allocated once.
struct ContactScratch {
  explicit ContactScratch(const mjModel* m);
  std::vector<double> omega;                    // ω of each control point
  std::array<std::vector<Moments>, 2> moments;  // by side: of the movers         (≤ nv)
  std::array<std::vector<double>, 2> shifts;    // Σ r · ∇N at and below them     (≤ nv)
  std::array<std::vector<Vec3>, 2> slopes;      // Σ ∇N there                     (≤ nv) [1/m]
  std::vector<int> last;                        // contact of each plugin instance
};

// Which of its touches each contact of an mjData is, from the first contact on.
class TouchSearch {
 public:
  TouchSearch(const mjModel* m, const mjData* d) : m_(m), d_(d) {}

  // Goes on to contact c, which comes after the last one. False where there are no rows to write: where none of the two
  // geoms is a soft body's patch, or both are of one body.
  bool Find(int c);

  const SoftSide* side() const { return side_; }
  const TouchScratch& scratch() const { return scratch_; }
  // Null for a contact that is not one of FindTouches.
  const Touch* touch() const { return touch_; }

 private:
  const mjModel* m_;
  const mjData* d_;
  TouchScratch scratch_;
  Touch found_[kMaxTouches];
  const Touch* touch_ = nullptr;
  SoftSide side_[2];
  int pair_[2] = {-1, -1}, count_ = 0, next_ = 0;  // the pair of geoms whose touches are found
  bool recalled_ = false;                          // from the collision stage
};

// Puts the plugin's function into the SDF column of mjCOLLISIONFUNC; other pairs keep the function they had.
void InstallCollisionHook();

// Writes the rows of every contact of every soft body. dents, lies: of each contact, filled in (touch.h).
void WriteContactRows(const mjModel* m, mjData* d, ContactScratch* scratch, ContactDents* dents, double* lies);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_CONTACT_H_
