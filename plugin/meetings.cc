#include "meetings.h"

#include <algorithm>
#include <cmath>

#include "surface_point.h"
#include "vertices.h"

namespace mjframes {

using Result = DeformedPatch::Search;

namespace {

// Of the features of one geom of the scene, each of which may be there for several patches.
size_t MostFeatures(const CollisionMeshes& meshes) {
  size_t most = 0;
  for (const auto& mesh : meshes) {
    if (mesh) most = std::max(most, mesh->features.points.size());
  }
  return most + most / kSharedVertices;
}

// Goes from a material point to where the body ends on the way inwards; false if it does not. at: becomes that point.
bool GoesOut(const DistanceField& field, const Vec3& inwards, Vec3* at) {
  const double length = Norm(inwards);
  const int steps = static_cast<int>(std::min(length / kThroughStep, kThroughSteps));
  for (int i = 0; i < steps; i++) {
    *at = *at + (kThroughStep / length) * inwards;
    int nodes[8];
    Vec3 fraction;
    if (!field.CubeAt(*at, nodes, &fraction)) return false;
    if (field.Distance(nodes, fraction) > 0) return true;
  }
  return false;
}

// The side of something thin where the middle of the feature's geom is; false if the body does not end on the way.
bool OtherSide(const DeformedPatch& body, const MetPoint& feature, const Inside& inside, DeformedPatch::Cube* cube,
               Vec3* surface, Vec3* normal) {
  Vec3 at = feature.xi, place, out;
  DeformedPatch::Cube around;
  double doubt;
  if (!GoesOut(body.contact().field, inside.inwards, &at)) return false;
  if (!body.Surface(&at, &around, &place, &out, &doubt) || !(Dot(inside.facing, out) < 0)) return false;
  *surface = place;
  *normal = out;
  *cube = around;
  return true;
}

// Distance of a point from the surface, and the normal by which it leaves the body; false midway between two sides.
// A feature whose nearest way out leads away from its geom is beyond the middle of something thin, or of the geom. A
// vertex's way out is looked for from inside its own body, if that is where its own surface faces: at its own place,
// where two surfaces lie on each other up to an edge, the nearest one may be round the edge. Where this body has an
// edge, the normal is that of the vertex's own side.
bool WayOut(const DeformedPatch& body, const MetPoint& point, const Inside& inside, DeformedPatch::Cube* cube,
            double* distance, Vec3* normal) {
  Vec3 surface, at = inside.is_geom ? point.xi : point.xi + inside.inwards;
  double doubt;
  const bool found = body.Surface(&at, cube, &surface, normal, &doubt);
  const double opposed = found ? -Dot(inside.facing, *normal) : 0;
  if (inside.is_geom) {
    const bool leads_away = !found || opposed < 0;
    if (leads_away && !OtherSide(body, point, inside, cube, &surface, normal) && !found) return false;
  } else if (opposed < kOpposed) {
    at = point.xi;
    if (!body.Surface(&at, cube, &surface, normal, &doubt)) return false;
  } else {
    const double share = opposed * std::clamp((doubt - kTrust) / (kNoTrust - kTrust), 0.0, 1.0);
    const Vec3 mean = (1 - share) * *normal - share * inside.facing;
    *normal = (1 / Norm(mean)) * mean;
  }
  *distance = Dot(*normal, point.place - surface);
  return true;
}

}  // namespace

Meetings::Meetings(const ContactModel& contact, const CollisionMeshes& meshes, bool pairs, size_t rigid,
                   SurfaceState* state)
    : contact_(contact),
      meshes_(meshes),
      state_(state),
      vertex_boxes_(contact.patches.size()),
      material_boxes_(contact.patches.size()),
      kept_(pairs ? contact.patches.size() : 0),
      next_(kept_.size()),
      met_(std::max(kKeptFeatures, MostFeatures(meshes))) {
  for (size_t i = 0; i < kept_.size(); i++) {
    const size_t n = contact.patches[i].vertices;
    for (Meeting& meeting : kept_[i]) meeting.found.resize(n + n / kSharedVertices);
  }
  features_.reserve(std::min(kKeptFeatureGeoms, rigid));
}

void Meetings::Measure(const mjModel* m) {
  measured_ = state_->version();
  Vec3 low = {mjMAXVAL, mjMAXVAL, mjMAXVAL}, high = {-mjMAXVAL, -mjMAXVAL, -mjMAXVAL};
  extent_.cover = extent_.margin = 0;
  for (int i = 0; i < static_cast<int>(contact_.patches.size()); i++) {
    const AlignedBox& box = state_->VertexBox(i);
    vertex_boxes_.Set(i, box);
    for (int c = 0; c < 3; c++) {
      low[c] = std::min(low[c], box.centre[c] - box.half[c]);
      high[c] = std::max(high[c], box.centre[c] + box.half[c]);
    }
    extent_.cover = std::max(extent_.cover, contact_.patches[i].volume.cover * state_->Pose(i).stretch);
    const int geom = contact_.patches[i].geom;
    extent_.margin = std::max(extent_.margin, m->geom_margin[geom] + m->geom_gap[geom]);
  }
  extent_.box = {0.5 * (low + high), 0.5 * (high - low)};
}

MetPoints Meetings::FindVertices(int patch, Meetings* other, double height) {
  if (state_->VertexBox(patch).Apart(other->extent_.box, other->extent_.cover + height)) return {nullptr, 0};
  Meeting* meeting = nullptr;
  for (Meeting& kept : kept_[patch]) {
    if (kept.other == other) meeting = &kept;
  }
  if (!meeting) {
    meeting = &kept_[patch][next_[patch]];
    next_[patch] = (next_[patch] + 1) % kKeptMeetings;
  }
  const uint64_t version = state_->version(), other_version = other->state_->version();
  if (meeting->other != other || meeting->version != version || meeting->other_version != other_version ||
      meeting->height != height) {
    meeting->other = other;
    meeting->version = version;
    meeting->other_version = other_version;
    meeting->height = height;
    Search(patch, other, height, meeting);
  }
  return {meeting->found.data(), meeting->count};
}

// Goes from vertex to vertex, each beside the one before.
void Meetings::Search(int patch, Meetings* other, double height, Meeting* out) {
  const int n = contact_.patches[patch].vertices;
  const double* vertices = state_->Vertices(patch);
  Trail trail;
  Sink sink = {out->found.data(), 0, 0};
  int left = n;
  for (const int s : contact_.patches[patch].volume.walk) {
    // each of the vertices that are left has a place
    sink.most = static_cast<int>(out->found.size()) - --left;
    const MetPoint sought = {s, 0, 0, Vertex(vertices, n, s), {}, 0, {}};
    other->Seek(sought, height, {this, patch, {}, 0}, &trail, &sink);
  }
  out->count = sink.count;
}

MetPoints Meetings::FindFeatures(const mjModel* m, const mjData* d, int geom, double room, double height) {
  if (features_version_ != state_->version()) features_.clear();
  features_version_ = state_->version();
  const GeomPlace place = PlaceOf(d, geom);
  const Vec3 size = ToVec3(m->geom_size + 3 * geom);
  const int type = m->geom_type[geom], data = m->geom_dataid[geom];
  const auto same = [&](const FeatureMeeting& kept) {
    return kept.geom == geom && kept.type == type && kept.data == data && kept.room == room && kept.height == height &&
           kept.place == place && kept.size == size;
  };
  const auto known = std::find_if(features_.begin(), features_.end(), same);
  if (known != features_.end()) return {met_.data() + known->begin, known->count};
  const Features features(m, meshes_, geom);
  if (features.clusters.count == 0) return {nullptr, 0};
  if (features_.size() == features_.capacity()) features_.clear();
  for (;;) {
    const int begin = features_.empty() ? 0 : features_.back().begin + features_.back().count;
    Sink sink = {met_.data() + begin, 0, static_cast<int>(met_.size()) - begin};
    SearchFeatures(m, features, d, geom, room, height, &sink);
    if (sink.count < sink.most || begin == 0) {
      features_.push_back({geom, type, data, place, size, room, height, begin, sink.count});
      return {sink.out, sink.count};
    }
    features_.clear();  // it did not fit in beside those
  }
}

void Meetings::SearchFeatures(const mjModel* m, const Features& features, const mjData* d, int geom, double room,
                              double height, Sink* sink) {
  if (posed_ != state_->version()) {
    posed_ = state_->version();
    for (int i = 0; i < static_cast<int>(contact_.patches.size()); i++) material_boxes_.Set(i, state_->Pose(i).box);
  }
  const Vec3 origin = ToVec3(d->geom_xpos + 3 * geom);
  const Mat3 axes = ToMat3(d->geom_xmat + 9 * geom);
  const double ball = Features::Radius(m, geom);
  for (int c = 0; c < features.clusters.count; c++) {
    const FeatureCluster& cluster = features.clusters.cluster[c];
    Trail trail;
    for (size_t i = cluster.begin; i < cluster.end && sink->count < sink->most; i++) {
      const Vec3 p = origin + Mul(axes, features.points[i]);
      if (!material_boxes_.AnyWithin(p, room)) continue;
      Measured(m);
      trail.apart = 0;  // one deep inside may leave the lattice, too, and others are then not far
      Seek({static_cast<int>(i), c, 0, p, {}, 0, {}}, height, {nullptr, 0, origin, ball}, &trail, sink);
    }
  }
}

// slope: from the world to this body's lattice, where the point is.
Inside Meetings::InsideOf(const Owner& owner, const MetPoint& point, const Mat3& slope) {
  if (!owner.body) {
    const Vec3 inwards = owner.middle - point.place;
    const double length = Norm(inwards);
    return {length > 0 ? (-1 / length) * inwards : Vec3{}, Mul(slope, inwards), true, false};
  }
  const Vec3 facing = owner.body->state_->Deformed(owner.patch).VertexNormal(point.number);
  return {facing, -owner.body->contact_.reach * Mul(slope, facing), false, false};
}

// Adds the point if it is in this body or no higher above; measured.
void Meetings::Seek(const MetPoint& sought, double height, const Owner& owner, Trail* trail, Sink* sink) {
  const Vec3& p = sought.place;
  if (!extent_.box.Contains(p, extent_.cover + height) || Norm(p - trail->start) < trail->apart) return;
  const DeformedPatch all = state_->Deformed(kAllPatches);
  DeformedPatch::Cube cube;
  Result found = Result::kNowhere;
  Mat3 there = trail->slope;
  const Vec3 step = Mul(there, p - trail->last);
  Vec3 at = trail->xi + step;
  if (trail->known && Norm(step) < kTrailStep) found = all.Find(p, false, height, &at, &cube, &there);
  // a short step out of the lattice, which goes on for more than half a cube outside of the surface, is certain
  Vec3 vertex;
  double far = 0;
  const bool is_lost = found == Result::kOutside && (owner.ball > 0 || Norm(at - trail->xi) > kSureStep);
  if (found == Result::kNowhere || is_lost) {
    at = Guess(p, &there, &vertex, &far);
    found = all.Find(p, false, height, &at, &cube, &there);
  }
  if (found == Result::kFound || found == Result::kAbove) {
    *trail = {true, at, p, trail->start, there, trail->apart};
    MetPoint met = sought;
    met.xi = at;
    const bool ball_above = owner.ball > 0 && contact_.field.Distance(cube.nodes, at - cube.base) > 0;
    if (found == Result::kFound && !(ball_above && SeekBelow(sought, at, there, sink))) {
      Meet(met, InsideOf(owner, met, there), &cube, sink);
    }
  }
  if (found == Result::kOutside && far > 0) {
    if (owner.ball > 0 && far < height + extent_.cover) SeekBelow(sought, vertex, there, sink);
    trail->start = p;
    trail->apart = far - extent_.cover - height;
  }
}

// Adds the middle of a ball that is above the surface by the nearest place of that; false where there is none.
// vertex: where to begin; slope: ∂ξ/∂x there.
bool Meetings::SeekBelow(const MetPoint& ball, const Vec3& vertex, const Mat3& slope, Sink* sink) {
  const DeformedPatch all = state_->Deformed(kAllPatches);
  const auto apart = [&ball](const Vec3& p, Vec3* up) {
    const double distance = Norm(p - ball.place);
    *up = (1 / std::max(distance, mjMINVAL)) * (p - ball.place);
    return distance;
  };
  SurfacePoint below;
  if (!FindOnSurface(all, apart, vertex, &below)) return false;
  Descend(all, apart, slope, below.distance, kRoundStride * contact_.field.spacing, &below);
  const Vec3 up = ball.place - below.position;
  const double over = Dot(up, below.normal);
  if (!(over > 0)) return false;
  // what is close above has no direction of its own
  const double share = std::clamp(below.distance / (kFarAbove * contact_.field.spacing), 0.0, 1.0);
  const Vec3 mean = (share / below.distance) * up + (1 - share) * below.normal;
  MetPoint met = ball;
  met.xi = below.xi;
  met.distance = share * below.distance + (1 - share) * over;
  met.normal = (1 / Norm(mean)) * mean;
  Meet(met, {{}, {}, true, true}, &below.cube, sink);
  return true;
}

// The material point at p, about, by the vertex nearest to it, and ∂ξ/∂x. nearest: that vertex; far: how far away it
// is.
Vec3 Meetings::Guess(const Vec3& p, Mat3* slope, Vec3* nearest, double* far) {
  const double* squares = vertex_boxes_.SquaresTo(p);
  const int patches = static_cast<int>(contact_.patches.size());
  const int first = static_cast<int>(std::min_element(squares, squares + patches) - squares);
  double square = mjMAXVAL;
  int patch = first,
      vertex = std::max(0, NearestVertex(state_->Vertices(first), contact_.patches[first].vertices, p, &square));
  for (int j = 0; j < patches; j++) {
    if (j == first || !(squares[j] < square)) continue;
    const int found = NearestVertex(state_->Vertices(j), contact_.patches[j].vertices, p, &square);
    if (found < 0) continue;
    patch = j;
    vertex = found;
  }
  *far = std::sqrt(square);
  *slope = state_->Pose(patch).slope;
  const int n = contact_.patches[patch].vertices;
  *nearest = state_->Deformed(patch).VertexPoint(vertex);
  return *nearest + Mul(*slope, p - Vertex(state_->Vertices(patch), n, vertex));
}

// Adds a point for each patch under which its material point is, in that cube.
void Meetings::Meet(const MetPoint& found, const Inside& inside, DeformedPatch::Cube* cube, Sink* sink) {
  const Vec3 fraction = found.xi - cube->base;
  Vec3 normal = found.normal;
  double distance = found.distance;
  int nodes[8];
  std::copy(cube->nodes, cube->nodes + 8, nodes);
  const bool there = inside.is_above || WayOut(state_->Deformed(kAllPatches), found, inside, cube, &distance, &normal);
  // what is high above is not in the lattice as the rows of some patches see it
  const auto find = [&](int patch, bool strict, Vec3* xi) {
    const DeformedPatch seen = state_->Deformed(patch);
    if (seen.Find(found.place, strict, xi)) return true;
    *xi = found.xi;
    return distance > 0 && seen.Find(found.place - distance * normal, strict, xi);
  };
  const int before = sink->count;
  // Patches whose rows see less than all of the body may each take it for the other's: then it is the nearest one's.
  for (const bool strict : {true, false}) {
    for (int corner = 0; corner < 8 && sink->count < sink->most; corner++) {
      const int patch = contact_.field.patch[nodes[corner]];
      const auto same = [&](int node) { return contact_.field.patch[node] == patch; };
      if (std::any_of(nodes, nodes + corner, same)) continue;
      MetPoint& met = sink->out[sink->count];
      met = found;
      met.patch = patch;
      const PatchVolume& volume = contact_.patches[patch].volume;
      const bool elsewhere = !volume.IsWhole(nodes) || (there && !volume.IsWhole(cube->nodes));  // its rows see it
      if ((!elsewhere || !strict) && !contact_.field.IsNearest(nodes, fraction, patch)) continue;
      if (elsewhere ? !find(patch, strict, &met.xi) : !there) continue;
      met.distance = distance;
      met.normal = normal;
      if (!there) {
        DeformedPatch::Cube around;
        if (!WayOut(state_->Deformed(patch), met, inside, &around, &met.distance, &met.normal)) continue;
      }
      // a vertex that would leave the way it faces is beyond the middle, and would draw its body further in
      sink->count += met.distance > 0 || inside.is_geom || !(Dot(inside.facing, met.normal) > kOutward);
    }
    if (sink->count > before) return;
  }
}

}  // namespace mjframes
