// The simulation's options that a soft body cannot work with.

#ifndef MJFRAMES_PLUGIN_OPTIONS_H_
#define MJFRAMES_PLUGIN_OPTIONS_H_

#include <mujoco/mujoco.h>

namespace mjframes {

// What is wrong and what to do, for a body that is stepped implicitly or not and whose inertia is changed or not; null
// where nothing is.
const char* WrongOption(const mjModel* m, bool implicit, bool changes_inertia);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_OPTIONS_H_
