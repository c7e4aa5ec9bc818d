// R of constraint rows, for the effective inertia A in d->M.
//
// R is (1 − imp)/imp times the inverse inertia that a row sees. MuJoCo took that of bodies without elasticity before
// the plugin added to d->M; here it is J A⁻¹ Jᵀ. Without that soft bodies hang and stand as deep as their single points
// of mass would. A contact that lies flat sees 1/m of both sides instead, as MuJoCo's rigid bodies do: so it is as soft
// at every place and time step, and a body stands level.
//
// J A⁻¹ Jᵀ of a single point grows as the step gets shorter, as less of the body comes along. So a tie, which is an
// equality, a limit or friction loss, sees (Σ_j |g_j|)²/m at most of a soft body of mass m whose points it pushes by
// g_j: 1/m where it ties one to something else, 4/m where it ties two to each other.

#ifndef MJFRAMES_PLUGIN_IMPEDANCE_H_
#define MJFRAMES_PLUGIN_IMPEDANCE_H_

#include <mujoco/mujoco.h>

#include "row_inertia.h"

namespace mjframes {

// Sets R of row i, and what follows from it.
void SetResistance(mjData* d, int i, double R);

// Whether row i is a contact's.
bool IsContact(const mjData* d, int i);

// How many constraint rows a contact has.
int RowCount(const mjModel* m, const mjContact& contact);

// How many rows from row i on have one R: all of a contact, and those of one direction in space.
int RowsTogether(const mjModel* m, const mjData* d, int i);

// Sets R of the rows that belong together with those of the group, which starts at the first of them. lies: of each
// contact, whether it lies flat (touch.h); null if none does. Done again it gives the same.
void SetResistances(const mjModel* m, mjData* d, const double* lies, const RowGroup& group);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_IMPEDANCE_H_
