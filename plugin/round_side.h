// Where a round side of a soft body touches: at the place of a smooth surface through its vertices that is deepest.
//
// Clusters of vertices would make a ball a polyhedron of some twenty faces, and the face ahead brakes it as it comes
// down. So the geom's distance f at the vertices around is fitted by a quadric over the geom's tangent plane,
//
//   f(u) ≈ h + g·u + ½ uᵀ H u,   with weights (1 − r²/ρ²)²
//
// and the place moves by −H⁻¹ g until it stays. ρ is the same all over the body, so patches find the same place from
// the same vertices; the contact is that of the patch with the nearest round one, or of two patches midway. Two places
// nearer than ρ fade into one.
//
// Clusters touch instead where what is pressed, a circle of radius a = √(d/κ), is wider than some vertices, and where
// the surface around is not round, or no quadric fits it, as on parts thinner than ρ: the depth of the one contact has
// the share 1 − w², that of theirs w (2 − w). The pressure is that of round geoms (round_touch.h) with κ = ½ tr H.
//
// The surface may roll over the place. Its distance stays, but its material moves on a cycloid, away from the geom with
// ω² R on a ball. MuJoCo's rows take the acceleration of the material, J q̈, for that of the distance. So what they aim
// at is Ṅᵀ H⁻¹ Ṅ more, where Ṅ is how fast the material's normal turns against the geom. Along an axis where the place
// leaves ρ within a step, at a speed |H⁻¹ Ṅ| above ρ/h, it is less by the square of that: a side as good as even, with
// radii larger than the body, does not roll.
// Source: D. J. Montana, The kinematics of contact and grasp (1988), for how fast a place moves over what rolls.

#ifndef MJFRAMES_PLUGIN_ROUND_SIDE_H_
#define MJFRAMES_PLUGIN_ROUND_SIDE_H_

#include <mujoco/mujoco.h>

#include "geom_distance.h"
#include "kinematics.h"
#include "patch.h"
#include "placed.h"
#include "touch.h"

namespace mjframes {

struct RoundPlace {
  Vec3 place;        // on the surface [m]
  bool own = false;  // whether the contact is this patch's
  double wide = 1;   // w: from 0, where this one contact is enough, to 1, where clusters are to touch instead [-]
};

// ρ, how far around a place the quadric is fitted [m].
double RoundReach(const ContactModel& contact);

// Where the side touches the geom, with the normal out of that; it is looked for from a place on, which xi is at.
RoundPlace RoundSide(const GeomQuery& query, const Placed& soft, const Vec3& start, const Vec3& xi, Touch* out);

// Ṅᵀ H⁻¹ Ṅ at such a touch [m/s²]; 0 at others. body: which has the geom.
double RollingLift(const Kinematics& kinematics, const ContactModel& contact, int patch, const mjData* d,
                   double timestep, const Touch& touch, int body);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_ROUND_SIDE_H_
