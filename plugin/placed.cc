#include "placed.h"

#include <algorithm>

#include "distance_field.h"
#include "soft_contact.h"
#include "vertices.h"

namespace mjframes {

int Placed::NearestVertex(const Vec3& p) const {
  double square = mjMAXVAL;
  return std::max(0, mjframes::NearestVertex(state->Vertices(), deformed.patch().vertices, p, &square));
}

bool Placed::Above(const Vec3& p, double height) const {
  if (pose.error > kTrusted) return false;
  const DistanceField& field = deformed.contact().field;
  int nodes[8];
  Vec3 fraction;
  if (!field.CubeAt(pose.guess + Mul(pose.slope, p - pose.box.centre), nodes, &fraction)) return false;
  // guesses of p and of the surface are both off by the error; the surface bends, so twice the cubes a metre
  const double cubes = field.Distance(nodes, fraction) / field.spacing - 2 * pose.error;
  return cubes > 2 * height * NormBound(pose.slope);
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
  PatchState* state = contact.states()[patch].get();
  state->Update(d);
  return {state->Deformed(), state, state->Pose(), room};
}

}  // namespace mjframes
