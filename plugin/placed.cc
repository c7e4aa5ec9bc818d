#include "placed.h"

#include <algorithm>

#include "soft_contact.h"
#include "vertices.h"

namespace mjframes {

int Placed::NearestVertex(const Vec3& p) const {
  double square = mjMAXVAL;
  return std::max(0, mjframes::NearestVertex(state->Vertices(number), deformed.patch().vertices, p, &square));
}

bool Placed::Distance(const Vec3& p, bool own, Vec3* xi, double* distance, Vec3* normal) const {
  if (own && !pose.box.Contains(p, room)) return false;
  *xi = pose.guess + Mul(pose.slope, p - pose.box.centre);
  if (pose.error > kTrusted) {
    *xi = deformed.VertexPoint(NearestVertex(p));
  } else if (own && !deformed.Near(*xi, pose.error)) {
    return false;
  }
  return deformed.Distance(p, own, xi, distance, normal);
}

Placed Place(const SoftContact& contact, int patch, const mjData* d, double room) {
  SurfaceState* state = contact.state();
  state->Update(d);
  return {state->Deformed(patch), patch, state, state->Pose(patch), room};
}

}  // namespace mjframes
