// Reading and validation of what a plugin instance says of its soft body.

#ifndef MJFRAMES_PLUGIN_PARSE_H_
#define MJFRAMES_PLUGIN_PARSE_H_

#include <mujoco/mujoco.h>

#include <memory>

#include "reader.h"
#include "soft_model.h"

namespace mjframes {

// The model of instance `instance`, the same for all who ask while anyone keeps it. What is wrong is told to `reader`,
// and then there is none.
std::shared_ptr<const SoftModel> FindModel(const mjModel* m, int instance, Reader* reader);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PARSE_H_
