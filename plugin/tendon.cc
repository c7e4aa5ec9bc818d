#include "tendon.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>
#include <utility>

#include "constants.h"
#include "interned.h"
#include "plugin.h"
#include "simd.h"
#include "world.h"

namespace mjframes {
namespace {

int g_slot = -1;  // of this plugin in MuJoCo's registry; written once, at load

constexpr const char* kAttributes[] = {
    "quantity",      // volume or length
    "weight_size",   // how many control points move each point                    (n)
    "weight_point",  // which                                                      (Σ)
    "weight",        // W_j                                                        (Σ)
    "offset",        // left out where it is zero                              (n × 3)
    "pair",          // control points, left out for none                          (t × 2)
    "pair_slope",    // c_ij                                                       (t)
    "pair_growth",   // of a volume: b_ij, left out where all are 0                (t)
    "triangle",      // of a volume: three points each, counter-clockwise seen from outside the chamber  (t × 3)
    "scale",         // of a volume: s, left out where it is 1
    "rest_volume",   // with it: V̄ [m³]
    "stop",          // of a length: points; −1 is the next of the tendon's sites  (s)
    "share",         // of a length: of each part between stops, left out where all are 1  (s − 1)
    "gas",           // of a volume: absolute pressure at rest of what is sealed in [Pa]; left out for none
    "ambient",       // with it: pressure around [Pa]
    "exponent",      // with it: γ of p Vᵞ
};

}  // namespace

std::unique_ptr<const TendonModel> TendonModel::Read(const std::vector<Vec3>& rest, Reader* reader) {
  auto model = std::make_unique<TendonModel>();
  const auto pair = reader->Has("pair") ? reader->Array<int32_t>("pair") : std::vector<int32_t>();
  const auto slope = reader->ArrayOr<double>("pair_slope", 0, pair.size() / 2);
  const auto growth = reader->ArrayOr<double>("pair_growth", 0, slope.size());
  model->points.Read(static_cast<int>(rest.size()), pair, reader);
  if (!reader->ok()) return nullptr;
  const std::vector<int32_t>& order = model->points.point;
  const auto place = [&order](int32_t j) {
    return static_cast<int32_t>(std::lower_bound(order.begin(), order.end(), j) - order.begin());
  };
  for (size_t t = 0; t < slope.size(); t++) {
    const int32_t i = pair[2 * t], j = pair[2 * t + 1];
    model->pairs.push_back({place(i), place(j), slope[t], growth[t], Norm(rest[i] - rest[j])});
  }
  const int points = model->points.size;
  const std::string quantity = reader->Text("quantity");
  const auto known = [points](int32_t n) { return n < points; };
  if (quantity == "volume") {
    model->triangle = reader->Array<int32_t>("triangle");
    const std::vector<int32_t>& corner = model->triangle;
    reader->Check(!corner.empty() && corner.size() % 3 == 0 && std::all_of(corner.begin(), corner.end(), known) &&
                      *std::min_element(corner.begin(), corner.end()) >= 0,
                  "its triangles are not of its points");
    if (reader->Has("scale")) {
      model->scale = reader->Number("scale");
      model->rest_volume = reader->Number("rest_volume");
    }
    model->grows = reader->Has("pair_growth");
    reader->Check(!model->grows || reader->Has("scale"), "pair_growth needs scale and rest_volume");
  } else if (reader->Check(quantity == "length", "quantity has to be 'volume' or 'length'")) {
    model->stop = reader->Array<int32_t>("stop");
    reader->Check(model->stop.size() > 1 && std::all_of(model->stop.begin(), model->stop.end(), known),
                  "its path has less than two stops, or points that it does not have");
    if (reader->Has("share")) model->share = reader->ArrayOr<double>("share", 1, model->stop.size() - 1);
  }
  return reader->ok() ? std::move(model) : nullptr;
}

// The tendon is found by its name, the soft body by the geom.
std::unique_ptr<Tendon> Tendon::Create(const mjModel* m, int instance) {
  Reader reader(m, instance);
  const char* name = m->names + m->name_pluginadr[instance];
  const int tendon = mj_name2id(m, mjOBJ_TENDON, name);
  const auto geom = std::find(m->geom_plugin, m->geom_plugin + m->ngeom, instance) - m->geom_plugin;
  const int soft = geom < m->ngeom ? m->body_plugin[m->geom_bodyid[geom]] : -1;
  bool collides = false;
  for (int i = 0; i < m->npair; i++) collides = collides || m->pair_geom1[i] == geom || m->pair_geom2[i] == geom;
  reader.Check(tendon >= 0, "there is no tendon of that name");
  reader.Check(IsSoftBody(m, soft) && collides, "its geom is not on a soft body, or has no contact pair");
  std::unique_ptr<Tendon> made;
  if (reader.ok()) {
    Reader other(m, soft);  // the soft body itself may not exist yet
    const auto values = other.Array<double>("point_rest");
    std::vector<Vec3> rest(std::min(values.size() / 3, other.Array<double>("point_mass").size()));
    for (size_t k = 0; k < rest.size(); k++) rest[k] = ToVec3(values.data() + 3 * k);
    Key key;
    key.Add(rest.data(), rest.size());
    for (const char* attribute : kAttributes) key.Add(reader.Text(attribute), std::strlen(reader.Text(attribute)));
    auto model = Interned<TendonModel>(key.text(), [&] { return TendonModel::Read(rest, &reader); });
    if (model) made.reset(new Tendon(tendon, soft, std::move(model)));
    if (made) {
      reader.Check(made->FindStops(m) && made->FindLinks(m, &other),
                   "its path in MuJoCo is another one than was written");
      made->ReadGas(rest, &reader);
    }
  }
  if (reader.ok()) return made;
  mju_warning("mjframes: tendon '%s': %s; attach its soft body again.", name, reader.error().c_str());
  return nullptr;
}

Tendon::Tendon(int tendon, int soft, std::shared_ptr<const TendonModel> model)
    : tendon_(tendon),
      soft_(soft),
      model_(std::move(model)),
      points_(model_->points),
      x_(model_->points.point.size()),
      force_(x_.size()),
      growth_(model_->grows ? x_.size() : 0) {
  if (model_->triangle.empty()) return;
  corner_.resize(kLanes * static_cast<size_t>(model_->points.padded));
  normal_.resize(corner_.size());
}

// MuJoCo's path: two sites, a pulley, and then in turns the first site and another, first those of the scene.
bool Tendon::FindStops(const mjModel* m) {
  const int end = m->tendon_adr[tendon_] + m->tendon_num[tendon_];
  int wrap = m->tendon_adr[tendon_] + 4;
  for (const int32_t point : model_->stop) {
    stops_.push_back({point, -1, -1});
    if (point >= 0) continue;
    if (wrap >= end || m->wrap_type[wrap] != mjWRAP_SITE) return false;
    stops_.back().site = m->wrap_objid[wrap];
    wrap += 2;
  }
  return true;
}

// p₀ and V₀, from the places of the control points at rest.
void Tendon::ReadGas(const std::vector<Vec3>& rest, Reader* reader) {
  if (!reader->ok() || !reader->Has("gas")) return;
  gas_ = reader->Number("gas");
  ambient_ = reader->Number("ambient");
  exponent_ = reader->Number("exponent");
  if (!reader->Check(!model_->triangle.empty(), "gas has to be in a volume")) return;
  const std::vector<int32_t>& point = model_->points.point;
  for (size_t i = 0; i < point.size(); i++) x_[i] = rest[point[i]] - rest[point[0]];
  points_.Place(x_, kIdentity);
  rest_volume_ = Volume();
  reader->Check(rest_volume_ > 0, "its volume at rest is not positive");
}

// All bodies with joints at and above what it passes. False where MuJoCo's row has not their degrees of freedom.
bool Tendon::FindLinks(const mjModel* m, Reader* soft) {
  const auto carried = soft->Array<int32_t>("carrier_size");
  const auto order = soft->Array<int32_t>("carrier_point");
  std::vector<int> body_of(soft->Array<double>("point_mass").size(), 0);
  size_t carrier = 0, next = 0;
  int holder = 0;
  for (int body = m->nbody - 1; body > 0; body--) {  // the outermost of its bodies with joints hangs on the holder
    if (m->body_plugin[body] == soft_ && m->body_jntnum[body] > 0) holder = m->body_parentid[body];
  }
  for (int body = 1; body < m->nbody && carrier < carried.size(); body++) {
    if (m->body_plugin[body] != soft_) continue;
    for (int32_t i = 0; i < carried[carrier] && next < order.size(); i++, next++) {
      if (order[next] >= 0 && order[next] < static_cast<int32_t>(body_of.size())) body_of[order[next]] = body;
    }
    carrier++;
  }
  std::vector<char> pulled(m->nbody, 0);
  const auto pull = [&](int body) {
    for (; body > 0; body = m->body_parentid[body]) pulled[body] = 1;
  };
  for (const int32_t j : model_->points.point) pull(body_of[j]);
  for (const Stop& stop : stops_) {
    if (stop.site >= 0) pull(m->site_bodyid[stop.site]);
  }
  if (!model_->points.offset.empty()) pull(holder);
  const int *column = m->ten_J_colind + m->ten_J_rowadr[tendon_], columns = m->ten_J_rownnz[tendon_];
  for (int body = 1; body < m->nbody; body++) {
    if (!pulled[body] || m->body_dofnum[body] == 0) continue;
    if (std::find(column, column + columns, m->body_dofadr[body]) == column + columns) return false;
    links_.push_back({body, LinkOf(m, m->body_parentid[body])});
  }
  for (const int32_t j : model_->points.point) point_link_.push_back(LinkOf(m, body_of[j]));
  for (Stop& stop : stops_) stop.link = stop.site < 0 ? -1 : LinkOf(m, m->site_bodyid[stop.site]);
  for (int c = 0; c < columns; c++) {
    const int body = m->dof_bodyid[column[c]], link = LinkOf(m, body);
    column_link_.push_back(pulled[body] ? link : -1);
  }
  CountPaths(m);
  holder_ = LinkOf(m, holder);
  wrench_.resize(links_.size());
  return true;
}

void Tendon::CountPaths(const mjModel* m) {
  const int *column = m->ten_J_colind + m->ten_J_rowadr[tendon_], columns = m->ten_J_rownnz[tendon_];
  paths_.assign(columns, 0);
  for (int c = columns - 1; c >= 0; c--) {
    if (paths_[c] == 0) {  // a leaf
      paths_[c] = 1;
      all_paths_++;
    }
    const int* above = std::find(column, column + columns, m->dof_parentid[column[c]]);
    if (above != column + columns) paths_[above - column] += paths_[c];
  }
}

int Tendon::LinkOf(const mjModel* m, int body) const {
  for (; body > 0; body = m->body_parentid[body]) {
    const auto found = std::find_if(links_.begin(), links_.end(), [=](const Link& link) { return link.body == body; });
    if (found != links_.end()) return static_cast<int>(found - links_.begin());
  }
  return -1;
}

void Tendon::Measure(const mjModel* m, mjData* d) {
  const Kinematics& kinematics = GetSoftBody(d, soft_)->kinematics();
  const std::vector<int32_t>& point = model_->points.point;
  const Mat3 axes = kinematics.Axes(d);
  const Vec3 origin = kinematics.WorldPosition(d, point[0]);  // far from it digits would be lost
  for (size_t i = 0; i < point.size(); i++) x_[i] = kinematics.WorldPosition(d, point[i]) - origin;
  points_.Place(x_, axes);
  std::fill(wrench_.begin(), wrench_.end(), Wrench{});
  d->ten_length[tendon_] = Evaluate(m, d, origin);

  Vec3 torque = points_.Gather(axes, &force_);
  d->ten_length[tendon_] = AddPairs(d->ten_length[tendon_], &torque);
  if (holder_ >= 0) wrench_[holder_].torque = wrench_[holder_].torque + torque;
  for (size_t i = 0; i < point.size(); i++) AddForce(m, d, point_link_[i], x_[i] + origin, force_[i]);
  for (size_t n = links_.size(); n-- > 0;) {
    if (links_[n].parent < 0) continue;
    Wrench& into = wrench_[links_[n].parent];
    into = {into.torque + wrench_[n].torque, into.force + wrench_[n].force};
  }
  mjtNum* row = d->ten_J + m->ten_J_rowadr[tendon_];
  const int* column = m->ten_J_colind + m->ten_J_rowadr[tendon_];
  for (size_t c = 0; c < column_link_.size(); c++) {
    const mjtNum* cdof = d->cdof + 6 * column[c];
    const int link = column_link_[c];
    row[c] = link < 0 ? 0 : Dot(ToVec3(cdof), wrench_[link].torque) + Dot(ToVec3(cdof + 3), wrench_[link].force);
  }
  Draw(m, d, origin);
}

double Tendon::Evaluate(const mjModel* m, const mjData* d, const Vec3& origin) {
  if (!corner_.empty()) return Volume();
  std::fill_n(points_.gradient(), 3 * model_->points.padded, 0.0);
  return Length(m, d, origin);
}

// ∂V/∂p_a is a sixth of the normals, of twice the area, of the triangles at a: what else p_b × p_c has adds up to zero
// around a. V − v is of third degree, so that 3 (V − v) = Σ_a p_a · ∂V/∂p_a.
double Tendon::Volume() {
  const int padded = model_->points.padded;
  double three = 0;
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    const double* p = points_.position();
    double *g = points_.gradient(), *corner = corner_.data(), *normal = normal_.data();
    for (int n = 0; n < padded; n += kLanes) {
      Lanes place[4];
      Transpose4(Load(p + n), Load(p + padded + n), Load(p + 2 * padded + n), Lanes{}, place);
      for (int i = 0; i < kLanes; i++) {
        Store(place[i], corner + kLanes * (n + i));
        Store(Lanes{}, normal + kLanes * (n + i));
      }
    }
    const int32_t *t = model_->triangle.data(), *end = t + model_->triangle.size();
    for (; t < end; t += 3) {
      const Lanes a = Load(corner + kLanes * t[0]);
      const Lanes u = Load(corner + kLanes * t[1]) - a, v = Load(corner + kLanes * t[2]) - a;
      const Lanes turned = u * Pick<1, 2, 0, 3>(v, v) - Pick<1, 2, 0, 3>(u, u) * v;
      const Lanes area = Pick<1, 2, 0, 3>(turned, turned);
      for (int i = 0; i < 3; i++) {
        double* sum = normal + kLanes * t[i];
        Store(Load(sum) + area, sum);
      }
    }
    Lanes sum{};
    for (int n = 0; n < padded; n += kLanes) {
      Lanes slope[4];
      const double* own = normal + kLanes * n;
      Transpose4(Load(own), Load(own + kLanes), Load(own + 2 * kLanes), Load(own + 3 * kLanes), slope);
      for (int r = 0; r < 3; r++) {
        slope[r] *= model_->scale / 6;
        sum += slope[r] * Load(p + r * padded + n);
        Store(slope[r], g + r * padded + n);
      }
    }
    for (int lane = 0; lane < kLanes; lane++) three += sum[lane];
  });
  return three / 3 + (1 - model_->scale) * model_->rest_volume;
}

