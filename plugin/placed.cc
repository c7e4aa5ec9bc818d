#include "placed.h"

#include "distance_field.h"
#include "simd.h"
#include "soft_contact.h"

namespace mjframes {
namespace {

// The one of n points, given by component, that is nearest to p.
int Nearest(const double* points, int n, const Vec3& p) {
  int nearest = 0;
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    Lanes least = Fill(mjMAXVAL), first = Fill(0);  // squares, and the number of the first of four
    int s = 0;
    for (; s + kLanes <= n; s += kLanes) {
      const Lanes x = Load(points + s) - p[0], y = Load(points + n + s) - p[1], z = Load(points + 2 * n + s) - p[2];
      const Lanes square = x * x + y * y + z * z;
      first = square < least ? Fill(s) : first;
      least = square < least ? square : least;
    }
    double best = mjMAXVAL;
    for (int lane = 0; lane < kLanes; lane++) {
      if (!(least[lane] < best)) continue;
      best = least[lane];
      nearest = static_cast<int>(first[lane]) + lane;
    }
    for (; s < n; s++) {
      const Vec3 offset = Vec3{points[s], points[n + s], points[2 * n + s]} - p;
      if (!(Dot(offset, offset) < best)) continue;
      best = Dot(offset, offset);
      nearest = s;
    }
  });
  return nearest;
}

}  // namespace

int Placed::NearestVertex(const Vec3& p) const { return Nearest(state->Vertices(), deformed.patch().vertices, p); }

bool Placed::Above(const Vec3& p, double height) const {
  if (pose.error > kTrusted) return false;
  const DistanceField& field = deformed.contact().field;
  int nodes[8];
  Vec3 fraction, gradient;
  if (!field.CubeAt(pose.guess + Mul(pose.slope, p - pose.box.centre), nodes, &fraction)) return false;
  // guesses of p and of the surface are both off by the error; the surface bends, so twice the cubes a metre
  const double cubes = field.Distance(nodes, fraction, &gradient) / field.spacing - 2 * pose.error;
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
