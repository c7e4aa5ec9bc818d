// What soft bodies require of the simulation's options and of the scene around them.

#ifndef MJFRAMES_PLUGIN_REQUIREMENTS_H_
#define MJFRAMES_PLUGIN_REQUIREMENTS_H_

#include <mujoco/mujoco.h>

#include <utility>

#include "attributes.h"
#include "soft_model.h"

namespace mjframes {

// Which option is wrong and what to do, for a body that is stepped implicitly or not and whose inertia is changed or
// not; null where none is.
const char* WrongOption(const mjModel* m, bool implicit, bool changes_inertia);

// A contact takes what it is solved with from either of its geoms, and one number that is none ends in all: which of a
// geom's is not finite, null where all are.
const char* WrongNumber(const mjModel* m, int geom);

// The first geom that may touch and has such a number, and which.
std::pair<int, const char*> FirstWrongNumber(const mjModel* m);

// Tells `reader` what of options and scene the body cannot work with.
void CheckRequirements(const mjModel* m, const SoftModel& model, Reader* reader);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_REQUIREMENTS_H_