// What the pairs make of a length ℓ; their forces go to the control points. With B = Σ_ij b_ij (|x_i − x_j| − |x̄_i −
// x̄_j|) and ℓ₀ corrected by c, a chamber's becomes ℓ₀ + (ℓ₀ − ℓ̄) B / √(1 + B²/most²): far from rest, where B says
// nothing, it is bounded.
double Tendon::AddPairs(double length, Vec3* torque) {
  double B = 0;
  std::fill(growth_.begin(), growth_.end(), Vec3{});
  for (const auto& [i, j, slope, growth, rest] : model_->pairs) {
    const Vec3 way = x_[i] - x_[j];
    const double apart = Norm(way);
    length += slope * (apart - rest);
    B += growth * (apart - rest);
    if (!(apart > mjMINVAL)) continue;
    const Vec3 force = (slope / apart) * way;
    force_[i] = force_[i] + force;
    force_[j] = force_[j] - force;
    if (growth_.empty()) continue;
    const Vec3 grown = (growth / apart) * way;
    growth_[i] = growth_[i] + grown;
    growth_[j] = growth_[j] - grown;
  }
  if (growth_.empty()) return length;
  const double bound = 1 / std::sqrt(1 + B * B / (kMostGrowth * kMostGrowth)), change = length - model_->rest_volume;
  for (size_t i = 0; i < force_.size(); i++) {
    force_[i] = (1 + bound * B) * force_[i] + (change * bound * bound * bound) * growth_[i];
  }
  *torque = (1 + bound * B) * *torque;
  return length + change * bound * B;
}

