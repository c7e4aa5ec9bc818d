#include "sensor.h"

#include <algorithm>
#include <cstring>
#include <optional>
#include <string>
#include <utility>

#include "plugin.h"
#include "world.h"

namespace mjframes {
namespace {

constexpr const char* kAttributes[] = {
    "quantity",
    "shape",         // of taxels and markers: rows and columns, not read here
    "region",        // of each point                                (n)
    "gradient",      // ∇W_j, region's control points, point by point [1/m]
    "factor",        // which one its material follows; left out for one alone (n)
    "constants",     // λ, μ, 0 or those of the law, point by point  (n × 3)
    "slack",         // left out where it is zero                    (n × 9)
    "lift",          // left out where it is zero; 9 × 3m of each point [1/m]
    "weight_size",   // of positions and velocities: how many control points move each point  (n)
    "weight_point",  // which                                                                 (Σ)
    "weight",        // W_j                                                                   (Σ)
    "offset",        // left out where it is zero [m]                                     (n × 3)
    "rise",          // left out where it is zero; 3 × 3m of each point [-]
    "axes",          // of markers: those in which they move, row by row, in the volume's  (3 × 3)
    "place",         // p̄ of markers; of taxels and contact vertices outside of them [m]   (n × 3)
    "normal",        // of the surface there, at rest                                      (n × 3)
    "along",         // of each taxel: an axis of its shear                                (n × 3)
    "area",          // of each taxel [m²]
    "widened",       // of each place: see taxels.h [m²]
    "vertex",        // of each place behind the taxels: number among the contact vertices
    "kernel",        // K at equal steps [1/m]
    "kernel_step",   // [m]
    "softness",      // β² [1/Pa]
    "thickness",     // of the flesh [m]
};

enum Quantity {
  kElasticEnergy,
  kKineticEnergy,
  kEnergyDensity,
  kStress,
  kStrain,
  kDeformationGradient,
  kPosition,
  kVelocity,
  kMarkers,
  kContactForce,
  kTaxelPressure,
  kTaxelTraction,
  kTaxelForce,
  kResultant,
  kPressureCentre,
  kQuantities
};

// What a quantity is of.
enum Subject { kBody, kPoints, kPlaces, kTaxels, kMap };

struct Kind {
  const char* name;
  int size;  // values of one point or taxel, or of all
  Subject of;
};

constexpr Kind kKinds[kQuantities] = {
    {"elastic_energy", 1, kBody},    // [J]
    {"kinetic_energy", 1, kBody},    // [J]
    {"energy_density", 1, kPoints},  // [J/m³]
    {"stress", 6, kPoints},          // Cauchy's, in the world's axes: xx, yy, zz, yz, xz, xy [Pa]
    {"strain", 6, kPoints},          // Green's, in the volume's axes, in the same order
    {"deformation_gradient", 9, kPoints},
    {"position", 3, kPlaces},      // in the world [m]
    {"velocity", 3, kPlaces},      // in the world [m/s]
    {"markers", 3, kPlaces},       // how far they have moved, in the axes of the map [m]
    {"contact_force", 3, kBody},   // in the world [N]
    {"pressure", 1, kTaxels},      // [Pa]
    {"traction", 3, kTaxels},      // pressure, shear along two axes of the surface [Pa]
    {"taxel_force", 3, kTaxels},   // in the world [N]
    {"resultant", 3, kMap},        // in the world [N]
    {"pressure_centre", 3, kMap},  // in the world [m]
};

int QuantityOf(const char* name) {
  for (int i = 0; i < kQuantities; i++) {
    if (std::strcmp(kKinds[i].name, name) == 0) return i;
  }
  return -1;
}

// Whether the constraint solver has to be done before.
bool NeedsForces(int quantity) { return quantity >= kContactForce; }

// Whether a contact's geom, −1 for a flex, is a patch of the soft body of this instance.
bool IsPatch(const mjModel* m, int instance, int geom) {
  return geom >= 0 && m->geom_plugin[geom] >= 0 && m->body_plugin[m->geom_bodyid[geom]] == instance;
}

// The sum of the contact forces on a soft body, in the world [N]; after the constraint solver.
Vec3 ContactForce(const mjModel* m, const mjData* d, int instance) {
  Vec3 sum{};
  for (int i = 0; i < d->ncon; i++) {
    const mjContact& contact = d->contact[i];
    const int sign = IsPatch(m, instance, contact.geom[1]) - IsPatch(m, instance, contact.geom[0]);
    if (sign == 0) continue;
    mjtNum force[6];  // on the second geom, in the contact's frame
    mj_contactForce(m, d, i, force);
    sum = sum + sign * MulT(ToMat3(contact.frame), ToVec3(force));
  }
  return sum;
}

void StoreSymmetric(const Mat3& a, mjtNum* out) {
  const double values[6] = {a[0], a[4], a[8], a[5], a[2], a[1]};
  std::copy_n(values, 6, out);
}

// ∇W_j of points that are the columns of F, and of one at 0: F = Σ_j x_j ∇W_jᵀ.
constexpr double kOfColumns[12] = {1, 0, 0, 0, 1, 0, 0, 0, 1, -1, -1, -1};

// The only sensor of the instance, −1 if there is none or more than one.
int SensorOf(const mjModel* m, int instance) {
  int found = -1;
  for (int i = 0; i < m->nsensor; i++) {
    if (m->sensor_plugin[i] != instance) continue;
    if (found >= 0) return -1;
    found = i;
  }
  return found;
}

}  // namespace

int Sensor::Size(const mjModel* m, int instance) {
  Reader reader(m, instance);
  const int quantity = QuantityOf(reader.Text("quantity"));
  if (quantity < 0) return 0;
  const Subject of = kKinds[quantity].of;
  if (of == kBody || of == kMap) return kKinds[quantity].size;
  const size_t points = of == kTaxels ? reader.Array<double>("area").size() : reader.Array<int32_t>("region").size();
  return reader.ok() ? static_cast<int>(points) * kKinds[quantity].size : 0;
}

std::unique_ptr<Sensor> Sensor::Create(const mjModel* m, int instance) {
  Reader reader(m, instance);
  std::unique_ptr<Sensor> sensor(new Sensor());
  sensor->instance_ = instance;
  sensor->quantity_ = QuantityOf(reader.Text("quantity"));
  reader.Check(sensor->quantity_ >= 0,
               "quantity has to be 'elastic_energy', 'kinetic_energy', 'energy_density', 'stress', 'strain', "
               "'deformation_gradient', 'position', 'velocity', 'markers', 'contact_force', 'pressure', 'traction', "
               "'taxel_force', 'resultant' or 'pressure_centre'");
  const int id = SensorOf(m, instance);
  if (reader.Check(id >= 0, "its instance has to belong to one sensor")) {
    sensor->address_ = m->sensor_adr[id];
    sensor->soft_ = m->sensor_objtype[id] == mjOBJ_BODY ? SoftBodyHeldBy(m, m->sensor_objid[id]) : -1;
    reader.Check(sensor->soft_ >= 0, "objtype has to be 'body' and objname that of a soft body");
    reader.Check(NeedsForces(sensor->quantity_) == (m->sensor_needstage[id] == mjSTAGE_ACC),
                 "contact_force and the quantities of taxels are of the plugin mjframes.force_sensor, the others are "
                 "of mjframes.sensor");
  }
  if (reader.ok()) sensor->Read(m, &reader);
  if (reader.ok() && m->sensor_dim[id] != Size(m, instance)) reader.Fail("its number of values is another one");
  if (!reader.ok()) {
    const char* name = id >= 0 ? m->names + m->name_sensoradr[id] : m->names + m->name_pluginadr[instance];
    mju_warning("mjframes: sensor '%s': %s.", name, reader.error().c_str());
    return nullptr;
  }
  return sensor;
}

void Sensor::Read(const mjModel* m, Reader* reader) {
  Reader soft(m, soft_);
  const Subject of = kKinds[quantity_].of;
  if (of == kPoints) ReadSamples(m, reader);
  if (of == kPlaces) places_.Read(&soft, reader);
  if (of == kTaxels || of == kMap) {
    taxels_ = std::make_unique<Taxels>();
    taxels_->Read(&soft, reader);
  }
  if (quantity_ != kMarkers) return;
  marker_rest_ = reader->Array<double>("place");
  const auto axes = reader->Array<double>("axes");
  const bool fits = axes.size() == 9 && static_cast<int>(marker_rest_.size()) == Size(m, instance_);
  if (reader->Check(fits, "its markers are not those of the soft body: write the sensor again")) {
    std::copy_n(axes.begin(), 9, marker_axes_.begin());
  }
}

void Sensor::ReadSamples(const mjModel* m, Reader* reader) {
  // the soft body itself may not exist yet
  Reader soft(m, soft_);
  const std::optional<Law> law = LawOfName(soft.Text("law"));
  const auto size = soft.Array<int32_t>("region_size");
  const auto point = soft.Array<int32_t>("region_point");
  const auto region = reader->Array<int32_t>("region");
  const auto gradient = reader->Array<double>("gradient");
  const auto constants = reader->Array<double>("constants");
  const auto factor = reader->ArrayOr<int32_t>("factor", 0, region.size());
  const auto slack = reader->ArrayOr<double>("slack", 0, 9 * region.size());
  const auto lift = reader->ArrayOr<double>("lift", 0, 9 * gradient.size());
  constexpr char kMismatch[] = "its points are not those of the soft body: write the sensor again";
  const bool turns = !reader->Has("lift") || !soft.Has("quadrature_count");
  if (!reader->Check(turns && soft.ok() && constants.size() == kLawConstants * region.size(), kMismatch)) return;
  std::vector<size_t> first = {0};
  for (const int32_t count : size) first.push_back(first.back() + std::max(count, 0));
  if (!reader->Check(first.back() == point.size(), kMismatch)) return;
  size_t g = 0;
  for (size_t n = 0; n < region.size(); n++) {
    const int32_t e = region[n];
    if (!reader->Check(e >= 0 && e < static_cast<int32_t>(size.size()), kMismatch)) return;
    Sample sample = {e, {point.begin() + first[e], point.begin() + first[e + 1]}, {}, {}, {}, 0, 0, factor[n]};
    const size_t end = g + 3 * sample.point.size();
    if (!reader->Check(end <= gradient.size() && 9 * end <= lift.size(), kMismatch)) return;
    if (!law || reader->Has("lift")) sample.lift.assign(lift.begin() + 9 * g, lift.begin() + 9 * end);
    const double* own = constants.data() + kLawConstants * n;
    if (law) {
      const double volume = 1;
      const LawParameters parameters = ParametersOf(*law, own);
      quadrature_.emplace_back(*law, std::vector<int32_t>{0, 1, 2, 3}, kOfColumns, &volume, &parameters, 1,
                               std::vector<int32_t>(), std::vector<int32_t>());
    }
    sample.lam = own[0];
    sample.mu = own[1];
    std::copy_n(slack.begin() + 9 * n, 9, sample.slack.begin());
    for (size_t j = 0; j < sample.point.size(); j++, g += 3) {
      sample.gradient.push_back({gradient[g], gradient[g + 1], gradient[g + 2]});
    }
    samples_.push_back(std::move(sample));
  }
  reader->Check(g == gradient.size(), kMismatch);
  scratch_ = std::make_unique<QuadratureScratch>(quadrature_);
}

// In the soft body's own axes.
PointState Sensor::StateOf(const SoftBody& body, const std::vector<Mat3>& rotation, size_t n) {
  const std::vector<Vec3>& x = body.kinematics().x();
  const Sample& sample = samples_[n];
  const int m = static_cast<int>(sample.point.size());
  PointState state{};
  Vec3 mean{};
  for (const int32_t j : sample.point) mean = mean + (1.0 / m) * x[j];
  state.F = sample.slack;
  for (int j = 0; j < m; j++) {
    const Vec3 arm = x[sample.point[j]] - mean;
    for (int e = 0; e < 9; e++) state.F[e] += arm[e / 3] * sample.gradient[j][e % 3];
  }
  if (sample.lift.empty()) {
    AddLawState(n, state.F, &state);
    return state;
  }
  const Region& region = body.elasticity().FindRegion(sample.region);
  const Mat3 R = rotation[sample.region];
  Mat3 slope{}, lifted{};
  for (int j = 0; j < m; j++) {
    const Vec3 y = MulT(R, x[sample.point[j]] - mean) - region.rest[j];
    const double* lift = sample.lift.data() + 3 * j;
    for (int e = 0; e < 9; e++, lift += 3 * m) {
      slope[e] += y[e / 3] * sample.gradient[j][e % 3];
      lifted[e] += lift[0] * y[0] + lift[1] * y[1] + lift[2] * y[2];
    }
  }
  const Mat3 turned = Mul(R, lifted);
  for (int e = 0; e < 9; e++) {
    state.F[e] += turned[e];
    slope[e] += lifted[e];
  }
  if (quadrature_.empty()) {
    AddHookeState(sample, R, slope, &state);
  } else {
    for (int e = 0; e < 9; e++) slope[e] += kIdentity[e];
    AddLawState(n, Mul(R, slope), &state);
  }
  return state;
}

// Stress and energy of the corotational law where a region turned by R has these slopes.
void Sensor::AddHookeState(const Sample& sample, const Mat3& R, const Mat3& slope, PointState* state) {
  Mat3 stress;
  double square = 0;
  const double trace = slope[0] + slope[4] + slope[8];
  for (int e = 0; e < 9; e++) {
    const double strain = 0.5 * (slope[e] + slope[3 * (e % 3) + e / 3]);
    square += strain * strain;
    stress[e] = 2 * sample.mu * strain + (e % 4 == 0 ? sample.lam * trace : 0);
  }
  state->energy = 0.5 * sample.lam * trace * trace + sample.mu * square;
  state->cauchy = Mul(Mul(R, stress), Transpose(R));
}

// Stress and energy of the law of sample n at F.
void Sensor::AddLawState(size_t n, const Mat3& F, PointState* state) {
  const Vec3 columns[4] = {{F[0], F[3], F[6]}, {F[1], F[4], F[7]}, {F[2], F[5], F[8]}, {}};
  PointState found;
  QuadratureStates(quadrature_[n], columns, scratch_.get(), &found);
  state->energy = found.energy;
  state->cauchy = found.cauchy;
}

void Sensor::Compute(const mjModel* m, mjData* d) {
  mjtNum* out = d->sensordata + address_;
  SoftBody* body = GetSoftBody(d, soft_);
  const bool of_contacts = taxels_ || quantity_ == kContactForce;
  if (of_contacts && body->kinematics().Asleep(m, d)) return;  // its contacts have no rows: the last values stay
  if (quantity_ == kContactForce) {
    const Vec3 force = ContactForce(m, d, soft_);
    std::copy(force.begin(), force.end(), out);
    return;
  }
  body->Locate(m, d);
  if (taxels_) return StoreTaxels(m, d, *body, out);
  if (quantity_ == kPosition) places_.StorePositions(body, d, out);
  if (quantity_ == kMarkers) StoreMarkers(body, d, out);
  if (quantity_ == kVelocity) places_.StoreVelocities(body, m, d, out);
  if (quantity_ == kElasticEnergy) *out = body->ElasticEnergy();
  if (quantity_ == kKineticEnergy) *out = body->KineticEnergy(m, d);
  const Mat3 axes = body->kinematics().Axes(d);
  const std::vector<double>& factors = body->scaling().stiffness;
  const std::vector<Mat3>* rotation = samples_.empty() ? nullptr : &body->RegionRotations();
  for (size_t n = 0; n < samples_.size(); n++, out += kKinds[quantity_].size) {
    PointState state = StateOf(*body, *rotation, n);
    const double factor = factors[std::clamp<int>(samples_[n].factor, 0, static_cast<int>(factors.size()) - 1)];
    state.energy *= factor;
    for (double& stress : state.cauchy) stress *= factor;
    if (quantity_ == kEnergyDensity) *out = state.energy;
    if (quantity_ == kStress) StoreSymmetric(Mul(Mul(axes, state.cauchy), Transpose(axes)), out);
    if (quantity_ == kStrain) {
      Mat3 strain = Mul(Transpose(state.F), state.F);
      for (int e = 0; e < 9; e++) strain[e] = 0.5 * (strain[e] - kIdentity[e]);
      StoreSymmetric(strain, out);
    }
    if (quantity_ == kDeformationGradient) {
      const Mat3 F = Mul(axes, state.F);
      std::copy(F.begin(), F.end(), out);
    }
  }
}

void Sensor::StoreTaxels(const mjModel* m, mjData* d, const SoftBody& body, mjtNum* out) {
  taxels_->Compute(m, d, body);
  if (quantity_ == kTaxelPressure) taxels_->StorePressures(out);
  if (quantity_ == kTaxelTraction) taxels_->StoreTractions(out);
  if (quantity_ == kTaxelForce) taxels_->StoreForces(out);
  if (quantity_ == kResultant) taxels_->StoreResultant(out);
  if (quantity_ == kPressureCentre) taxels_->StoreCentre(out);
}

// How far the markers are from their places at rest, as seen from what the soft body hangs on.
void Sensor::StoreMarkers(SoftBody* body, const mjData* d, mjtNum* out) const {
  places_.StorePositions(body, d, out);
  for (size_t n = 0; n < marker_rest_.size(); n += 3) {
    const Vec3 now = body->kinematics().PositionToLocal(d, ToVec3(out + n));
    const Vec3 moved = Mul(marker_axes_, now - ToVec3(marker_rest_.data() + n));
    std::copy(moved.begin(), moved.end(), out + n);
  }
}

void RegisterSensor() {
  // the velocity stage knows positions and velocities, the acceleration stage contact forces as well
  for (const auto& [name, stage] : {std::pair{kSensorName, mjSTAGE_VEL}, std::pair{kForceSensorName, mjSTAGE_ACC}}) {
    mjpPlugin plugin = PluginWith<Sensor>(name, mjPLUGIN_SENSOR);
    plugin.needstage = stage;
    plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
    plugin.attributes = kAttributes;
    plugin.nsensordata = +[](const mjModel* m, int instance, int) { return Sensor::Size(m, instance); };
    plugin.compute =
        +[](const mjModel* m, mjData* d, int instance, int) { DataOf<Sensor>(d, instance)->Compute(m, d); };
    mjp_registerPlugin(&plugin);
  }
}

}  // namespace mjframes
