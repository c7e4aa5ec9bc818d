#include "meetings.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "kinematics.h"
#include "vertices.h"

namespace mjframes {
namespace {

using Result = DeformedPatch::Search;

}  // namespace

Meetings::Meetings(const ContactModel& contact, const Kinematics& kinematics,
                   const std::vector<std::unique_ptr<PatchState>>& states)
    : contact_(contact),
      kinematics_(kinematics),
      states_(states),
      x_(kinematics.points().size()),
      box_(contact.patches.size()),
      boxes_(contact.patches.size()),
      pose_(contact.patches.size()),
      nodes_(std::min(contact.field.node.size(), kKeptSoftNodes)),
      kept_(contact.patches.size()),
      next_(contact.patches.size()) {
  std::vector<int> bodies;
  for (const ControlPoint& point : kinematics.points()) {
    bodies.push_back(point.body);
    turns_ = turns_ || point.offset;
  }
  std::sort(bodies.begin(), bodies.end());
  bodies.erase(std::unique(bodies.begin(), bodies.end()), bodies.end());
  for (const int body : bodies) {
    if (runs_.empty() || body != runs_.back()[0] + runs_.back()[1]) runs_.push_back({body, 0});
    runs_.back()[1]++;
  }
  placed_.assign((turns_ ? 12 : 3) * bodies.size(), std::numeric_limits<double>::quiet_NaN());  // equal to nothing
  size_t vertices = 0;
  for (size_t i = 0; i < kept_.size(); i++) {
    const size_t n = contact.patches[i].vertices;
    vertices += 3 * n;
    for (Meeting& meeting : kept_[i]) meeting.found.resize(n + n / kSharedVertices);
  }
  vertices_.resize(vertices);
}

void Meetings::Update(const mjModel* m, const mjData* d) {
  bool same = true;
  mjtNum* placed = placed_.data();
  const auto keep = [&](const mjtNum* now, int count) {
    same = same && std::memcmp(placed, now, count * sizeof(mjtNum)) == 0;
    if (!same) std::copy_n(now, count, placed);
    placed += count;
  };
  for (const auto& run : runs_) {
    keep(d->xpos + 3 * run[0], 3 * run[1]);
    if (turns_) keep(d->xmat + 9 * run[0], 9 * run[1]);
  }
  if (same) return;
  version_++;
  for (size_t j = 0; j < x_.size(); j++) x_[j] = kinematics_.WorldPosition(d, static_cast<int>(j));
  nodes_.Forget();
  Vec3 low = {mjMAXVAL, mjMAXVAL, mjMAXVAL}, high = {-mjMAXVAL, -mjMAXVAL, -mjMAXVAL};
  cover_ = margin_ = 0;
  for (size_t i = 0; i < pose_.size(); i++) {
    const Patch& patch = contact_.patches[i];
    double* vertices = vertices_.data() + 3 * patch.volume.first_vertex;
    SkinVertices(patch, x_.data(), kIdentity, vertices);  // a body with a volume has no offsets
    box_[i] = BoxAround(vertices, patch.vertices);
    boxes_.Set(i, box_[i]);
    for (int c = 0; c < 3; c++) {
      low[c] = std::min(low[c], box_[i].centre[c] - box_[i].half[c]);
      high[c] = std::max(high[c], box_[i].centre[c] + box_[i].half[c]);
    }
    pose_[i] = patch.volume.Pose(contact_.field, x_.data());
    cover_ = std::max(cover_, patch.volume.cover * pose_[i].stretch);
    margin_ = std::max(margin_, m->geom_margin[patch.geom] + m->geom_gap[patch.geom]);
  }
  around_ = {0.5 * (low + high), 0.5 * (high - low)};
}

Meetings::Found Meetings::Find(const mjData* d, int patch, Meetings* other, double height) {
  if (box_[patch].Apart(other->around_, other->cover_ + height)) return {nullptr, 0};
  Meeting* meeting = nullptr;
  for (Meeting& kept : kept_[patch]) {
    if (kept.other == other) meeting = &kept;
  }
  if (!meeting) {
    meeting = &kept_[patch][next_[patch]];
    next_[patch] = (next_[patch] + 1) % kKeptMeetings;
  }
  if (meeting->other != other || meeting->version != version_ || meeting->other_version != other->version_ ||
      meeting->height != height) {
    Search(d, patch, other, height, meeting);
  }
  return {meeting->found.data(), meeting->count};
}

// Goes from vertex to vertex: where the last one is tells where the next one is, about.
void Meetings::Search(const mjData* d, int patch, Meetings* other, double height, Meeting* out) {
  out->other = other;
  out->version = version_;
  out->other_version = other->version_;
  out->height = height;
  out->count = 0;
  const DeformedPatch all = other->Whole();
  const int n = contact_.patches[patch].vertices;
  const double* vertices = Vertices(patch);
  Vec3 xi{}, last{}, start{};
  Mat3 slope{};
  double apart = 0;  // from `start`, so far away is nothing of the other body's surface
  bool known = false;
  int left = n;
  for (const int s : contact_.patches[patch].volume.walk) {
    // each of the vertices that are left has a place
    const int most = static_cast<int>(out->found.size()) - --left;
    const Vec3 p = {vertices[s], vertices[n + s], vertices[2 * n + s]};
    if (!other->around_.Contains(p, other->cover_ + height) || Norm(p - start) < apart) continue;
    DeformedPatch::Cube cube;
    Result found = Result::kNowhere;
    Mat3 there = slope;
    Vec3 at = xi + Mul(there, p - last);
    if (known) found = all.Find(p, false, height, &at, &cube, &there);
    // a short step out of the lattice, which goes on for more than half a cube outside of the surface, is certain
    double far = 0;
    if (found == Result::kNowhere || (found == Result::kOutside && Norm(at - xi) > kSureStep)) {
      at = other->Guess(p, &there, &far);
      found = all.Find(p, false, height, &at, &cube, &there);
    }
    if (found == Result::kFound || found == Result::kAbove) {
      known = true;
      xi = at;
      slope = there;
      last = p;
      if (found == Result::kFound) other->Meet(d, p, s, at, &cube, most, out);
    }
    if (found == Result::kOutside && far > 0) {
      start = p;
      apart = far - other->cover_ - height;
    }
  }
}

// The material point at p, about, by the vertex nearest to it, and ∂ξ/∂x. far: how far away that vertex is.
Vec3 Meetings::Guess(const Vec3& p, Mat3* slope, double* far) {
  const double* squares = boxes_.SquaresTo(p);
  const int patches = static_cast<int>(box_.size());
  const int first = static_cast<int>(std::min_element(squares, squares + patches) - squares);
  double square = mjMAXVAL;
  int patch = first, vertex = std::max(0, NearestVertex(Vertices(first), contact_.patches[first].vertices, p, &square));
  for (int j = 0; j < patches; j++) {
    if (j == first || !(squares[j] < square)) continue;
    const int found = NearestVertex(Vertices(j), contact_.patches[j].vertices, p, &square);
    if (found < 0) continue;
    patch = j;
    vertex = found;
  }
  *far = std::sqrt(square);
  *slope = pose_[patch].slope;
  const int n = contact_.patches[patch].vertices;
  const double *at = Vertices(patch) + vertex,
               *rest = contact_.field.vertex.data() + 3 * (contact_.patches[patch].volume.first_vertex + vertex);
  return Vec3{rest[0], rest[1], rest[2]} + Mul(*slope, p - Vec3{at[0], at[n], at[2 * n]});
}

// Adds a vertex at p, where this body has the material point ξ, in that cube; no more of them than `most`.
void Meetings::Meet(const mjData* d, const Vec3& p, int vertex, const Vec3& xi, DeformedPatch::Cube* cube, int most,
                    Meeting* out) {
  const Vec3 fraction = xi - cube->base;
  Vec3 surface, normal{};
  int nodes[8];
  std::copy(cube->nodes, cube->nodes + 8, nodes);
  const bool there = Whole().Surface(xi, cube, &surface, &normal);
  for (int corner = 0; corner < 8 && out->count < most; corner++) {
    const int patch = contact_.field.patch[nodes[corner]];
    const auto same = [&](int node) { return contact_.field.patch[node] == patch; };
    if (std::any_of(nodes, nodes + corner, same)) continue;
    const PatchVolume& volume = contact_.patches[patch].volume;
    if (!volume.IsWhole(nodes) || (there && !volume.IsWhole(cube->nodes))) {  // its rows see it elsewhere
      MeetPatch(d, p, vertex, patch, xi, out);
    } else if (there && contact_.field.IsNearest(nodes, fraction, patch)) {
      out->found[out->count++] = {vertex, patch, xi, Dot(normal, p - surface), normal};
    }
  }
}

// The same where the rows of a patch have it under that, from a guess.
void Meetings::MeetPatch(const mjData* d, const Vec3& p, int vertex, int patch, const Vec3& guess, Meeting* out) {
  PatchState* state = states_[patch].get();
  const std::lock_guard lock(state->mutex);
  state->Update(d);
  MetVertex& met = out->found[out->count];
  met = {vertex, patch, guess, 0, {}};
  out->count += state->Deformed().Distance(p, true, &met.xi, &met.distance, &met.normal);
}

}  // namespace mjframes