double Tendon::Length(const mjModel* m, const mjData* d, const Vec3& origin) {
  double length = 0;
  const auto pull = [&](const Stop& stop, const Vec3& force) {
    if (stop.point >= 0) return points_.AddGradient(stop.point, force);
    AddForce(m, d, stop.link, ToVec3(d->site_xpos + 3 * stop.site), force);
  };
  const std::vector<double>& shares = model_->share;
  for (size_t k = 1; k < stops_.size(); k++) {
    const double share = shares.empty() ? 1 : shares[k - 1];
    if (share == 0) continue;
    const Vec3 way = Place(d, origin, stops_[k]) - Place(d, origin, stops_[k - 1]);
    const double part = Norm(way);
    if (!(part > mjMINVAL)) continue;
    length += share * part;
    pull(stops_[k], (share / part) * way);
    pull(stops_[k - 1], (-share / part) * way);
  }
  return length;
}

// Where a stop is, from the origin on.
Vec3 Tendon::Place(const mjData* d, const Vec3& origin, const Stop& stop) const {
  return stop.point >= 0 ? points_.Position(stop.point) : ToVec3(d->site_xpos + 3 * stop.site) - origin;
}

void Tendon::AddForce(const mjModel* m, const mjData* d, int link, const Vec3& position, const Vec3& force) {
  if (link < 0) return;
  const Vec3 arm = position - ToVec3(d->subtree_com + 3 * m->body_rootid[links_[link].body]);
  wrench_[link] = {wrench_[link].torque + Cross(arm, force), wrench_[link].force + force};
}

