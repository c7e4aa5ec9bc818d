#include "meetings.h"

#include <algorithm>
#include <cmath>

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

// Distance of a point from the surface, and the normal by which it leaves the body; false midway between two sides.
// facing: which way its own surface faces; inwards: the way into its own body, in this one's lattice. From there its
// way out is looked for, if that is where its own surface faces: at its own place, where two surfaces lie on each other
// up to an edge, the nearest one may be round the edge. Where this body has an edge, the normal is that of the point's
// own side.
bool WayOut(const DeformedPatch& body, const MetPoint& point, const Vec3& facing, const Vec3& inwards,
            DeformedPatch::Cube* cube, double* distance, Vec3* normal) {
  Vec3 surface, at = point.xi + inwards;
  double doubt;
  const bool found = body.Surface(&at, cube, &surface, normal, &doubt);
  const double opposed = found ? -Dot(facing, *normal) : 0;
  if (opposed < kOpposed) {
    at = point.xi;
    if (!body.Surface(&at, cube, &surface, normal, &doubt)) return false;
  } else {
    const double share = opposed * std::clamp((doubt - kTrust) / (kNoTrust - kTrust), 0.0, 1.0);
    const Vec3 mean = (1 - share) * *normal - share * facing;
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
    other->Seek(sought, height, this, patch, &trail, &sink);
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
  for (int c = 0; c < features.clusters.count; c++) {
    const FeatureCluster& cluster = features.clusters.cluster[c];
    Trail trail;
    for (size_t i = cluster.begin; i < cluster.end && sink->count < sink->most; i++) {
      const Vec3 p = origin + Mul(axes, features.points[i]);
      if (!material_boxes_.AnyWithin(p, room)) continue;
      Measured(m);
      trail.apart = 0;  // one deep inside may leave the lattice, too, and others are then not far
      Seek({static_cast<int>(i), c, 0, p, {}, 0, {}}, height, nullptr, 0, &trail, sink);
    }
  }
}

// Adds the point if it is in this body or no higher above; measured.
void Meetings::Seek(const MetPoint& sought, double height, Meetings* owner, int patch, Trail* trail, Sink* sink) {
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
  double far = 0;
  if (found == Result::kNowhere || (found == Result::kOutside && Norm(at - trail->xi) > kSureStep)) {
    at = Guess(p, &there, &far);
    found = all.Find(p, false, height, &at, &cube, &there);
  }
  if (found == Result::kFound || found == Result::kAbove) {
    *trail = {true, at, p, trail->start, there, trail->apart};
    MetPoint met = sought;
    met.xi = at;
    const Vec3 facing =
        found == Result::kFound && owner ? owner->state_->Deformed(patch).VertexNormal(sought.number) : Vec3{};
    const Vec3 inwards = owner ? -owner->contact_.reach * Mul(there, facing) : Vec3{};
    if (found == Result::kFound) Meet(met, facing, inwards, &cube, sink);
  }
  if (found == Result::kOutside && far > 0) {
    trail->start = p;
    trail->apart = far - extent_.cover - height;
  }
}

// The material point at p, about, by the vertex nearest to it, and ∂ξ/∂x. far: how far away that vertex is.
Vec3 Meetings::Guess(const Vec3& p, Mat3* slope, double* far) {
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
  return state_->Deformed(patch).VertexPoint(vertex) + Mul(*slope, p - Vertex(state_->Vertices(patch), n, vertex));
}

// Adds a point for each patch under which its material point is, in that cube. facing, inwards: see WayOut.
void Meetings::Meet(const MetPoint& found, const Vec3& facing, const Vec3& inwards, DeformedPatch::Cube* cube,
                    Sink* sink) {
  const Vec3 fraction = found.xi - cube->base;
  Vec3 normal{};
  double distance = 0;
  int nodes[8];
  std::copy(cube->nodes, cube->nodes + 8, nodes);
  const bool there = WayOut(state_->Deformed(kAllPatches), found, facing, inwards, cube, &distance, &normal);
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
      if (elsewhere ? !state_->Deformed(patch).Find(met.place, strict, &met.xi) : !there) continue;
      met.distance = distance;
      met.normal = normal;
      if (!there) {
        DeformedPatch::Cube around;
        if (!WayOut(state_->Deformed(patch), met, facing, inwards, &around, &met.distance, &met.normal)) continue;
      }
      // one that would leave the way its own surface faces is beyond the middle, and would draw its body further in
      sink->count += met.distance > 0 || !(Dot(facing, met.normal) > kOutward);
    }
    if (sink->count > before) return;
  }
}

}  // namespace mjframes
