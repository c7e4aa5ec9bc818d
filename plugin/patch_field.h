// mjframes.patch: the signed distance of a patch where it is now, for what MuJoCo itself asks of an SDF geom: rays,
// range finders, picking, tactile sensors and flexes.
//
// MuJoCo names the plugin instance only and gives places in the geom's axes: so each patch geom has an instance of its
// own, without configuration. It belongs to the soft body whose instance the geom's body has.

#ifndef MJFRAMES_PLUGIN_PATCH_FIELD_H_
#define MJFRAMES_PLUGIN_PATCH_FIELD_H_

#include <mujoco/mujoco.h>

namespace mjframes {

inline constexpr char kPatchPluginName[] = "mjframes.patch";

// The plugin instance of the soft body that a geom is a patch of, −1 for other geoms.
int SoftInstanceOf(const mjModel* m, int geom);

void RegisterPatchField();

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PATCH_FIELD_H_