// A fibre through its stops, others not at all, in place of MuJoCo's own path, which has as many places or more.
void Tendon::Draw(const mjModel* m, mjData* d, const Vec3& origin) const {
  const int first = d->ten_wrapadr[tendon_];
  const int count = model_->share.empty() ? std::min<int>(stops_.size(), m->tendon_num[tendon_]) : 0;
  d->ten_wrapnum[tendon_] = count;
  for (int k = 0; k < count; k++) {
    const Vec3 at = Place(d, origin, stops_[k]) + origin;
    std::copy(at.begin(), at.end(), d->wrap_xpos + 3 * (first + k));
    d->wrap_obj[first + k] = -1;
  }
}

// p, and k = γ p / V.
double Tendon::Pressure(const mjData* d, double* k) const {
  const double volume = std::max(d->ten_length[tendon_], kLeastGas * rest_volume_);
  const double pressure = gas_ * std::pow(volume / rest_volume_, -exponent_);
  *k = exponent_ * pressure / volume;
  return pressure;
}

bool Tendon::IsImplicit(const mjData* d) const {
  const SoftBody* body = GetSoftBody(d, soft_);
  return body->model().implicit && (all_paths_ == 1 || !body->kinematics().is_free());
}

void Tendon::AddGas(const mjModel* m, mjData* d) const {
  double k;
  double pressure = Pressure(d, &k) - ambient_;
  if (IsImplicit(d)) pressure -= m->opt.timestep * k * d->ten_velocity[tendon_];
  const int first = m->ten_J_rowadr[tendon_];
  for (int c = first; c < first + m->ten_J_rownnz[tendon_]; c++) {
    d->qfrc_passive[m->ten_J_colind[c]] += pressure * d->ten_J[c];
  }
}

