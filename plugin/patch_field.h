// mjframes.patch: the signed distance of a patch where it is now, for what MuJoCo itself asks of an SDF geom: rays,
// range finders, picking, tactile sensors and flexes.
//
// MuJoCo names the plugin instance only and gives places in the geom's axes: so each patch geom has an instance of its
// own, without configuration. It belongs to the soft body whose instance the geom's body has.

#ifndef MJFRAMES_PLUGIN_PATCH_FIELD_H_
#define MJFRAMES_PLUGIN_PATCH_FIELD_H_

#include <mujoco/mujoco.h>

#include "linear.h"

namespace mjframes {

class SoftContact;

inline constexpr char kPatchPluginName[] = "mjframes.patch";

// The plugin instance of the soft body that a geom is a patch of, −1 for other geoms.
int SoftInstanceOf(const mjModel* m, int geom);

// Signed distance [m] of p (world) from the part of the body under a patch, and which way is out. Inside it is that of
// the surface; outside it is at most that of the nearest point, and rays that go on by it come to the surface.
double FieldDistance(const SoftContact& contact, int patch, const mjData* d, const Vec3& p, Vec3* normal);

void RegisterPatchField();

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PATCH_FIELD_H_
