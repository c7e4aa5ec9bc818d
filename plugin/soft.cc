#include "soft.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>

#include "multiversion.h"
#include "options.h"
#include "patch_field.h"
#include "reader.h"

namespace mjframes {
namespace {

constexpr char kVersion[] = "3";  // of the configuration; a model written by another version is refused

constexpr double kSameMass = 1e-4;  // [-] of a body's mass: the model's masses have six digits

constexpr const char* kAttributes[] = {
    "version",  //
    "law",
    "mode",
    "alpha",
    "beta",
    "carrier_size",   // number of points that ride on each of the instance's bodies
    "carrier_point",  // which ones, body by body    (k)
    "point_offset",   // in the body's axes [m]      (k × 3)
    "point_rest",     // [m]                         (k × 3)
    "point_mass",     // [kg]                        (k)
    "point_branch",   // of the tree                 (k)
    "region_size",
    "region_point",
    "region_gradient",
    "region_fallback",
    "frame_size",
    "frame_gradient",  // of each frame's own points [1/m]  (k × 3)
    "region_stiffness",
    "law_constants",      // of each material            (materials × 3)
    "quadrature_count",   // of each region
    "quadrature_volume",  // [m³]
    "quadrature_material",
    "quadrature_gradient",  // ∇W_j, point by point [1/m]
    "cell_count",           // of each region
    "cell_volume",          // [m³]
    "cell_material",
    "cell_slope",   // E_q, cell by cell [1/m]
    "region_mass",  // consistent minus lumped mass, lower triangles [kg]
    "region_enlargement",
    "contact_radius",  // [m]
    "patch_size",
    "patch_clusters",
    "patch_cluster_size",
    "patch_point",
    "patch_weight",
    "patch_offset",     // s − Σ_j W_j(s) x̄_j [m]; left out where it is zero
    "lattice_spacing",  // [m]
    "lattice_axes",
    "lattice_origin",
    "lattice_shape",
    "lattice_node",
    "lattice_distance",
    "lattice_patch",
    "lattice_count",
    "lattice_point",
    "lattice_weight",
    "lattice_sphere",
    "asset",  // which built body it is: views of material points ask for its voxels
};

int g_slot = -1;  // of this plugin in MuJoCo's registry; written once, at load

// The control points of each region, and the pairs that their blocks belong to.
struct Coupling {
  std::vector<int32_t> point;  // ancestors first  (m)
  std::vector<int32_t> pair;   // (j, k ≤ j)       (m(m+1)/2)
};

std::vector<Coupling> ReadCouplings(Kinematics* kinematics, std::vector<double>* mass_difference, Reader* reader) {
  const auto size = reader->Array<int32_t>("region_size");
  const auto point = reader->Array<int32_t>("region_point");
  std::vector<double> difference;
  if (reader->Has("region_mass")) difference = reader->Array<double>("region_mass");
  const int points = static_cast<int>(kinematics->points().size());
  size_t p = 0, block = 0;
  std::vector<Coupling> couplings;
  for (const int32_t m : size) {
    if (!reader->Check(m > 0 && p + m <= point.size(), "its region arrays do not match each other")) return {};
    Coupling coupling;
    coupling.point.assign(point.begin() + p, point.begin() + p + m);
    for (int j = 0; j < m; j++) {
      if (!reader->Check(coupling.point[j] >= 0 && coupling.point[j] < points,
                         "a region's control points are not those of the body")) {
        return {};
      }
      for (int k = 0; k <= j; k++) {
        int pair = -1;
        if (!reader->Check(kinematics->Couple(coupling.point[j], coupling.point[k], &pair),
                           "a region's control points are not on one path of the tree")) {
          return {};
        }
        coupling.pair.push_back(pair);
        mass_difference->resize(kinematics->pairs().size(), 0.0);
        if (difference.empty()) continue;
        if (!reader->Check(block < difference.size(), "region_mass has too few values")) return {};
        (*mass_difference)[pair] += difference[block++];
      }
    }
    p += m;
    couplings.push_back(std::move(coupling));
  }
  reader->Check(!couplings.empty(), "it has no regions");
  return couplings;
}

// What regions with a second choice of gradients need to know of the body's frames.
struct FrameGradients {
  std::vector<int32_t> size;   // control points of each frame
  std::vector<int32_t> frame;  // of each control point         (k)
  std::vector<Vec3> own;       // g°_j [1/m]                     (k)
};

std::vector<Vec3> Vectors(const std::vector<double>& values, size_t first, size_t count) {
  std::vector<Vec3> vectors(count);
  for (size_t e = 0; e < 3 * count; e++) vectors[e / 3][e % 3] = values[3 * first + e];
  return vectors;
}

FrameGradients ReadFrameGradients(size_t points, Reader* reader) {
  constexpr char kMismatch[] = "its frame arrays do not match its control points";
  FrameGradients frames;
  frames.size = reader->Array<int32_t>("frame_size");
  const auto own = reader->Array<double>("frame_gradient");
  for (size_t i = 0; i < frames.size.size(); i++) {
    const size_t size = std::max(frames.size[i], 0);
    if (!reader->Check(size > 0 && frames.frame.size() + size <= points, kMismatch)) return {};
    frames.frame.insert(frames.frame.end(), size, static_cast<int32_t>(i));
  }
  if (!reader->Check(frames.frame.size() == points && own.size() == 3 * points, kMismatch)) return {};
  frames.own = Vectors(own, 0, points);
  return frames;
}

// ĝ of a region, none where that is zero, with its frames' own gradients.
void AddFallback(const FrameGradients& frames, const std::vector<Vec3>& fallback, Region* region, Reader* reader) {
  if (std::all_of(fallback.begin(), fallback.end(), [](const Vec3& g) { return g == Vec3{}; })) return;
  region->fallback = fallback;
  region->shows -= frames.size[frames.frame[region->point.back()]];
  for (int j = 0; j < region->size();) {
    const int32_t frame = frames.frame[region->point[j]];
    const int end = j + frames.size[frame];
    bool whole = end <= region->size(), turns = false;
    for (; whole && j < end; j++) {
      whole = frames.frame[region->point[j]] == frame;
      region->own.push_back(frames.own[region->point[j]]);
      turns = turns || region->own.back() != Vec3{};
    }
    if (!reader->Check(whole, "a region has not all control points of a frame")) return;
    if (turns) region->frame_end.push_back(end);
  }
}

// The cells of a hyperelastic law, added to the regions.
void ReadCells(Law law, std::vector<Region>* regions, Reader* reader) {
  constexpr char kMismatch[] = "its cell arrays do not match each other";
  const auto constants = reader->Array<double>("law_constants");
  const auto count = reader->Array<int32_t>("cell_count");
  const auto volume = reader->Array<double>("cell_volume");
  const auto material = reader->Array<int32_t>("cell_material");
  const auto slope = reader->Array<double>("cell_slope");
  if (!reader->Check(count.size() == regions->size() && material.size() == volume.size(), kMismatch)) return;
  size_t first = 0, s = 0;
  for (size_t e = 0; e < count.size(); e++) {
    Region& region = (*regions)[e];
    const size_t length = 27 * static_cast<size_t>(region.size());
    region.law = law;
    for (int q = 0; q < count[e]; q++, first++, s += length) {
      if (!reader->Check(first < volume.size() && s + length <= slope.size(), kMismatch)) return;
      const size_t at = kLawConstants * static_cast<size_t>(std::max(material[first], 0));
      if (!reader->Check(material[first] >= 0 && at + kLawConstants <= constants.size(), "a cell has no material")) {
        return;
      }
      region.cells.push_back(
          {volume[first], ParametersOf(law, constants.data() + at), {slope.begin() + s, slope.begin() + s + length}});
    }
  }
}

// Of one frame each, or of the law `corotational`.
std::vector<Region> ReadRegions(const std::vector<Coupling>& couplings, const std::vector<ControlPoint>& points,
                                Reader* reader) {
  const auto gradient = reader->Array<double>("region_gradient");
  const auto stiffness = reader->Array<double>("region_stiffness");
  const auto enlargement = reader->ArrayOr<double>("region_enlargement", 1, couplings.size());
  std::vector<double> fallback;
  FrameGradients frames;
  if (reader->Has("region_fallback")) {
    fallback = reader->Array<double>("region_fallback");
    frames = ReadFrameGradients(points.size(), reader);
    reader->Check(fallback.size() == gradient.size(), "its region arrays do not match each other");
  }
  if (!reader->ok()) return {};
  size_t p = 0, s = 0;
  std::vector<Region> regions;
  for (const Coupling& coupling : couplings) {
    const int m = static_cast<int>(coupling.point.size());
    const size_t n = 3 * static_cast<size_t>(m);
    if (!reader->Check(3 * (p + m) <= gradient.size() && s + n * (n + 1) / 2 <= stiffness.size(),
                       "its region arrays do not match each other")) {
      return {};
    }
    Region region;
    region.law = {};
    region.number = static_cast<int>(regions.size());
    region.point = coupling.point;
    region.pair = coupling.pair;
    region.enlargement = enlargement[regions.size()];
    Vec3 mean{};
    for (const int32_t j : region.point) mean = mean + (1.0 / m) * points[j].rest;
    region.gradient = Vectors(gradient, p, m);
    region.shows = m;
    if (!fallback.empty()) AddFallback(frames, Vectors(fallback, p, m), &region, reader);
    if (!reader->ok()) return {};
    for (int j = 0; j < m; j++) region.rest.push_back(points[region.point[j]].rest - mean);
    region.stiffness.resize(n * n);
    for (size_t row = 0; row < n; row++) {
      for (size_t col = 0; col <= row; col++) {
        region.stiffness[row * n + col] = region.stiffness[col * n + row] = stiffness[s++];
      }
    }
    p += m;
    regions.push_back(std::move(region));
  }
  return regions;
}

// The other laws, at quadrature points.
std::vector<QuadratureRegion> ReadQuadrature(const std::vector<Coupling>& couplings, Law law, Reader* reader) {
  const auto constants = reader->Array<double>("law_constants");
  const auto count = reader->Array<int32_t>("quadrature_count");
  const auto volume = reader->Array<double>("quadrature_volume");
  const auto material = reader->Array<int32_t>("quadrature_material");
  const auto gradient = reader->Array<double>("quadrature_gradient");
  if (!reader->Check(
          count.size() == couplings.size() && material.size() == volume.size() && constants.size() % kLawConstants == 0,
          "its quadrature arrays do not match each other")) {
    return {};
  }
  size_t first = 0, g = 0;
  std::vector<QuadratureRegion> regions;
  for (size_t e = 0; e < couplings.size(); e++) {
    const size_t q = std::max(count[e], 0), length = 3 * q * couplings[e].point.size();
    if (!reader->Check(q > 0 && first + q <= volume.size() && g + length <= gradient.size(),
                       "its quadrature arrays do not match each other")) {
      return {};
    }
    std::vector<LawParameters> parameters;
    for (size_t i = first; i < first + q; i++) {
      const size_t at = kLawConstants * static_cast<size_t>(std::max(material[i], 0));
      if (!reader->Check(material[i] >= 0 && at < constants.size(), "a quadrature point has no material")) return {};
      parameters.push_back(ParametersOf(law, constants.data() + at));
    }
    regions.emplace_back(law, couplings[e].point, gradient.data() + g, volume.data() + first, parameters.data(),
                         static_cast<int>(q), couplings[e].pair);
    first += q;
    g += length;
  }
  return regions;
}

// Explicit bodies with lumped masses leave MuJoCo's inertia as it is.
bool ChangesInertia(const mjModel* m, int instance) {
  const Reader reader(m, instance);
  return std::strcmp(reader.Text("mode"), "explicit") != 0 || reader.Has("region_mass");
}

// The kinematic trees whose inertia this plugin's instances change.
std::vector<bool> ChangedTrees(const mjModel* m, int slot) {
  std::vector<bool> changed(m->ntree, false);
  for (int body = 1; body < m->nbody; body++) {
    const int instance = m->body_plugin[body], tree = m->body_treeid[body];
    if (instance >= 0 && tree >= 0 && m->plugin[instance] == slot && ChangesInertia(m, instance)) changed[tree] = true;
  }
  return changed;
}

// force −= K u, K by pairs of points. Neighbours among the pairs share their first point.
MJFRAMES_MULTIVERSION
void SubtractProduct(const std::vector<PointPair>& pairs, const double* __restrict K, const Vec3* __restrict u,
                     Vec3* __restrict force) {
  int at = 0;
  Vec3 sum{};
  for (const auto& [j, k, node_pair, flip] : pairs) {
    if (j != at) {
      force[at] = force[at] - sum;
      sum = {};
      at = j;
    }
    const Vec3 uj = u[j], uk = u[k];
    for (int r = 0; r < 3; r++) sum[r] += K[3 * r] * uk[0] + K[3 * r + 1] * uk[1] + K[3 * r + 2] * uk[2];
    if (j != k) {
      for (int r = 0; r < 3; r++) force[k][r] -= K[r] * uj[0] + K[3 + r] * uj[1] + K[6 + r] * uj[2];
    }
    K += 9;
  }
  force[at] = force[at] - sum;
}

bool CanCollide(const mjModel* m, int a, int b) {
  return (m->geom_contype[a] & m->geom_conaffinity[b]) || (m->geom_contype[b] & m->geom_conaffinity[a]);
}

// MuJoCo 4.0.0 lets height fields have no contact with any SDF geom.
void CheckHeightFields(const mjModel* m, int patch, Reader* reader) {
  for (int geom = 0; geom < m->ngeom; geom++) {
    if (m->geom_type[geom] != mjGEOM_HFIELD || !CanCollide(m, geom, patch)) continue;
    if (mj_maxContact(m, geom, patch, -1) > 0) return;
    reader->Fail(std::string("this MuJoCo (") + mj_versionString() +
                 ") gives soft bodies no contact with height field '" + (m->names + m->name_geomadr[geom]) +
                 "': make it a mesh, use MuJoCo 3.17.0, or set its contype and conaffinity so that they do not meet");
    return;
  }
}

// MuJoCo collides flexes of triangles with SDF geoms, and no others.
void CheckFlexes(const mjModel* m, int patch, Reader* reader) {
  for (int flex = 0; flex < m->nflex; flex++) {
    const bool collides =
        (m->flex_contype[flex] & m->geom_conaffinity[patch]) || (m->geom_contype[patch] & m->flex_conaffinity[flex]);
    if (!collides || m->flex_dim[flex] == 2) continue;
    reader->Fail(std::string("MuJoCo gives soft bodies contact with flexes of dim 2 only, not with '") +
                 (m->names + m->name_flexadr[flex]) + "': set its contype and conaffinity so that they do not meet");
    return;
  }
}

std::vector<Patch> ReadPatches(const mjModel* m, int instance, const std::vector<ControlPoint>& points,
                               Reader* reader) {
  std::vector<Patch> patches;
  for (int geom = 0; geom < m->ngeom; geom++) {
    if (SoftInstanceOf(m, geom) == instance) patches.push_back({geom, 0, {}, {}, {}, {}});
  }
  if (patches.empty()) {
    reader->Check(!reader->Has("patch_size"), "its patch geoms are not there: build it again");
    return patches;
  }
  const auto size = reader->Array<int32_t>("patch_size");
  const auto clusters = reader->Array<int32_t>("patch_clusters");
  const auto cluster_size = reader->Array<int32_t>("patch_cluster_size");
  const auto point = reader->Array<int32_t>("patch_point");
  const auto weight = reader->Array<double>("patch_weight");
  std::vector<double> offset;
  if (reader->Has("patch_offset")) offset = reader->Array<double>("patch_offset");
  if (!reader->Check(size.size() == patches.size() && clusters.size() == patches.size(),
                     "its patch geoms do not match its patches")) {
    return {};
  }
  size_t p = 0, w = 0, c = 0, o = 0;
  for (size_t i = 0; i < patches.size(); i++) {
    Patch& patch = patches[i];
    const size_t count = std::max(size[i], 0), groups = std::max(clusters[i], 0);
    if (!reader->Check(groups > 0 && groups <= kMaxClusters && c + groups <= cluster_size.size(),
                       "its patch arrays do not match each other")) {
      return {};
    }
    patch.cluster.assign(cluster_size.begin() + c, cluster_size.begin() + c + groups);
    size_t n = 0;
    for (const int32_t vertices : patch.cluster) {
      if (!reader->Check(vertices > 0 && vertices <= kMaxPatchVertices, "a cluster of a patch has no valid size")) {
        return {};
      }
      n += vertices;
    }
    if (!reader->Check(
            count > 0 && n <= kMaxPatchVertices && p + count <= point.size() && w + count * n <= weight.size(),
            "its patch arrays do not match each other")) {
      return {};
    }
    patch.vertices = static_cast<int>(n);
    patch.point.assign(point.begin() + p, point.begin() + p + count);
    patch.weight.assign(weight.begin() + w, weight.begin() + w + count * n);
    bool owned = false;
    for (const int32_t j : patch.point) {
      if (!reader->Check(j >= 0 && j < static_cast<int>(points.size()),
                         "a patch's control points are not those of the body")) {
        return {};
      }
      owned = owned || points[j].body == m->geom_bodyid[patch.geom];
    }
    if (!reader->Check(owned, "a patch is not on the body of one of its control points")) return {};
    if (!offset.empty()) {
      if (!reader->Check(o + 3 * n <= offset.size(), "patch_offset has too few values")) return {};
      patch.offset.assign(offset.begin() + o, offset.begin() + o + 3 * n);
    }
    p += count;
    w += count * n;
    c += groups;
    o += 3 * n;
  }
  return patches;
}

Lattice ReadLattice(int points, const std::vector<Patch>& patches, Reader* reader) {
  Lattice lattice;
  lattice.spacing = reader->Number("lattice_spacing");
  lattice.axes = reader->Array<double>("lattice_axes");
  lattice.origin = reader->Array<double>("lattice_origin");
  lattice.shape = reader->Array<int32_t>("lattice_shape");
  lattice.node = reader->Array<int32_t>("lattice_node");
  lattice.distance = reader->Array<double>("lattice_distance");
  lattice.patch = reader->Array<int32_t>("lattice_patch");
  lattice.count = reader->Array<int32_t>("lattice_count");
  lattice.point = reader->Array<int32_t>("lattice_point");
  lattice.weight = reader->Array<double>("lattice_weight");
  lattice.vertex = reader->Array<double>("lattice_sphere");
  int vertices = 0;
  for (const Patch& patch : patches) vertices += patch.vertices;
  if (!reader->ok()) return {};
  const std::string wrong = lattice.Finish(points, static_cast<int>(patches.size()), vertices);
  if (!wrong.empty()) reader->Fail(wrong);
  return lattice;
}

}  // namespace

std::unique_ptr<SoftBody> SoftBody::Create(const mjModel* m, int instance) {
  Reader reader(m, instance);
  std::unique_ptr<SoftBody> body(new SoftBody());
  if (std::strcmp(reader.Text("version"), kVersion) != 0) {
    reader.Fail(std::string("its data has version '") + reader.Text("version") + "', this plugin reads version " +
                kVersion + ": build it again with the mjframes that is installed");
  }
  const std::optional<Law> law = LawOfName(reader.Text("law"));
  reader.Check(law || std::strcmp(reader.Text("law"), "corotational") == 0,
               "law has to be 'corotational', 'green_lagrange', 'neo_hookean', 'mooney_rivlin' or 'arruda_boyce'");
  body->implicit_ = std::strcmp(reader.Text("mode"), "explicit") != 0;
  reader.Check(!body->implicit_ || std::strcmp(reader.Text("mode"), "implicit") == 0,
               "mode has to be 'implicit' or 'explicit'");
  body->changes_inertia_ = ChangesInertia(m, instance);
  if (const char* wrong = WrongOption(m, body->implicit_, body->changes_inertia_)) reader.Fail(wrong);
  if (reader.ok()) {
    body->alpha_ = reader.Number("alpha");
    body->beta_ = reader.Number("beta");
  }
  if (reader.ok()) body->kinematics_.Create(m, instance, &reader);
  std::vector<Coupling> couplings;
  if (reader.ok()) couplings = ReadCouplings(&body->kinematics_, &body->mass_difference_, &reader);
  const bool at_points = law && !reader.Has("cell_count");
  if (reader.ok() && at_points) body->quadrature_ = ReadQuadrature(couplings, *law, &reader);
  if (reader.ok() && !at_points) body->regions_ = ReadRegions(couplings, body->kinematics_.points(), &reader);
  if (reader.ok() && law && !at_points) ReadCells(*law, &body->regions_, &reader);
  if (reader.ok()) body->AssignMass();
  if (reader.ok()) body->kinematics_.Finish(m, &reader);
  reader.Check(!(m->opt.enableflags & mjENBL_SLEEP) || !body->kinematics_.MissesWaking(m),
               "it is attached to bodies of several kinematic trees, or to a mocap body, and MuJoCo would not wake one "
               "with the other: give the root body of each tree sleep=\"never\", or disable sleep");
  if (reader.ok()) body->patches_ = ReadPatches(m, instance, body->kinematics_.points(), &reader);
  if (reader.ok() && !body->patches_.empty()) {
    body->contact_radius_ = reader.Number("contact_radius");
    body->volumes_.resize(body->patches_.size());
    body->has_volume_ = reader.Has("lattice_spacing");
    if (body->has_volume_) {
      body->lattice_ = ReadLattice(static_cast<int>(body->kinematics_.points().size()), body->patches_, &reader);
      for (size_t i = 0; reader.ok() && i < body->patches_.size(); i++) {
        body->volumes_[i] = PatchVolume::Create(m, *body, static_cast<int>(i));
      }
    }
    for (size_t i = 0; reader.ok() && i < body->patches_.size(); i++) {
      body->volumes_[i].SetCover(*body, static_cast<int>(i));
    }
    for (size_t i = 0; reader.ok() && i < body->patches_.size(); i++) {
      body->states_.push_back(std::make_unique<PatchState>(*body, static_cast<int>(i)));
    }
    body->hulls_ = CollisionHulls(m);
    for (const auto& hull : body->hulls_) {
      body->features_.push_back(hull ? std::make_shared<const MeshFeatures>(*hull) : nullptr);
    }
    CheckHeightFields(m, body->patches_.front().geom, &reader);
    CheckFlexes(m, body->patches_.front().geom, &reader);
  }
  if (!reader.ok()) {
    mju_warning("mjframes: soft body '%s': %s.", m->names + m->name_pluginadr[instance], reader.error().c_str());
    return nullptr;
  }

  const int slot = m->plugin[instance];
  body->starts_inertia_ = body->changes_inertia_;
  bool factors = body->changes_inertia_;
  body->last_ = true;
  for (int other = 0; other < m->nplugin; other++) {
    if (m->plugin[other] != slot || other == instance) continue;
    if (other > instance) body->last_ = false;
    if (!ChangesInertia(m, other)) continue;
    (other < instance ? body->starts_inertia_ : factors) = false;
  }
  if (factors) body->factor_ = std::make_unique<InertiaFactor>(m, ChangedTrees(m, slot));
  const size_t pairs = body->kinematics_.pairs().size();
  body->force_.resize(body->kinematics_.points().size());
  body->velocity_.resize(body->force_.size());
  body->moved_.resize(body->force_.size());
  body->stiffness_.resize(9 * pairs);
  body->added_mass_.resize(pairs);
  for (const Region& region : body->regions_) {
    if (region.enlargement != 1) body->held_.resize(9 * pairs);
  }
  if (at_points && reader.Has("region_enlargement")) {
    for (const double value : reader.Array<double>("region_enlargement")) {
      body->enlargement_ = std::max(body->enlargement_, value);
    }
    body->held_.resize(9 * pairs);
  }
  body->quadrature_scratch_ = std::make_unique<QuadratureScratch>(body->quadrature_);
  body->batches_ = BatchesOf(body->regions_);
  body->batch_scratch_ = std::make_unique<BatchScratch>(body->batches_);
  if (body->last_) body->contact_scratch_ = std::make_unique<ContactScratch>(m);
  return body;
}

// Every point is a pair with itself that carries its mass.
void SoftBody::AssignMass() {
  const size_t points = kinematics_.points().size();
  std::vector<int> own(points);
  for (size_t j = 0; j < points; j++) kinematics_.Couple(static_cast<int>(j), static_cast<int>(j), &own[j]);
  mass_difference_.resize(kinematics_.pairs().size(), 0.0);
  has_difference_ = std::any_of(mass_difference_.begin(), mass_difference_.end(), [](double m) { return m != 0; });
  mass_ = mass_difference_;
  for (size_t j = 0; j < points; j++) mass_[own[j]] += kinematics_.points()[j].mass;
  built_mass_ = mass_;
  built_difference_ = mass_difference_;
  mass_scale_.resize(points, 1.0);
}

// Masses may be changed in the model at any time. √(s_j s_k) M_jk stays positive definite, and right where s is common.
void SoftBody::ScaleMass(const mjModel* m) {
  bool same = true;
  for (size_t j = 0; j < mass_scale_.size(); j++) {
    const ControlPoint& point = kinematics_.points()[j];
    const double ratio = m->body_mass[point.body] / point.carried;
    const double scale = std::abs(ratio - 1) > kSameMass ? std::sqrt(ratio) : 1.0;
    same = same && scale == mass_scale_[j];
    mass_scale_[j] = scale;
  }
  if (same) return;
  for (size_t i = 0; i < mass_.size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    const double scale = mass_scale_[pair.j] * mass_scale_[pair.k];
    mass_[i] = scale * built_mass_[i];
    mass_difference_[i] = scale * built_difference_[i];
  }
}

int SoftBody::FindPatch(int geom) const {
  // patches are in the order of their geoms
  const auto found = std::lower_bound(patches_.begin(), patches_.end(), geom,
                                      [](const Patch& patch, int value) { return patch.geom < value; });
  return found != patches_.end() && found->geom == geom ? static_cast<int>(found - patches_.begin()) : -1;
}

void SoftBody::Compute(const mjModel* m, mjData* d) {
  const bool awake = !kinematics_.Asleep(m, d);
  if (awake) {
    ScaleMass(m);
    kinematics_.Gather(m, d);
    AddElasticity();
    if (implicit_) kinematics_.StiffenTurns(force_, d);
    AddDamping(implicit_ ? m->opt.timestep + beta_ : beta_);
    AddMassBias(m, d);
    kinematics_.StoreForce(force_, d);
  }
  // compute may run again on the same position: start from the rigid inertia each time
  if (starts_inertia_ && AnyAdds(m, d)) mj_makeM(m, d);
  if (changes_inertia_ && awake) StoreInertia(m, d);
  if (factor_) factor_->Factor(m, d);
  if (last_) WriteConstraintRows(m, d, contact_scratch_.get());
}

void SoftBody::CheckOptions(const mjModel* m, const mjData* d) {
  for (int instance = 0; last_ && !told_ && instance < m->nplugin; instance++) {
    const SoftBody* body = GetSoftBody(m, d, instance);
    const char* wrong = body ? WrongOption(m, body->implicit_, body->changes_inertia_) : nullptr;
    if (!wrong) continue;
    mju_warning("mjframes: soft body '%s': %s.", m->names + m->name_pluginadr[instance], wrong);
    told_ = true;
  }
}

// Whether an instance adds to d->M what it does not replace.
bool SoftBody::AnyAdds(const mjModel* m, const mjData* d) {
  for (int instance = 0; instance < m->nplugin; instance++) {
    const SoftBody* body = GetSoftBody(m, d, instance);
    if (body && body->changes_inertia_ && !body->kinematics_.replaces()) return true;
  }
  return false;
}

// d->M += Jᵀ ((h² + h β) K + h α M) J, the stiffness of turns, and the part of the mass that MuJoCo does not know of.
void SoftBody::StoreInertia(const mjModel* m, mjData* d) {
  const double h = m->opt.timestep;
  for (size_t i = 0; i < mass_.size(); i++) {
    added_mass_[i] = (implicit_ ? h * alpha_ * mass_[i] : 0) + mass_difference_[i];
  }
  kinematics_.StoreInertia(held_.empty() ? stiffness_.data() : held_.data(), implicit_ ? h * (h + beta_) : 0,
                           added_mass_.data(), m, d);
}

void SoftBody::AddElasticity() {
  const bool stiffness = implicit_ || beta_ > 0;
  std::fill(force_.begin(), force_.end(), Vec3{});
  std::fill(stiffness_.begin(), stiffness_.end(), 0.0);
  std::fill(held_.begin(), held_.end(), 0.0);
  double* held = held_.empty() ? nullptr : held_.data();
  AddBatches(batches_, kinematics_.x().data(), batch_scratch_.get(), force_.data(),
             stiffness ? stiffness_.data() : nullptr, held);
  AddQuadrature(quadrature_, kinematics_.x().data(), quadrature_scratch_.get(), force_.data(),
                stiffness ? stiffness_.data() : nullptr);
  if (quadrature_.empty() || held_.empty()) return;
  std::transform(stiffness_.begin(), stiffness_.end(), held_.begin(), [this](double k) { return enlargement_ * k; });
}

// f −= rate K v + α M v; rate: h of the implicit step and Rayleigh's β
void SoftBody::AddDamping(double rate) {
  const std::vector<Vec3>& v = kinematics_.v();
  // K is blind to a common velocity, but not to the last digit of a stiff K times a fast one
  Vec3 common{};
  for (const Vec3& some : v) common = common + (1.0 / v.size()) * some;
  for (size_t j = 0; j < v.size(); j++) moved_[j] = rate * (v[j] - common);
  SubtractProduct(kinematics_.pairs(), stiffness_.data(), moved_.data(), force_.data());
  if (alpha_ == 0) return;
  for (size_t i = 0; i < kinematics_.pairs().size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    const double drag = alpha_ * mass_[i];
    force_[pair.j] = force_[pair.j] - drag * v[pair.k];
    if (pair.j != pair.k) force_[pair.k] = force_[pair.k] - drag * v[pair.j];
  }
}

// f −= D dJ/dt qvel, which MuJoCo has for the masses that it knows of
void SoftBody::AddMassBias(const mjModel* m, const mjData* d) {
  const Vec3* a = has_difference_ ? kinematics_.BiasAccelerations(m, d) : nullptr;
  if (!a) return;
  for (size_t i = 0; i < kinematics_.pairs().size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    const double difference = mass_difference_[i];
    force_[pair.j] = force_[pair.j] - difference * a[pair.k];
    if (pair.j != pair.k) force_[pair.k] = force_[pair.k] - difference * a[pair.j];
  }
}

const Region& SoftBody::FindRegion(int number) const {
  return *std::find_if(regions_.begin(), regions_.end(), [number](const Region& r) { return r.number == number; });
}

double SoftBody::ElasticEnergy() {
  double energy = 0;
  Mat3 R = kIdentity;  // neighbouring regions turn alike, so each starts its rotation from the one before
  for (const Region& region : regions_) {
    R = RegionRotation(region, kinematics_.x().data(), R);
    energy += RegionEnergy(region, kinematics_.x().data(), R);
  }
  for (const QuadratureRegion& region : quadrature_) {
    energy += QuadratureEnergy(region, kinematics_.x().data(), quadrature_scratch_.get());
  }
  return energy;
}

double SoftBody::KineticEnergy(const mjModel* m, const mjData* d) {
  ScaleMass(m);
  for (size_t j = 0; j < velocity_.size(); j++) velocity_[j] = kinematics_.WorldVelocity(m, d, static_cast<int>(j));
  double energy = 0;
  for (size_t i = 0; i < mass_.size(); i++) {
    const PointPair& pair = kinematics_.pairs()[i];
    energy += (pair.j == pair.k ? 0.5 : 1) * mass_[i] * Dot(velocity_[pair.j], velocity_[pair.k]);
  }
  return energy;
}

bool IsSoftBody(const mjModel* m, int instance) { return instance >= 0 && m->plugin[instance] == g_slot; }

SoftBody* GetSoftBody(const mjModel* m, const mjData* d, int instance) {
  if (!IsSoftBody(m, instance)) return nullptr;
  return reinterpret_cast<SoftBody*>(d->plugin_data[instance]);
}

int SoftBodyHeldBy(const mjModel* m, int holder) {
  for (int body = holder + 1; body < m->nbody; body++) {
    const int instance = m->body_plugin[body];
    if (m->body_parentid[body] == holder && m->body_jntnum[body] > 0 && IsSoftBody(m, instance)) {
      return instance;
    }
  }
  return -1;
}

void RegisterPlugin() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = kPluginName;
  plugin.capabilityflags = mjPLUGIN_PASSIVE;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.nstate = +[](const mjModel*, int) { return 0; };
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    std::unique_ptr<SoftBody> body = SoftBody::Create(m, instance);
    if (!body) return -1;
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(body.release());
    return 0;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<SoftBody*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum*, void*, int) {};
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int) {
    reinterpret_cast<SoftBody*>(d->plugin_data[instance])->Compute(m, d);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    reinterpret_cast<SoftBody*>(d->plugin_data[instance])->CheckOptions(m, d);
  };
  g_slot = mjp_registerPlugin(&plugin);
}

}  // namespace mjframes
