// Entry point of the library: registers the plugins and installs the collision hook when it is loaded.

#include <mujoco/mujoco.h>

#include "contact.h"
#include "patch_field.h"
#include "sensor.h"
#include "tendon.h"
#include "world.h"

mjPLUGIN_LIB_INIT(mjframes) {
  mjframes::RegisterWorld();
  mjframes::RegisterPatchField();
  mjframes::RegisterSensor();
  mjframes::RegisterTendon();
  mjframes::InstallCollisionHook();
}
