// How far flesh gives way below its contacts, beyond what its frames show: a local compliance of the contact rows.
//
// Forces f_j along the normals n_j of a soft body's contacts make dents u_i = Σ_j c_ij f_j below them. This is the
// half-space's response to a pressure spread as a Gaussian of variance t around each contact, less what of it is smooth
// over the width ℓ, which the frames have already. With r = |x_i − x_j| and s = t_i + t_j
//
//   c_ij = β_i β_j (n_i · n_j) [G(s) − 2 G(s + ℓ²) + G(s + 2 ℓ²)],   G(q) = erf(r / √(2q)) / r,   β² = (1 − ν²) / (πE)
//
// Pressed flesh gets firmer: of β² is left what is left of the compliance of an incompressible neo-Hookean block that
// is squeezed to λ of its thickness t,
//
//   E ε / σ = 3 λ² / (1 + λ + λ²),   λ = 1 − ε = 1 − (δ + δ')/t
//
// where δ' is how deep something presses on the other side: fingers that pinch a sheet do not meet in it. Where
// contacts press the share φ of its section, the frames show more of it: of β² is left 1 − φ².
//
// The kernel's Fourier transform is positive, so C is positive semidefinite whatever the body's shape is. The
// spring of a contact itself (firmness.h), of stiffness k imp / R, is in series with the dents. The forces that keep
// the gaps δ open are those of
//
//   0 ≤ f ⟂ (C + diag(R / (k imp))) f − δ ≥ 0
//
// A row gets the spring that answers its penetration with f_i. The energy of the dents,
// max_f≥0 f·δ − ½ fᵀCf, is convex with curvature (C + diag(R / (k imp)))⁻¹ ≤ k imp / R: a row that is as firm as
// the contact's own never underestimates how the force grows, so a step does not overshoot.
// Contacts that share no soft body, directly or through others, do not meet in C: each such group is solved alone.
// Source: Boussinesq's half-space, see K. L. Johnson, Contact Mechanics (1985), §3.2 and §3.4.

#ifndef MJFRAMES_PLUGIN_DENTS_H_
#define MJFRAMES_PLUGIN_DENTS_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "linear.h"

namespace mjframes {

// Of flesh below a place of the surface.
struct Dent {
  double width = 0;      // ℓ [m]
  double softness = 0;   // β [1/√Pa]; 0 where nothing gives way
  double thickness = 0;  // of the body [m]; what is squeezed by as much gives way no more
  double section = 0;    // of the body across that [m²]; what is pressed on all of it makes no dent; 0 if not known
};

// Of a contact.
struct ContactDents {
  Vec3 centre;      // of its pressure [m]
  double variance;  // of that along the surface [m²]
  Dent side[2];     // of each geom
  int before[2];    // of each geom: which side of a contact, 2c + s, its soft body had before this one; −1 for none
  double flesh;     // how far a half-space of both sides' flesh gives way below its pressure [m/N]
  double lift;      // how what rolls over it accelerates away (round_side.h) [m/s²]
};

// Makes the flesh of all contacts firmer where these press it deep or on most of its section, and fills in `before` and
// `flesh`. last: memory (nplugin).
void Squeeze(const mjModel* m, const mjData* d, ContactDents* dents, std::vector<int>* last);

// Sets the springs of the rows of all contacts with soft bodies; R of the rows is complete. dents: of each contact.
// False, and nothing is set, where mjData's memory is too small.
bool SetDents(const mjModel* m, mjData* d, const ContactDents* dents);

// How far a force of 1 N on the flesh, spread as a contact's pressure is around its centre, moves the surface at this
// distance from there, beyond what the frames show [m/N].
double DentOfForce(const ContactDents& dents, const Dent& flesh, double distance);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_DENTS_H_
