#include "touch.h"

#include <algorithm>
#include <cmath>
#include <mutex>

#include "constants.h"
#include "deformed.h"
#include "geom_distance.h"
#include "patch_state.h"
#include "placed.h"
#include "simd.h"
#include "soft_body.h"

namespace mjframes {
namespace {

Vec3 Vertex(const double* vertices, int n, int s) { return {vertices[s], vertices[n + s], vertices[2 * n + s]}; }

// The patches of a pair, which no other thread uses meanwhile.
class PatchLocks {
 public:
  PatchLocks(const int geom[2], const SoftSide side[2]) {
    const int first = geom[0] < geom[1] ? 0 : 1;  // in one order everywhere: no two threads wait for each other
    for (const int s : {first, 1 - first}) {
      if (side[s].body) lock_[s] = std::unique_lock(side[s].body->contact().states()[side[s].patch]->mutex);
    }
  }

 private:
  std::unique_lock<std::mutex> lock_[2];
};

void AddVertexWeights(const Patch& patch, int s, double scale, double* weight) {
  for (size_t a = 0; a < patch.point.size(); a++) {
    weight[patch.point[a]] += scale * patch.weight[a * patch.vertices + s];
  }
}

// Turns the distances of a cluster into shares in its contact, a_s = max(0, 1 − (d_s − min d) / reach)² over their sum:
// those that are `reach` above the deepest have none. Returns the distance of the pressure centre; mjMAXVAL and no
// shares if nothing is near.
double ShareOut(double* distance, int begin, int end, double reach) {
  const double deepest = ExtremesOf(distance + begin, end - begin).least;
  if (deepest == mjMAXVAL) {
    std::fill(distance + begin, distance + end, 0.0);
    return mjMAXVAL;
  }
  double total = 0, mean = 0;
  for (int s = begin; s < end; s++) {
    const double height = distance[s] - deepest;
    if (!(height < reach)) {
      distance[s] = 0;
      continue;
    }
    const double share = 1 - height / reach;
    mean += share * share * distance[s];
    distance[s] = share * share;
    total += distance[s];
  }
  for (int s = begin; s < end; s++) {
    if (distance[s] > 0) distance[s] /= total;
  }
  return mean / total;
}

// Makes a direction and a place of the sums over what touches, balls of this radius. False where opposite normals
// cancel, as where a thin geom is between the vertices: no direction, no contact.
bool Settle(double radius, Touch* touch) {
  const double length = Norm(touch->normal);
  if (!(length > mjMINVAL)) return false;
  touch->normal = (1 / length) * touch->normal;
  touch->position = touch->position - (radius + 0.5 * touch->distance) * touch->normal;
  return true;
}

// Whether a geom would push the surface further outwards: it is inside already, and its features bring it out.
bool PushesOut(const Placed& soft, const Touch& touch, const double* share) {
  if (!soft.deformed.contact().has_volume) return false;
  Vec3 xi{}, position, normal;
  for (int s = touch.begin; s < touch.end; s++) {
    if (share[s] > 0) xi = xi + share[s] * soft.deformed.VertexPoint(s);
  }
  return soft.deformed.Surface(xi, &position, &normal) && Dot(normal, touch.normal) > kOutward;
}

// The clusters of a patch against a rigid geom, but for those beyond `margin`; normals point out of the geom. A vertex
// is a ball of the contact radius.
int GeomTouches(const Placed& soft, int side, const GeomQuery& other, double margin, TouchScratch* scratch,
                Touch* out) {
  const double radius = soft.deformed.contact().radius;
  if (other.LowerBound(soft.state->VertexBox()) > std::max(0.0, margin) + radius + kBoxMargin) return 0;
  const Patch& patch = soft.deformed.patch();
  const int n = patch.vertices;
  const double* vertices = soft.state->Vertices();
  double* share = scratch->share[side];
  int end = 0, count = 0;
  for (const int size : patch.cluster) {
    const int begin = end;
    end += size;
    other.Distances(vertices, n, begin, end, share);
    for (int s = begin; s < end; s++) share[s] -= radius;
    Touch touch = {ShareOut(share, begin, end, kBlend * radius), {}, {}, side, begin, end, {}};
    if (!(touch.distance < margin)) continue;
    for (int s = begin; s < end; s++) {
      if (share[s] == 0) continue;
      const Vec3 p = Vertex(vertices, n, s);
      touch.position = touch.position + share[s] * p;
      touch.normal = touch.normal + share[s] * other.Normal(p);
    }
    if (!Settle(radius, &touch) || (other.bounded() && PushesOut(soft, touch, share))) continue;
    out[count++] = touch;
  }
  return count;
}

// The point of an ellipsoid at `centre` that is deepest in the soft body, down the surface's normal; the centre itself
// where nothing of the patch is near.
Vec3 Support(const mjModel* m, int geom, const Mat3& axes, const Vec3& centre, const Placed& soft) {
  Vec3 p = centre, xi, normal;
  double distance;
  const mjtNum* size = m->geom_size + 3 * geom;
  if (!soft.pose.box.Contains(centre, soft.room + std::max({size[0], size[1], size[2]}))) return centre;
  if (!soft.Distance(centre, false, &xi, &distance, &normal)) normal = centre - soft.pose.box.centre;
  for (int step = 0; step < kSupportSteps; step++) {
    p = centre + Mul(axes, EllipsoidSupport(size, MulT(axes, -1 * normal)));
    if (!soft.Distance(p, false, &xi, &distance, &normal)) break;
  }
  return p;
}

// The features of a geom that touch the patch; normals point out of the soft body.
int FeatureTouches(const mjModel* m, const mjData* d, int geom, const Placed& soft, const Features& features,
                   double margin, Touch* out) {
  const mjtNum* origin = d->geom_xpos + 3 * geom;
  Mat3 axes;
  std::copy(d->geom_xmat + 9 * geom, d->geom_xmat + 9 * geom + 9, axes.begin());
  const auto world = [&](const Vec3& local) { return Vec3{origin[0], origin[1], origin[2]} + Mul(axes, local); };
  const double reach = kBlend * soft.deformed.contact().radius;
  // in the geom's axes what may be near is in a box, too
  const Vec3 centre = MulT(axes, soft.pose.box.centre - Vec3{origin[0], origin[1], origin[2]});
  Vec3 half{};
  for (int i = 0; i < 3; i++) {
    for (int c = 0; c < 3; c++) half[i] += std::abs(axes[3 * c + i]) * (soft.pose.box.half[c] + soft.room);
  }
  const AlignedBox box = {centre, half};
  struct Near {
    Vec3 p, xi, normal;
  };
  constexpr int kMost = 64;  // points of one cluster that count: the first ones of a mesh with more
  Near near[kMost];
  double share[kMost];
  int count = 0;
  for (int c = 0; c < features.clusters.count; c++) {
    const FeatureCluster& cluster = features.clusters.cluster[c];
    if (!features.round && cluster.box.Apart(box, 2 * kBoxMargin)) continue;
    int found = 0;
    for (size_t i = cluster.begin; i < cluster.end && found < kMost; i++) {
      const Vec3& position = features.points[i];
      if (!(features.round || box.Contains(position, kBoxMargin))) continue;
      Near& candidate = near[found];
      candidate.p = world(position);
      if (features.round) candidate.p = Support(m, geom, axes, candidate.p, soft);
      // has no share in a contact
      if (soft.Above(candidate.p, std::max(0.0, margin) + reach + features.radius)) continue;
      if (!soft.Distance(candidate.p, true, &candidate.xi, &share[found], &candidate.normal)) continue;
      share[found] -= features.radius;
      found++;
    }
    if (found == 0) continue;
    const double distance = ShareOut(share, 0, found, reach);
    if (!(distance < margin)) continue;
    Touch touch = {distance, {}, {}, -1, 0, 0, {}};
    for (int i = 0; i < found; i++) {
      touch.position = touch.position + share[i] * near[i].p;
      touch.normal = touch.normal + share[i] * near[i].normal;
      touch.xi = touch.xi + share[i] * near[i].xi;
    }
    if (Settle(features.radius, &touch)) out[count++] = touch;
  }
  return count;
}

// The vertices of one patch that touch one of another soft body; normals point out of the other. found: where they are
// in that body.
int VertexTouches(const Meetings& mine, const SoftSide& own, int other_patch, const Meetings::Found& found, int side,
                  double margin, TouchScratch* scratch, Touch* out) {
  const double radius = own.body->contact().model().radius;
  const Patch& patch = own.body->contact().model().patches[own.patch];
  const double* vertices = mine.Vertices(own.patch);
  double* share = scratch->share[side];
  Vec3 normals[kMaxPatchVertices];
  const MetVertex *met = found.first, *last = found.first + found.count;
  int begin = 0, count = 0;
  for (const int size : patch.cluster) {
    const int end = begin + size;
    bool near = false;
    for (; met != last && met->vertex < end; met++) {
      if (met->patch != other_patch) continue;
      if (!near) std::fill(share + begin, share + end, mjMAXVAL);
      near = true;
      share[met->vertex] = met->distance - radius;
      scratch->xi[side][met->vertex] = met->xi;
      normals[met->vertex] = met->normal;
    }
    if (near) {
      Touch touch = {ShareOut(share, begin, end, kBlend * radius), {}, {}, side, begin, end, {}};
      for (int s = begin; s < end && touch.distance < margin; s++) {
        if (share[s] == 0) continue;
        touch.position = touch.position + share[s] * Vertex(vertices, patch.vertices, s);
        touch.normal = touch.normal + share[s] * normals[s];
      }
      if (touch.distance < margin && Settle(radius, &touch)) out[count++] = touch;
    }
    begin = end;
  }
  return count;
}

// Where two patches of soft bodies touch.
int SoftTouches(const mjModel* m, const mjData* d, const int geom[2], const SoftSide side[2], double margin,
                TouchScratch* scratch, Touch* out) {
  Meetings* meetings[2];
  for (int s = 0; s < 2; s++) {
    meetings[s] = side[s].body->contact().meetings();
    if (!meetings[s]) return 0;
  }
  int count[2];
  bool is_wide;  // a sensor of distance may ask farther than what collides
  {
    const std::scoped_lock lock(meetings[0]->mutex, meetings[1]->mutex);
    meetings[0]->Update(m, d);
    meetings[1]->Update(m, d);
    const double most = meetings[0]->margin() + meetings[1]->margin();
    is_wide = margin > most;
    for (int s = 0; s < 2; s++) {
      // what is higher has no share in a contact
      const double height = (is_wide ? margin : most) + (1 + kBlend) * side[s].body->contact().model().radius;
      const Meetings::Found found = meetings[s]->Find(d, side[s].patch, meetings[1 - s], height);
      Touch* own = s == 0 ? out : out + count[0];
      count[s] = VertexTouches(*meetings[s], side[s], side[1 - s].patch, found, s, margin, scratch, own);
    }
  }
  const int total = count[0] + count[1];
  for (int i = 0; i < count[0]; i++) out[i].normal = -1 * out[i].normal;
  if (total > 0 && !is_wide) {
    const PatchLocks locks(geom, side);
    PatchState* state[2];
    for (int s = 0; s < 2; s++) {
      state[s] = side[s].body->contact().states()[side[s].patch].get();
      state[s]->Update(d);
    }
    state[0]->Keep(d, geom[1], state[1], out, count[0], scratch->share[0], scratch->xi[0]);
    state[1]->Keep(d, geom[0], state[0], out + count[0], count[1], scratch->share[1], scratch->xi[1]);
  }
  return total;
}

}  // namespace

int FindTouches(const mjModel* m, const mjData* d, const int geom[2], const SoftSide side[2], double margin,
                TouchScratch* scratch, Touch* out) {
  if (side[0].body == side[1].body) return 0;
  for (int s = 0; s < 2; s++) {
    if (side[s].body && side[s].patch < 0) return 0;
  }
  if (side[0].body && side[1].body) return SoftTouches(m, d, geom, side, margin, scratch, out);
  const PatchLocks locks(geom, side);
  // the same for every call on the pair, whatever margin it is made with: what is in the box must not change
  const double room = m->geom_margin[geom[0]] + m->geom_margin[geom[1]] + m->geom_gap[geom[0]] + m->geom_gap[geom[1]];
  const int s = side[1].body ? 1 : 0, rigid = geom[1 - s];
  const SoftContact& contact = side[s].body->contact();
  const double reach = std::max(0.0, margin) + (1 + kBlend) * contact.model().radius;
  const GeomQuery query(m, d, contact.meshes(), rigid, reach);
  if (!query.valid) return 0;
  const double ball = Features::Radius(m, rigid);
  const Placed soft = Place(contact, side[s].patch, d, room + contact.model().radius + ball);
  int count = 0;
  if (!contact.model().has_volume || !(query.LowerBound(soft.pose.box) > reach)) {
    const int vertices = count = GeomTouches(soft, s, query, margin, scratch, out);
    if (contact.model().has_volume) {
      count += FeatureTouches(m, d, rigid, soft, Features(m, contact.meshes(), rigid), margin, out + count);
    }
    // those of features point out of the soft body, the others into it
    for (int i = 0; i < count; i++) {
      if ((i < vertices) == (s == 0)) out[i].normal = -1 * out[i].normal;
    }
  }
  soft.state->Keep(d, rigid, nullptr, out, count, scratch->share[s], nullptr);
  return count;
}

int RecallTouches(const mjData* d, const int geom[2], const SoftSide side[2], TouchScratch* scratch, Touch* out) {
  if (side[0].body == side[1].body) return 0;
  for (int s = 0; s < 2; s++) {
    if (side[s].body && side[s].patch < 0) return 0;
  }
  const PatchLocks locks(geom, side);
  PatchState* state[2] = {};
  for (int s = 0; s < 2; s++) {
    if (!side[s].body) continue;
    state[s] = side[s].body->contact().states()[side[s].patch].get();
    state[s]->Update(d);
  }
  int count = 0;
  for (int s = 0; s < 2; s++) {
    if (!state[s]) continue;
    Touch* own = out + count;
    const int found = state[s]->Recall(d, geom[1 - s], state[1 - s], own, scratch->share[s], scratch->xi[s]);
    if (found < 0) return 0;
    // sensors of distance, too, search, and may name the two in the other order
    for (int i = 0; i < found; i++) {
      if (own[i].side >= 0) own[i].side = s;
    }
    count += found;
  }
  return count;
}

void AddTouchWeights(const SoftSide side[2], const Touch& touch, const TouchScratch& scratch, int s, double* weight) {
  PatchState* state = side[s].body->contact().states()[side[s].patch].get();
  const std::lock_guard lock(state->mutex);
  const DeformedPatch deformed = state->Deformed();
  if (touch.side < 0) {
    Vec3 xi = touch.xi;
    deformed.AddWeights(deformed.Find(touch.position, false, &xi) ? xi : touch.xi, 1, weight);
    return;
  }
  for (int v = touch.begin; v < touch.end; v++) {
    const double share = scratch.share[touch.side][v];
    if (share == 0) continue;
    if (s != touch.side) {
      deformed.AddWeights(scratch.xi[touch.side][v], share, weight);
      continue;
    }
    AddVertexWeights(deformed.patch(), v, share, weight);
  }
}

void AddPlaceWeights(const SoftSide& side, const mjData* d, const Vec3& place, double* weight) {
  const std::lock_guard lock(side.body->contact().states()[side.patch]->mutex);
  const Placed soft = Place(side.body->contact(), side.patch, d, 0);
  Vec3 xi, normal;
  double distance;
  if (side.body->contact().model().has_volume && soft.Distance(place, false, &xi, &distance, &normal)) {
    soft.deformed.AddWeights(xi, 1, weight);
  } else {
    AddVertexWeights(soft.deformed.patch(), soft.NearestVertex(place), 1, weight);
  }
}

}  // namespace mjframes
