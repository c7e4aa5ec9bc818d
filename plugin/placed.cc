#include "placed.h"

#include <algorithm>

#include "soft_contact.h"
#include "vertices.h"

namespace mjframes {

int Placed::NearestVertex(const Vec3& p) const {
  double square = mjMAXVAL;
  return std::max(0, mjframes::NearestVertex(state->Vertices(number), deformed.patch().vertices, p, &square));
}

Vec3 Placed::Guess(const Vec3& p, bool* near) const {
  const Vec3 xi = pose.guess + Mul(pose.slope, p - pose.box.centre);
  *near = pose.error > kTrusted || deformed.Near(xi, pose.error);
  return pose.error > kTrusted ? deformed.VertexPoint(NearestVertex(p)) : xi;
}

bool Placed::Distance(const Vec3& p, Vec3* xi, double* distance, Vec3* normal) const {
  bool near;
  *xi = Guess(p, &near);
  return deformed.Distance(p, xi, distance, normal);
}

bool Placed::Distance(const Vec3& p, DeformedPatch::Cube* cube, double* distance, Vec3* normal, bool* own) const {
  bool near, under;
  Vec3 xi = Guess(p, &near);
  if (!deformed.Distance(p, cube, &xi, distance, normal, &under)) return false;
  *own = under && near && pose.box.Contains(p, room);
  return true;
}

Placed Place(const SoftContact& contact, int patch, const mjData* d, double room) {
  SurfaceState* state = contact.state();
  state->Update(d);
  return {state->Deformed(patch), patch, state, state->Pose(patch), room};
}

}  // namespace mjframes
