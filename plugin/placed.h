// A patch where it is now: the deformed volume below it and its vertices, and how far away a point is.

#ifndef MJFRAMES_PLUGIN_PLACED_H_
#define MJFRAMES_PLUGIN_PLACED_H_

#include <mujoco/mujoco.h>

#include "deformed.h"
#include "linear.h"
#include "patch.h"
#include "surface_state.h"

namespace mjframes {

class SoftContact;

struct Placed {
  DeformedPatch deformed;
  int number;  // of the patch
  SurfaceState* state;
  const PatchPose& pose;
  double room;  // how far around the vertices and what is below them something may touch [m]

  // Signed distance of p from the body; xi becomes the material point at p.
  bool Distance(const Vec3& p, Vec3* xi, double* distance, Vec3* normal) const;

  // The same, and whether p is under this patch. Starts in a cube that it had last, and leaves one.
  bool Distance(const Vec3& p, DeformedPatch::Cube* cube, double* distance, Vec3* normal, bool* own) const;

  // The vertex nearest to p.
  int NearestVertex(const Vec3& p) const;

 private:
  // The material point at p, about; near: whether it may be one of this patch.
  Vec3 Guess(const Vec3& p, bool* near) const;
};

// The caller has locked the surface's mutex.
Placed Place(const SoftContact& contact, int patch, const mjData* d, double room);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PLACED_H_
