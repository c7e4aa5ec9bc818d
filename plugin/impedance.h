// R of constraint rows, for the effective inertia A in d->M.
//
// R is (1 − imp)/imp times an inverse inertia. MuJoCo took that of bodies without elasticity before the plugin added to
// d->M: soft bodies would hang and stand as deep as their single points of mass. Contacts take 1/m of the whole soft
// body here, as MuJoCo does for rigid ones: how deep it stands does not depend on the step, nor on where it is touched.
// Other rows, contacts of rigid geoms on a soft body's frames, and all where diagexact asks for it, take what they see,
// J A⁻¹ Jᵀ.
//
// The four rows of a pyramid have R ∝ μ² (1 + μ²). Where it is slippery they would be all but rigid, all but the same,
// and would throw things up: there R is that of friction kSlippery. On slopes of about that friction they creep more.

#ifndef MJFRAMES_PLUGIN_IMPEDANCE_H_
#define MJFRAMES_PLUGIN_IMPEDANCE_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "row_inertia.h"

namespace mjframes {

// Whether row i is a contact's.
bool IsContact(const mjData* d, int i);

// How many constraint rows a contact has.
int RowCount(const mjModel* m, const mjContact& contact);

// How many rows from row i on have one R: all of a contact, and those of one direction in space.
int RowsTogether(const mjModel* m, const mjData* d, int i);

// Whether R of the contact follows from the masses of what touches.
bool GoesByMass(const mjModel* m, const mjContact& contact);

// Sets R of a contact's rows.  inverse_mass: of the soft body of each plugin instance [1/kg].
void SetContactResistances(const mjModel* m, mjData* d, int row, const std::vector<double>& inverse_mass);

// Sets R of the rows that belong together with those of the group, which starts at the first of them. Done again it
// gives the same.
void SetResistances(const mjModel* m, mjData* d, const RowGroup& group);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_IMPEDANCE_H_
