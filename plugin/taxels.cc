#include "taxels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <mutex>

#include "constants.h"
#include "geom_distance.h"
#include "patch_field.h"
#include "placed.h"
#include "pressing.h"
#include "stack.h"
#include "world.h"

namespace mjframes {

// What one object does to the soft body.
struct Taxels::Load {
  int first;                    // of its contacts
  int geom, other;              // its geom, and its geom's patch's instance if it is a soft body, else −1
  double normal = 0;            // N [N]
  Vec3 force{}, centre{};       // F [N]; the mean of its contacts, by their forces [m]
  const Vec3* pivot = nullptr;  // about which one of the two turns freely, null if neither does [m]
  Vec3 moment{};                // Σ N_c (x_c − pivot) × n_c, of the normal forces [N m]
  Vec3 torque{};                // about that [N m]
};

// x̂ = place + t1 (e1 · q) + t2 (e2 · q) + n (e3 · q), q = p̄ − rest.
struct Taxels::Fit {
  Vec3 rest, place;
  std::array<Vec3, 3> axis, image;

  Vec3 operator()(const Vec3& p) const {
    const Vec3 q = p - rest;
    return place + Dot(axis[0], q) * image[0] + Dot(axis[1], q) * image[1] + Dot(axis[2], q) * image[2];
  }

  // Of a direction on the surface, and of a normal: A v and A⁻ᵀ v, of length 1.
  Vec3 Along(const Vec3& v) const {
    return Unit(Dot(axis[0], v) * image[0] + Dot(axis[1], v) * image[1] + Dot(axis[2], v) * image[2]);
  }
  Vec3 Normal(const Vec3& v) const {
    return Unit(Dot(axis[0], v) * Cross(image[1], image[2]) + Dot(axis[1], v) * Cross(image[2], image[0]) +
                Dot(axis[2], v) * Cross(image[0], image[1]));
  }