void Tendon::AddGasInertia(const mjModel* m, mjData* d) const {
  if (!IsImplicit(d)) return;
  double k;
  Pressure(d, &k);
  // the step is stable while what is held is 3/4 of the stiffness or more
  const double scale = m->opt.timestep * m->opt.timestep * k * std::max(1.0, 0.75 * all_paths_);
  const int first = m->ten_J_rowadr[tendon_];
  const int* column = m->ten_J_colind + first;
  const mjtNum* J = d->ten_J + first;
  for (int c = 0; c < m->ten_J_rownnz[tendon_]; c++) {
    const int row = m->M_rowadr[column[c]];
    // columns of both ascend, and each degree of freedom above is in both
    for (int e = row, b = 0; e < row + m->M_rownnz[column[c]]; e++) {
      while (column[b] < m->M_colind[e]) b++;
      if (column[b] == m->M_colind[e]) d->M[e] += scale * J[c] * J[b] / paths_[b];
    }
  }
}

// MuJoCo's compiler makes an mjData with these flags set, so that Create cannot refuse them. Without collisions the
// tendon is the placeholder: it keeps its length, and nothing pulls at it.
void Tendon::CheckFlags(const mjModel* m) {
  if (told_ || !(m->opt.disableflags & (mjDSBL_CONTACT | mjDSBL_CONSTRAINT))) return;
  mju_warning(
      "mjframes: tendon '%s' rests: the flag contact or constraint is disabled, and MuJoCo then leaves out the stage "
      "in "
      "which it is measured; enable both, and set contype and conaffinity of geoms that shall not touch to 0.",
      m->names + m->name_tendonadr[tendon_]);
  told_ = true;
}

