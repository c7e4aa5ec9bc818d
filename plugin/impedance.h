// R of constraint rows.
//
// R is (1 − imp)/imp times the inverse inertia that a row sees. MuJoCo took that of bodies without elasticity before
// the plugin added to d->M: soft bodies would hang and stand as deep as their single points of mass would. Of a contact
// it is 1/m of each side, a soft body being one piece: so R depends neither on the time step nor on where it touches,
// and a body stands level. Of equality constraints it is J A⁻¹ Jᵀ, A the inertia in d->M.

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

// Sets R of the contact whose first row that is. Done again it gives the same.
void SetContactResistances(const mjModel* m, mjData* d, int row);

// Sets R of the rows that belong together with those of the group, which starts at the first of them; none is a
// contact's. Done again it gives the same.
void SetEqualityResistances(const mjModel* m, mjData* d, const RowGroup& group);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_IMPEDANCE_H_
