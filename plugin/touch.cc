#include "touch.h"

#include <algorithm>
#include <cmath>
#include <mutex>

#include "constants.h"
#include "deformed.h"
#include "geom_distance.h"
#include "meetings.h"
#include "placed.h"
#include "round_side.h"
#include "round_touch.h"
#include "simd.h"
#include "soft_body.h"
#include "surface_state.h"
#include "vertices.h"

namespace mjframes {
namespace {

// The surfaces of a pair, which no other thread uses meanwhile.
class SurfaceLocks {
 public:
  explicit SurfaceLocks(const SoftSide side[2]) {
    for (int s = 0; s < 2; s++) {
      if (side[s].body) lock_[s] = std::unique_lock(side[s].body->contact().state()->mutex, std::defer_lock);
    }
    if (lock_[0].mutex() && lock_[1].mutex()) {
      std::lock(lock_[0], lock_[1]);
    } else {
      lock_[lock_[0].mutex() ? 0 : 1].lock();
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

// Distance of the pressure centre, and of the deepest and the first of the vertices; mjMAXVAL where nothing is near
// [m]. total: Σ a_s before it was divided out. pressed: how much of their variance is that of the pressure [-].
struct Shared {
  double distance, deepest, first, total, pressed;
};

// Turns the distances of a cluster into shares in its contact, a_s = max(0, 1 − (d_s − min d) / reach)² over their sum:
// those that are `reach` above the deepest have none; of a dent, those that are half as deep. Where a dent is shallow
// more have a share, so that contacts slide smoothly. A ball presses on those alone that are half as deep: of points
// r²/(2R) higher, m in the mean, the variance is m R, and of those that the ball presses on R δ/8.
Shared ShareOut(double* distance, int begin, int end, double reach, bool dents) {
  const double deepest = ExtremesOf(distance + begin, end - begin).least, first = distance[begin];
  if (deepest == mjMAXVAL) {
    std::fill(distance + begin, distance + end, 0.0);
    return {mjMAXVAL, mjMAXVAL, first, 0, 0};
  }
  if (dents) reach = std::max(reach, -kDentEdge * deepest);
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
  const double higher = kHertz * (mean / total - deepest), depth = std::max(0.0, -deepest);
  return {mean / total, deepest, first, total, dents && higher > depth ? depth / higher : 1};
}

// A touch of a cluster that is not settled yet.
Touch OfCluster(double distance, int side, int begin, int end) {
  return {distance, {}, {}, static_cast<int16_t>(side), static_cast<int16_t>(begin), static_cast<int16_t>(end),
          0,        0,  {}};
}

// Makes a direction, a place and a variance of the sums over what touches, balls of this radius. square: of their
// places, by share. False where opposite normals cancel, as where a thin geom is between the vertices: no direction, no
// contact.
bool Settle(double radius, double square, const Shared& shared, Touch* touch) {
  const double length = Norm(touch->normal);
  if (!(length > mjMINVAL)) return false;
  touch->normal = (1 / length) * touch->normal;
  const double variance = std::max(0.0, 0.5 * (square - Dot(touch->position, touch->position)));
  touch->variance = static_cast<float>(shared.pressed * variance);
  touch->position = touch->position - (radius + 0.5 * touch->distance) * touch->normal;
  return true;
}

// Which way the cluster of a flat side that begins there faces at rest; 0 if it is of no flat side.
Vec3 Facing(const Patch& patch, int begin) {
  return patch.volume.facing.empty() ? Vec3{} : patch.volume.facing[patch.ClusterOf(begin)];
}

// Half of the heights over which a contact goes to a corner that just touches [m]: what falls freely for a step or two
// stays among them.
double CornerWidth(const mjModel* m, double reach) {
  const double fall = Norm(ToVec3(m->opt.gravity)) * m->opt.timestep * m->opt.timestep;
  return std::clamp(kCornerFall * fall, kCorner * reach, kCornerMost * reach);
}

// Where flat lies on flat, any distribution of the force over a cluster holds it up: the contact goes to the corner,
// the cluster's first vertex, so that bodies stand as wide as they are. With Δ how much higher the corner is than the
// pressure centre, the distance becomes that of the centre + g(Δ), and the corner has the share g' in the contact: 1
// where it is deeper by `width`, ½ and g = 0 where it is as deep, 0 where it is higher by `width`. That grows with the
// depth, from `least` on, and without a bound where much of the cluster touches a flat geom. flat: 1 where it does, 0
// where it touches a round geom or a soft body. corner: where that is [m].
void MoveToCorner(const Patch& patch, double least, double reach, double flat, const Shared& shared, const Vec3& corner,
                  double* share, Touch* touch) {
  if (!(Norm(Facing(patch, touch->begin)) > 0)) return;
  const double part = shared.total / (touch->end - touch->begin);
  touch->lies = static_cast<float>(std::min(1.0, kLies * part));
  const double pressed = least + kCornerPressed * std::max(0.0, -touch->distance);
  const double bound = std::min(kCornerMost * reach, pressed);
  const double many = std::clamp((part - kCornerFew) / (kCornerMany - kCornerFew), 0.0, 1.0);
  const double width = bound + many * flat * (pressed - bound);
  const double higher = shared.first - touch->distance;
  const double moved = std::clamp(0.5 * (width - higher) / width, 0.0, 1.0);
  const Vec3 place = corner - 0.5 * shared.first * touch->normal;
  const Vec3 way = moved * (place - touch->position);
  touch->position = touch->position + way;
  for (int c = 0; c < 3; c++) touch->moved[c] = static_cast<float>(way[c]);
  touch->distance += 0.25 * width + (higher > -width ? -width * moved * moved : higher);
  for (int s = touch->begin; s < touch->end; s++) share[s] *= 1 - moved;
  share[touch->begin] += moved;
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

// Whether something lies along a flat side that faces this way now: the side that faces it has its own points.
bool LiesAlong(const Vec3& facing, const Vec3& normal) { return std::abs(Dot(facing, normal)) < kAlong * Norm(facing); }

// Which way the cluster that begins there faces now, if it is of a flat side, else 0.
Vec3 FacingNow(SurfaceState* state, int patch, int begin) {
  return MulT(state->Pose(patch).slope, Facing(state->Deformed(patch).patch(), begin));
}

// The places that round sides of one patch have been found at.
struct RoundPlaces {
  RoundPlace all[kMaxClusters];
  int count = 0;

  // The one that is nearest to a place; null if there is none.
  const RoundPlace* NearestTo(const Vec3& place) const {
    const RoundPlace* nearest = nullptr;
    for (const RoundPlace* one = all; one != all + count; one++) {
      if (!nearest || Norm(one->place - place) < Norm(nearest->place - place)) nearest = one;
    }
    return nearest;
  }
};

// Adds the contact of a round cluster's side, if it is this patch's and not there yet. Returns which share of the depth
// is left to the cluster's own: both are there where one fades into the other.
double AddRoundSide(const Placed& soft, const GeomQuery& other, const double* share, int begin, int end, double margin,
                    RoundPlaces* found, Touch* out, int* count) {
  const Patch& patch = soft.deformed.patch();
  const double* vertices = soft.state->Vertices(soft.number);
  const double rho = RoundReach(soft.deformed.contact());
  const auto left = [](const RoundPlace& one) { return one.wide * (2 - one.wide); };
  Vec3 start{}, xi{};
  for (int s = begin; s < end; s++) {
    if (share[s] == 0) continue;
    start = start + share[s] * Vertex(vertices, patch.vertices, s);
    xi = xi + share[s] * soft.deformed.VertexPoint(s);
  }
  if (const RoundPlace* here = found->NearestTo(start); here && Norm(here->place - start) < rho) return left(*here);
  Touch round;
  const RoundPlace one = RoundSide(other, soft, start, xi, &round);
  const RoundPlace* near = found->NearestTo(one.place);
  const double apart = near ? std::clamp(2 * Norm(near->place - one.place) / rho - 1, 0.0, 1.0) : 1;
  found->all[found->count++] = one;
  if (*count == kMaxClusters) return 0;
  if (round.distance < 0) round.distance *= apart * (1 - one.wide * one.wide);
  if (one.own && apart > 0 && one.wide < 1 && round.distance < margin) out[(*count)++] = round;
  return *count < kMaxClusters ? left(one) : 0;
}

// The clusters of a patch against a rigid geom, but for those beyond `margin`; normals point out of the geom. rolls:
// whether round ones touch at one place.
int GeomTouches(const Placed& soft, int side, const GeomQuery& other, bool rolls, double width, double margin,
                TouchScratch* scratch, Touch* out) {
  const double reach = soft.deformed.contact().reach;
  const Patch& patch = soft.deformed.patch();
  const double beyond = rolls ? patch.volume.cover * soft.pose.stretch : 0;  // how far a round side is off its vertices
  if (other.LowerBound(soft.state->VertexBox(soft.number)) > std::max(0.0, margin) + kBoxMargin + beyond) return 0;
  const int n = patch.vertices;
  const double* vertices = soft.state->Vertices(soft.number);
  double* share = scratch->share[side];
  RoundPlaces places;
  int end = 0, count = 0;
  for (size_t c = 0; c < patch.cluster.size(); c++) {
    const int begin = end;
    end += patch.cluster[c];
    other.Distances(vertices, n, begin, end, share);
    const Vec3 facing = FacingNow(soft.state, soft.number, begin);
    if (!patch.dent.empty() && Norm(facing) > 0) {
      // what dents deeper than the way out by the geom's side would be pushed along its own side, as friction does
      for (int s = begin; s < end; s++) {
        if (share[s] < 0 && LiesAlong(facing, other.Normal(Vertex(vertices, n, s)))) share[s] = mjMAXVAL;
      }
    }
    const Shared shared = ShareOut(share, begin, end, reach, !patch.dent.empty());
    Touch touch = OfCluster(shared.distance, side, begin, end);
    double square = 0;
    double left = 1;  // of the depth, for the cluster's own contact
    if (rolls && patch.volume.round[c]) {
      if (!(shared.deepest < margin + beyond)) continue;
      left = AddRoundSide(soft, other, share, begin, end, margin, &places, out, &count);
      if (left == 0) continue;
    }
    if (!(shared.deepest < margin)) continue;
    for (int s = begin; s < end; s++) {
      if (share[s] == 0) continue;
      const Vec3 p = Vertex(vertices, n, s);
      touch.position = touch.position + share[s] * p;
      square += share[s] * Dot(p, p);
      touch.normal = touch.normal + share[s] * other.Normal(p);
    }
    const double flat = std::max(0.0, 1 - (1 - Norm(touch.normal)) / kCornerUneven);
    if (!Settle(0, square, shared, &touch)) continue;
    if (LiesAlong(facing, touch.normal)) continue;
    if (other.bounded() && PushesOut(soft, touch, share)) continue;
    MoveToCorner(patch, width, reach, flat, shared, Vertex(vertices, n, begin), share, &touch);
    if (touch.distance < 0) touch.distance *= left;
    if (touch.distance < margin) out[count++] = touch;
  }
  return count;
}

// The variance of what a vertex stands for [m²].
double OfOneVertex(double spacing) { return spacing * spacing / 12; }

// The features of a geom, balls of that radius, that touch the patch; normals point out of the soft body. found: where
// they are in that.
int FeatureTouches(const MetPoints& found, const Placed& soft, double radius, double reach, double margin, Touch* out) {
  constexpr int kMost = 64;  // points of one cluster that count: the first ones of a mesh with more
  const MetPoint* near[kMost];
  double share[kMost];
  int count = 0;
  for (const MetPoint *met = found.first, *end = met + found.count; met != end;) {
    int size = 0;
    for (const int cluster = met->cluster; met != end && met->cluster == cluster; met++) {
      if (met->patch != soft.number || size == kMost) continue;
      near[size] = met;
      share[size++] = met->distance - radius;
    }
    if (size == 0) continue;
    const Shared shared = ShareOut(share, 0, size, reach, !soft.deformed.patch().dent.empty());
    if (!(shared.distance < margin)) continue;
    Touch touch = {shared.distance, {}, {}, -1, 0, 0, 0, 0, {}};
    double square = 0;
    for (int i = 0; i < size; i++) {
      touch.position = touch.position + share[i] * near[i]->place;
      square += share[i] * Dot(near[i]->place, near[i]->place);
      touch.normal = touch.normal + share[i] * near[i]->normal;
      touch.xi = touch.xi + share[i] * near[i]->xi;
    }
    if (!Settle(radius, square, shared, &touch)) continue;
    const double least = OfOneVertex(soft.deformed.patch().volume.spacing);
    touch.variance = static_cast<float>(std::max(kEdgePressure * touch.variance, least));
    out[count++] = touch;
  }
  return count;
}

// The vertices of one patch that touch one of another soft body; normals point out of the other. found: where they are
// in that body.
int VertexTouches(const mjModel* m, const SoftSide& own, int other_patch, const MetPoints& found, int side,
                  double margin, TouchScratch* scratch, Touch* out) {
  if (found.count == 0) return 0;
  const double reach = own.body->contact().model().reach, width = CornerWidth(m, reach);
  const Patch& patch = own.body->contact().model().patches[own.patch];
  double* share = scratch->share[side];
  const MetPoint* of_vertex[kMaxPatchVertices];
  const MetPoint *met = found.first, *last = found.first + found.count;
  int begin = 0, count = 0;
  for (const int size : patch.cluster) {
    const int end = begin + size;
    bool near = false;
    for (; met != last && met->number < end; met++) {
      if (met->patch != other_patch) continue;
      if (!near) std::fill(share + begin, share + end, mjMAXVAL);
      near = true;
      share[met->number] = met->distance;
      scratch->xi[side][met->number] = met->xi;
      of_vertex[met->number] = met;
    }
    if (near) {
      const Shared shared = ShareOut(share, begin, end, reach, !patch.dent.empty());
      Touch touch = OfCluster(shared.distance, side, begin, end);
      double square = 0;
      for (int s = begin; s < end && shared.deepest < margin; s++) {
        if (share[s] == 0) continue;
        touch.position = touch.position + share[s] * of_vertex[s]->place;
        square += share[s] * Dot(of_vertex[s]->place, of_vertex[s]->place);
        touch.normal = touch.normal + share[s] * of_vertex[s]->normal;
      }
      const bool touches = shared.deepest < margin && Settle(0, square, shared, &touch);
      if (touches && !LiesAlong(FacingNow(own.body->contact().state(), own.patch, begin), touch.normal)) {
        const Vec3& corner = shared.first < mjMAXVAL ? of_vertex[begin]->place : touch.position;
        MoveToCorner(patch, width, reach, 0, shared, corner, share, &touch);
        if (touch.distance < margin) out[count++] = touch;
      }
    }
    begin = end;
  }
  return count;
}

// Where two patches of soft bodies touch.
int SoftTouches(const mjModel* m, const mjData* d, const int geom[2], const SoftSide side[2], double margin,
                TouchScratch* scratch, Touch* out) {
  Meetings* meetings[2];
  SurfaceState* state[2];
  Meetings::Extent extent[2];
  for (int s = 0; s < 2; s++) {
    meetings[s] = side[s].body->contact().meetings();
    state[s] = side[s].body->contact().state();
    if (!meetings[s]) return 0;
    const std::lock_guard lock(state[s]->mutex);  // one after the other: most pairs are apart, and this is all of them
    state[s]->Update(d);
    extent[s] = meetings[s]->Measured(m);
  }
  const double most = extent[0].margin + extent[1].margin;
  const bool is_wide = margin > most;  // a sensor of distance may ask farther than what collides
  double height[2];                    // what is higher has no share in a contact
  for (int s = 0; s < 2; s++) {
    height[s] = (is_wide ? margin : most) + side[s].body->contact().model().reach;
  }
  if (extent[0].Apart(extent[1], std::max(height[0], height[1]))) return 0;
  const SurfaceLocks locks(side);
  int count[2];
  for (int s = 0; s < 2; s++) {
    const MetPoints found = meetings[s]->FindVertices(side[s].patch, meetings[1 - s], height[s]);
    Touch* own = s == 0 ? out : out + count[0];
    count[s] = VertexTouches(m, side[s], side[1 - s].patch, found, s, margin, scratch, own);
  }
  for (int i = 0; i < count[0]; i++) out[i].normal = -1 * out[i].normal;
  if (count[0] + count[1] > 0 && !is_wide) {
    for (int s = 0; s < 2; s++) {
      const Touch* own = s == 0 ? out : out + count[0];
      state[s]->Keep(d, side[s].patch, geom[1 - s], state[1 - s], own, count[s], scratch->share[s], scratch->xi[s]);
    }
  }
  return count[0] + count[1];
}

// Where a patch touches a rigid geom.
int RigidTouches(const mjModel* m, const mjData* d, const int geom[2], const SoftSide side[2], double margin,
                 TouchScratch* scratch, Touch* out) {
  const SurfaceLocks locks(side);
  const int s = side[1].body ? 1 : 0, rigid = geom[1 - s];
  const SoftContact& contact = side[s].body->contact();
  const double shared = contact.model().reach, ball = Features::Radius(m, rigid);
  const double reach = std::max(0.0, margin) + shared;
  const GeomQuery query(m, d, contact.meshes(), rigid, reach);
  if (!query.valid) return 0;
  // the same for every call on the pair, whatever margin it is made with: what is in the box must not change
  const double room = m->geom_margin[geom[0]] + m->geom_margin[geom[1]] + m->geom_gap[geom[0]] + m->geom_gap[geom[1]];
  const Placed soft = Place(contact, side[s].patch, d, room + shared + ball);
  int count = 0;
  if (!contact.model().has_volume || !(query.LowerBound(soft.pose.box) > reach)) {
    const bool round = IsRound(m->geom_type[rigid]);
    // without dents one place would be as stiff as a point, and a ball between plates would turn to where it is softer
    const Patch& patch = soft.deformed.patch();
    const std::vector<uint8_t>& rounded = patch.volume.round;
    const bool rolls = contact.model().has_volume && !round && !patch.dent.empty() &&
                       std::find(rounded.begin(), rounded.end(), 1) != rounded.end();
    const int vertices = count = GeomTouches(soft, s, query, rolls, CornerWidth(m, shared), margin, scratch, out);
    if (contact.model().has_volume && round) {
      count += RoundTouch(m, d, rigid, query, soft, margin, out + count);
    } else if (contact.model().has_volume) {
      const double height = std::max(0.0, margin) + shared + ball;  // what is higher has no share in a contact
      const MetPoints found = contact.meetings()->FindFeatures(m, d, rigid, soft.room, height);
      count += FeatureTouches(found, soft, ball, shared, margin, out + count);
    }
    // those of features point out of the soft body, the others into it
    for (int i = 0; i < count; i++) {
      if ((i < vertices) == (s == 0)) out[i].normal = -1 * out[i].normal;
    }
  }
  soft.state->Keep(d, side[s].patch, rigid, nullptr, out, count, scratch->share[s], nullptr);
  return count;
}

// Of the vertices around the centre: the mean over about what touches, and over the nearest ones at least. stiffness:
// by which materials were scaled.
Dent FleshBelow(const Patch& patch, const double* vertices, const Touch& touch, const double* stiffness) {
  const int n = patch.vertices;
  const double spacing = patch.volume.spacing, square = kPressureEnd * touch.variance + spacing * spacing;
  Dent mean;
  double total = 0;
  const auto add = [&](int s, double share) {
    const Dent& dent = patch.dent[s];
    mean.width += share * dent.width;
    mean.softness += share * dent.softness / std::sqrt(stiffness[patch.factor[s]]);
    mean.thickness += share * dent.thickness;
    mean.section += share * dent.section;
    total += share;
  };
  for (int s = 0; s < n; s++) {
    const Vec3 offset = Vertex(vertices, n, s) - touch.Centre();
    if (const double share = square - Dot(offset, offset); share > 0) add(s, share);
  }
  double far = mjMAXVAL;
  if (total == 0) add(std::max(0, NearestVertex(vertices, n, touch.Centre(), &far)), 1);
  return {mean.width / total, mean.softness / total, mean.thickness / total, mean.section / total};
}

}  // namespace

int FindTouches(const mjModel* m, const mjData* d, const int geom[2], const SoftSide side[2], double margin,
                TouchScratch* scratch, Touch* out) {
  if (side[0].body == side[1].body) return 0;
  for (int s = 0; s < 2; s++) {
    if (side[s].body && side[s].patch < 0) return 0;
  }
  const auto find = side[0].body && side[1].body ? SoftTouches : RigidTouches;
  return find(m, d, geom, side, margin, scratch, out);
}

int RecallTouches(const mjData* d, const int geom[2], const SoftSide side[2], TouchScratch* scratch, Touch* out) {
  if (side[0].body == side[1].body) return 0;
  for (int s = 0; s < 2; s++) {
    if (side[s].body && side[s].patch < 0) return 0;
  }
  const SurfaceLocks locks(side);
  SurfaceState* state[2] = {};
  for (int s = 0; s < 2; s++) {
    if (!side[s].body) continue;
    state[s] = side[s].body->contact().state();
    state[s]->Update(d);
  }
  int count = 0;
  for (int s = 0; s < 2; s++) {
    if (!state[s]) continue;
    Touch* own = out + count;
    const int found =
        state[s]->Recall(d, side[s].patch, geom[1 - s], state[1 - s], own, scratch->share[s], scratch->xi[s]);
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
  SurfaceState* state = side[s].body->contact().state();
  const std::lock_guard lock(state->mutex);
  const DeformedPatch deformed = state->Deformed(side[s].patch);
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

ContactDents TouchDents(const SoftSide side[2], const Touch& touch) {
  ContactDents dents = {touch.Centre(), touch.variance, {}, {}, 0, 0};
  double spacing = 0;
  for (int s = 0; s < 2; s++) {
    if (!side[s].body) continue;
    SurfaceState* state = side[s].body->contact().state();
    const std::lock_guard lock(state->mutex);
    const Patch& patch = state->Deformed(side[s].patch).patch();
    if (patch.dent.empty()) continue;
    dents.side[s] = FleshBelow(patch, state->Vertices(side[s].patch), touch, side[s].body->scaling().stiffness.data());
    spacing = std::max(spacing, patch.volume.spacing);
  }
  if (touch.side >= 0) dents.variance += OfOneVertex(spacing);
  return dents;
}

void AddPlaceWeights(const SoftSide& side, const mjData* d, const Vec3& place, double* weight) {
  const std::lock_guard lock(side.body->contact().state()->mutex);
  const Placed soft = Place(side.body->contact(), side.patch, d, 0);
  Vec3 xi, normal;
  double distance;
  if (side.body->contact().model().has_volume && soft.Distance(place, &xi, &distance, &normal)) {
    soft.deformed.AddWeights(xi, 1, weight);
  } else {
    AddVertexWeights(soft.deformed.patch(), soft.NearestVertex(place), 1, weight);
  }
}

}  // namespace mjframes