bool IsTendon(const mjModel* m, int instance) { return m->plugin[instance] == g_slot; }

Tendon* GetTendon(const mjData* d, int instance) {
  return instance >= 0 && d->plugin[instance] == g_slot ? DataOf<Tendon>(d, instance) : nullptr;
}

Tendon* TendonOf(const mjModel* m, const mjData* d, int geom) { return GetTendon(d, m->geom_plugin[geom]); }

int CountOwnTendons(const mjModel* m) {
  int count = m->ntendon;
  for (int instance = 0; instance < m->nplugin; instance++) count -= IsTendon(m, instance);
  return count;
}

void RegisterTendon() {
  mjpPlugin plugin = PluginWith<Tendon>(kTendonName, mjPLUGIN_SDF);
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.compute = +[](const mjModel*, mjData*, int, int) {};
  // nothing is at the geom
  plugin.sdf_distance = +[](const mjtNum*, const mjData*, int) -> mjtNum { return mjMAXVAL; };
  plugin.sdf_gradient = +[](mjtNum gradient[3], const mjtNum*, const mjData*, int) {
    gradient[0] = 1;
    gradient[1] = gradient[2] = 0;
  };
  plugin.sdf_staticdistance = +[](const mjtNum*, const mjtNum*) -> mjtNum { return 1; };
  plugin.sdf_aabb = +[](mjtNum aabb[6], const mjtNum*) { std::fill(aabb, aabb + 6, 1.0); };
  g_slot = mjp_registerPlugin(&plugin);
}

}  // namespace mjframes