  static Vec3 Unit(const Vec3& v) { return (1 / std::max(Norm(v), mjMINVAL)) * v; }
};

namespace {

constexpr char kMismatch[] = "its taxels are not those of the soft body: write the sensor again";

bool IsPatchOf(const mjModel* m, int geom, int instance) { return geom >= 0 && SoftInstanceOf(m, geom) == instance; }

// +1 or −1 as the soft body is the second or the first of a contact, 0 if it is neither or both, or nothing is there.
int SideOf(const mjModel* m, const mjContact& contact, int instance) {
  if (contact.efc_address < 0) return 0;
  return IsPatchOf(m, contact.geom[1], instance) - IsPatchOf(m, contact.geom[0], instance);
}

// The other geom of a contact, −1 for a flex, and the soft body it belongs to, −1 for none.
std::array<int, 2> OtherOf(const mjModel* m, const mjContact& contact, int sign) {
  const int geom = contact.geom[sign > 0 ? 0 : 1];
  return {geom, geom < 0 ? -1 : SoftInstanceOf(m, geom)};
}

// The centre of mass of what turns freely with a body: null where nothing of it has a free or a ball joint.
const mjtNum* FreeCentre(const mjModel* m, const mjData* d, int body) {
  for (; body > 0; body = m->body_parentid[body]) {
    for (int j = m->body_jntadr[body], end = j + m->body_jntnum[body]; j < end; j++) {
      if (m->jnt_type[j] == mjJNT_FREE || m->jnt_type[j] == mjJNT_BALL) return d->subtree_com + 3 * body;
    }
  }
  return nullptr;
}

// What the pressure has to balance: the centre of mass of the object, geom or patch, that lies free on the soft body,
// or of this where it lies free on what stands still; null where neither does.
const mjtNum* BalanceOf(const mjModel* m, const mjData* d, const SoftBody& body, const std::array<int, 2>& object) {
  const auto [geom, instance] = object;
  if (geom < 0) return nullptr;
  const int owner = m->geom_bodyid[geom];
  if (instance >= 0) {
    const Kinematics& other = GetSoftBody(d, instance)->kinematics();
    if (!other.held()) return d->subtree_com + 3 * other.holder();
  } else if (const mjtNum* centre = FreeCentre(m, d, owner)) {
    return centre;
  }
  const bool stands = m->body_weldid[owner] == 0;
  return stands && !body.kinematics().held() ? d->subtree_com + 3 * body.kinematics().holder() : nullptr;
}

bool IsSameObject(const std::array<int, 2>& a, const std::array<int, 2>& b) {
  return a[1] >= 0 ? a[1] == b[1] : a[0] == b[0];
}

}  // namespace

void Taxels::Read(Reader* soft, Reader* reader) {
  const size_t vertices = soft->Array<double>("lattice_vertex").size() / 3;
  area_ = reader->Array<double>("area");
  const size_t n = area_.size();
  weights_ = ReadWeights(soft->Array<double>("point_mass").size(), reader);
  const auto along = reader->Array<double>("along");
  const auto place = reader->Array<double>("place");
  const auto normal = reader->Array<double>("normal");
  widened_ = reader->Array<double>("widened");
  vertex_ = reader->Array<int32_t>("vertex");
  kernel_ = reader->Array<double>("kernel");
  step_ = reader->Number("kernel_step");
  softness_ = reader->Number("softness");
  thickness_ = reader->Number("thickness");
  factor_ = reader->Count("factor", kMaxMaterials) - 1;
  const size_t all = widened_.size();
  const bool known = std::all_of(vertex_.begin(), vertex_.end(),
                                 [=](int32_t i) { return i >= 0 && static_cast<size_t>(i) < vertices; });
  const bool fits = soft->ok() && n > 0 && weights_.size() >= static_cast<int>(n) && known && along.size() == 3 * n &&
                    all == weights_.size() + vertex_.size() && place.size() == 3 * all && normal.size() == 3 * all &&
                    kernel_.size() > 1;
  if (!reader->Check(fits && step_ > 0 && softness_ > 0 && thickness_ > 0, kMismatch)) return;
  for (size_t t = 0; t < all; t++) {
    rest_.push_back(ToVec3(place.data() + 3 * t));
    normal_.push_back(Fit::Unit(ToVec3(normal.data() + 3 * t)));
    if (t >= n) continue;
    along_.push_back(ToVec3(along.data() + 3 * t));
    if (!reader->Check(area_[t] > 0, "area has to be positive")) return;
    mean_area_ += area_[t] / static_cast<double>(n);
  }
  x_.resize(all);
  force_.resize(n);
  local_.resize(n);
  press_.resize(n);
  near_.reserve(all);
  fitted_.resize(3 * all);
  gap_.resize(all);
  lever_.resize(all);
  f_.resize(all);
}

// x of all places.
void Taxels::Place(const mjData* d, const SoftBody& body) {
  const Kinematics& kinematics = body.kinematics();
  const Mat3 axes = kinematics.Axes(d);
  const Vec3 origin = kinematics.PositionToWorld(d, {});
  const int n = weights_.size();
  for (int t = 0; t < n; t++) x_[t] = origin + Mul(axes, weights_.Position(t, kinematics.x()));
  SurfaceState* state = body.contact().state();
  const std::lock_guard lock(state->mutex);
  state->Update(d);
  size_t i = 0;
  int first = 0;
  const std::vector<Patch>& patches = body.contact().model().patches;
  for (size_t p = 0; p < patches.size(); first += patches[p++].vertices) {
    const int count = patches[p].vertices, end = first + count;
    if (i == vertex_.size() || vertex_[i] >= end) continue;
    const double* vertices = state->Vertices(static_cast<int>(p));
    for (; i < vertex_.size() && vertex_[i] < end; i++) {
      const int s = vertex_[i] - first;
      x_[n + i] = Vertex(vertices, count, s);
    }
  }
}

void Taxels::Compute(const mjModel* m, mjData* d, const SoftBody& body) {
  std::fill(force_.begin(), force_.end(), Vec3{});
  std::fill(local_.begin(), local_.end(), Vec3{});
  std::fill(press_.begin(), press_.end(), 0.0);
  Place(d, body);
  for (int c = 0; c < d->ncon; c++) {
    const int sign = SideOf(m, d->contact[c], body.instance());
    if (sign == 0) continue;
    const std::array<int, 2> object = OtherOf(m, d->contact[c], sign);
    Load load = {c, object[0], object[1]};
    Vec3 pivot;
    if (const mjtNum* centre = BalanceOf(m, d, body, object)) {
      pivot = ToVec3(centre);
      load.pivot = &pivot;
    }
    bool is_new = true;
    for (int pass = 0; pass < 2; pass++) {
      for (int e = pass == 0 ? 0 : c; e < d->ncon && is_new; e++) {
        const int side = SideOf(m, d->contact[e], body.instance());
        if (side == 0 || !IsSameObject(object, OtherOf(m, d->contact[e], side))) continue;
        if (e < c) is_new = false;
        if (!is_new) break;
        mjtNum wrench[6];  // on the second geom, in the contact's frame
        mj_contactForce(m, d, e, wrench);
        const Mat3 frame = ToMat3(d->contact[e].frame);
        const Vec3 force = side * MulT(frame, ToVec3(wrench));
        const Vec3 place = ToVec3(d->contact[e].pos);
        if (pass == 0) {
          load.normal += wrench[0];
          load.force = load.force + force;
          load.centre = load.centre + wrench[0] * place;
        } else {
          load.torque = load.torque + side * MulT(frame, ToVec3(wrench + 3)) + Cross(place - load.centre, force);
          if (load.pivot)
            load.moment = load.moment + side * wrench[0] * Cross(place - pivot, ToVec3(d->contact[e].frame));
        }
      }
      if (pass == 0 && load.normal > 0) load.centre = (1 / load.normal) * load.centre;
    }
    if (is_new && load.normal > mjMINVAL) Spread(m, d, body, load);
  }
}

void Taxels::Spread(const mjModel* m, mjData* d, const SoftBody& body, const Load& load) {
  Fit fit;
  if (!FitAround(load.centre, &fit)) return;
  for (size_t i = 0; i < near_.size(); i++) {
    const Vec3 p = fit(rest_[near_[i]]);
    for (int c = 0; c < 3; c++) fitted_[c * near_.size() + i] = p[c];
  }
  FindGaps(m, d, body, load);
  std::sort(near_.begin(), near_.end(),
            [this](int32_t a, int32_t b) { return gap_[a] < gap_[b] || (gap_[a] == gap_[b] && a < b); });
  const std::vector<double>& factors = body.scaling().stiffness;
  const double factor = factors[std::min<size_t>(factor_, factors.size() - 1)];
  Share(load, fit, Bear(d, load, softness_ / factor));
}

// Finds the places that face the same way as the one nearest to the contacts, and x̂ of them. False where no taxel does.
bool Taxels::FitAround(const Vec3& centre, Fit* fit) {
  const auto square = [&](const Vec3& p) { return Dot(p - centre, p - centre); };
  size_t nearest = 0;
  for (size_t t = 1; t < x_.size(); t++) {
    if (square(x_[t]) < square(x_[nearest])) nearest = t;
  }
  near_.clear();
  double total = 0;
  Vec3 q{}, x{};
  const auto share = [&](int32_t t) {
    return std::exp(-square(x_[t]) / (2 * kFitWidth * kFitWidth * thickness_ * thickness_)) + mjMINVAL;
  };
  for (size_t t = 0; t < x_.size(); t++) {
    if (!(Dot(normal_[t], normal_[nearest]) > kFacing)) continue;
    near_.push_back(static_cast<int32_t>(t));
    const double weight = share(near_.back());
    total += weight;
    q = q + weight * rest_[t];
    x = x + weight * x_[t];
  }
  if (near_[0] >= static_cast<int32_t>(area_.size())) return false;
  *fit = {(1 / total) * q, (1 / total) * x, {}, {}};
  mjtNum moment[9] = {}, size[3], vector[9], turn[4];
  Mat3 mixed{};  // Σ (x − x̄) (p̄ − q̄)ᵀ
  for (const int32_t t : near_) {
    const Vec3 away = rest_[t] - fit->rest, now = share(t) * (x_[t] - fit->place);
    const double weight = share(t);
    for (int e = 0; e < 9; e++) {
      moment[e] += weight * away[e / 3] * away[e % 3];
      mixed[e] += now[e / 3] * away[e % 3];
    }
  }
  mju_eig3(size, vector, turn, moment);
  if (!(size[1] > kFlatFit * size[0])) {  // on a line: as it stands
    fit->axis = fit->image = {Vec3{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    return true;
  }
  for (int i = 0; i < 2; i++) {
    fit->axis[i] = {vector[i], vector[3 + i], vector[6 + i]};
    fit->image[i] = (1 / size[i]) * Mul(mixed, fit->axis[i]);
  }
  fit->axis[2] = Cross(fit->axis[0], fit->axis[1]);
  fit->image[2] = Fit::Unit(Cross(fit->image[0], fit->image[1]));
  return true;
}

void Taxels::FindGaps(const mjModel* m, const mjData* d, const SoftBody& body, const Load& load) {
  const int count = static_cast<int>(near_.size());
  const auto place = [&](int i) { return Vec3{fitted_[i], fitted_[count + i], fitted_[2 * count + i]}; };
  if (load.other >= 0) {
    const SoftContact& other = GetSoftBody(d, load.other)->contact();
    const std::lock_guard lock(other.state()->mutex);
    const Placed soft = mjframes::Place(other, other.FindPatch(load.geom), d, 0);
    for (int i = 0; i < count; i++) {
      Vec3 xi, normal;
      double gap;
      const bool near = other.model().has_volume && soft.Distance(place(i), &xi, &gap, &normal);
      gap_[near_[i]] = near ? gap : mjMAXVAL;
      if (load.pivot) lever_[near_[i]] = near ? Cross(place(i) - *load.pivot, normal) : Vec3{};
    }
    return;
  }
  if (load.geom >= 0) {
    const GeomQuery query(m, d, body.contact().meshes(), load.geom, kFitWidth * thickness_);
    if (query.valid) {
      query.Distances(fitted_.data(), count, 0, count, f_.data());
      for (int i = 0; i < count; i++) {
        gap_[near_[i]] = f_[i];
        if (load.pivot) lever_[near_[i]] = Cross(place(i) - *load.pivot, query.Normal(place(i)));
      }
      return;
    }
  }
  // a flex: how far its contacts are
  for (int i = 0; i < count; i++) {
    double least = mjMAXVAL;
    for (int c = load.first; c < d->ncon; c++) {
      const int side = SideOf(m, d->contact[c], body.instance());
      if (side == 0 || OtherOf(m, d->contact[c], side)[0] >= 0) continue;
      least = std::min(least, Norm(place(i) - ToVec3(d->contact[c].pos)));
    }
    gap_[near_[i]] = least;
  }
}

// K of two places.
double Taxels::Response(int t, int s) const {
  const Vec3 away = rest_[t] - rest_[s];
  const double at = std::sqrt(Dot(away, away) + widened_[t] + widened_[s]) / step_;
  const auto i = static_cast<size_t>(at);
  if (i + 1 >= kernel_.size()) return 0;
  return kernel_[i] + (at - static_cast<double>(i)) * (kernel_[i + 1] - kernel_[i]);
}

// How many of the nearest places may bear a load, if they were a disc: it gives way by 2 β² load / radius.
int Taxels::Likely(double load, double softness) const {
  const int count = static_cast<int>(near_.size());
  for (int k = 1; k < count; k++) {
    const double radius = std::sqrt(k * mean_area_ / mjPI);
    if (gap_[near_[k]] - gap_[near_[0]] > 2 * softness * load / radius) return k;
  }
  return count;
}

// Fills in f of the nearest places, as many as may bear something; returns how many.
int Taxels::Bear(mjData* d, const Load& load, double softness) {
  const int count = static_cast<int>(near_.size());
  int k = Likely(load.normal, softness);
  const double turn = load.pivot ? kTurn * softness / std::pow(k * mean_area_ / mjPI, 1.5) : 0;
  while (true) {
    const size_t numbers = static_cast<size_t>(k) * k + 5 * static_cast<size_t>(k);
    if (!HasRoom(d, numbers)) break;
    MarkStack(d);
    double* C = mj_stackAllocNum(d, static_cast<size_t>(k) * k);
    double *gap = mj_stackAllocNum(d, k), *work = mj_stackAllocNum(d, 4 * static_cast<size_t>(k));
    for (int i = 0; i < k; i++) {
      const int t = near_[i];
      gap[i] = gap_[t] - (turn > 0 ? turn * Dot(lever_[t], load.moment) : 0);
      for (int j = 0; j <= i; j++) {
        const int s = near_[j];
        C[i * k + j] = C[j * k + i] = softness * Response(t, s) + (turn > 0 ? turn * Dot(lever_[t], lever_[s]) : 0);
      }
    }
    const double approach = Press(C, gap, k, load.normal, f_.data(), work);
    FreeStack(d);
    Vec3 amiss = -1 * load.moment;
    for (int i = 0; turn > 0 && i < k; i++) amiss = amiss + f_[i] * lever_[near_[i]];
    int more = k;
    while (more < count && gap_[near_[more]] + (turn > 0 ? turn * Dot(lever_[near_[more]], amiss) : 0) < approach)
      more++;
    if (more == k) return k;
    k = more;
  }
  if (!told_memory_) {
    mju_warning("mjframes: the memory of mjData is too small for taxels of which %d bear: give <size memory> more.", k);
    told_memory_ = true;
  }
  std::fill_n(f_.begin(), k, load.normal / k);
  return k;
}

// Adds what the first places bear to the taxels among them.
void Taxels::Share(const Load& load, const Fit& fit, int bearing) {
  Vec3 pressed{}, centre{}, mean{};
  for (int i = 0; i < bearing; i++) {
    const Vec3 normal = fit.Normal(normal_[near_[i]]);
    pressed = pressed - f_[i] * normal;
    centre = centre + (f_[i] / load.normal) * fit(rest_[near_[i]]);
  }
  mean = Fit::Unit(pressed);
  double inertia = 0;
  for (int i = 0; i < bearing; i++) {
    const Vec3 lever = Cross(mean, fit(rest_[near_[i]]) - centre);
    inertia += f_[i] * Dot(lever, lever);
  }
  const double twist = inertia > mjMINVAL ? Dot(load.torque, mean) / inertia : 0;
  for (int i = 0; i < bearing; i++) {
    const int t = near_[i];
    if (f_[i] == 0 || t >= static_cast<int>(area_.size())) continue;
    const Vec3 normal = fit.Normal(normal_[t]);
    const Vec3 rest =
        (f_[i] / load.normal) * (load.force - pressed) + twist * f_[i] * Cross(mean, fit(rest_[t]) - centre);
    const Vec3 force = rest - f_[i] * normal;
    const Vec3 first = fit.Along(along_[t]);
    const Vec3 u = Fit::Unit(first - Dot(first, normal) * normal), v = Cross(normal, u);
    force_[t] = force_[t] + force;
    press_[t] += f_[i];
    local_[t] = local_[t] + (1 / area_[t]) * Vec3{-Dot(force, normal), Dot(force, u), Dot(force, v)};
  }
}

void Taxels::StoreForces(mjtNum* out) const {
  for (const Vec3& force : force_) out = std::copy(force.begin(), force.end(), out);
}

void Taxels::StorePressures(mjtNum* out) const {
  for (const Vec3& local : local_) *out++ = local[0];
}

void Taxels::StoreTractions(mjtNum* out) const {
  for (const Vec3& local : local_) out = std::copy(local.begin(), local.end(), out);
}

void Taxels::StoreResultant(mjtNum* out) const {
  Vec3 sum{};
  for (const Vec3& force : force_) sum = sum + force;
  std::copy(sum.begin(), sum.end(), out);
}

void Taxels::StoreCentre(mjtNum* out) const {
  Vec3 pressed{}, middle{};
  double total = 0;
  for (size_t t = 0; t < area_.size(); t++) {
    total += press_[t];
    pressed = pressed + press_[t] * x_[t];
    middle = middle + (1.0 / static_cast<double>(area_.size())) * x_[t];
  }
  const Vec3 centre = total > 0 ? (1 / total) * pressed : middle;
  std::copy(centre.begin(), centre.end(), out);
}

}  // namespace mjframes
