#include "soft.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>

#include "config.h"

namespace mjframes {
namespace {

constexpr char kVersion[] = "1";  // of the configuration; a model written by another version is refused

constexpr const char* kAttributes[] = {
    "version",  //
    "law",
    "alpha",
    "beta",        //
    "point_rest",  // (k × 3) [m]
    "region_size",
    "region_point",
    "region_gradient",
    "region_stiffness",
    "contact_radius",  // [m]
    "patch_size",
    "patch_clusters",
    "patch_cluster_size",
    "patch_point",
    "patch_weight",
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
};

// Reads the configuration of one instance; the first failure is kept as a sentence.
class Reader {
 public:
  Reader(const mjModel* m, int instance) : model_(m), instance_(instance) {}

  const char* Text(const char* key) const {
    const char* value = mj_getPluginConfig(model_, instance_, key);
    return value ? value : "";
  }

  double Number(const char* key) {
    const char* text = Text(key);
    char* end = nullptr;
    const double value = std::strtod(text, &end);
    if (end == text || *end != '\0' || !std::isfinite(value) || value < 0) {
      Fail(std::string(key) + " is '" + text + "' but has to be a number ≥ 0");
      return 0;
    }
    return value;
  }

  template <typename T>
  std::vector<T> Array(const char* key) {
    std::vector<T> out;
    std::string error;
    if (!DecodeArray(Text(key), &out, &error)) Fail(std::string(key) + " " + error);
    return out;
  }

  void Fail(const std::string& what) {
    if (error_.empty()) error_ = what;
  }

  bool Check(bool good, const char* what) {
    if (!good) Fail(what);
    return error_.empty();
  }

  bool ok() const { return error_.empty(); }
  const std::string& error() const { return error_; }

 private:
  const mjModel* model_;
  int instance_;
  std::string error_;
};

int g_slot = -1;  // of this plugin in MuJoCo's registry; written once, at load

// Finds the control points of the instance among the bodies, and their places in MuJoCo's arrays.
std::vector<ControlPoint> FindPoints(const mjModel* m, int instance, Reader* reader) {
  const std::vector<double> rest = reader->Array<double>("point_rest");
  std::vector<ControlPoint> points;
  std::vector<int> point_of_body(m->nbody, -1);
  int pairs = 0;
  for (int body = 1; body < m->nbody && reader->ok(); body++) {
    if (m->body_plugin[body] != instance) continue;
    ControlPoint point = {};
    point.body = body;
    point.parent = point_of_body[m->body_parentid[body]];
    point.mass = m->body_mass[body];
    if (m->body_jntnum[body] == 0) {
      point.depth = -1;
      if (!reader->Check(point.parent < 0, "a fixed control point hangs on a moving one")) break;
    } else {
      const int joint = m->body_jntadr[body];
      bool slides = m->body_jntnum[body] == 3;
      for (int r = 0; slides && r < 3; r++) {
        slides = m->jnt_type[joint + r] == mjJNT_SLIDE && m->jnt_axis[3 * (joint + r) + r] == 1;
      }
      if (!reader->Check(slides, "each of its bodies has to have three slide joints along x, y, z, or none")) break;
      point.depth = point.parent < 0 ? 0 : points[point.parent].depth + 1;
      point.qpos = m->jnt_qposadr[joint];
      point.dof = m->jnt_dofadr[joint];
    }
    point.pair = pairs;
    const size_t index = points.size();
    if (!reader->Check(3 * index + 2 < rest.size(), "it has more bodies than control points")) break;
    for (int r = 0; r < 3; r++) {
      point.reference[r] = point.moves() ? m->qpos0[point.qpos + r] : 0;
      point.rest[r] = rest[3 * index + r];
    }
    pairs += point.depth + 1;
    point_of_body[body] = static_cast<int>(index);
    points.push_back(point);
  }
  if (!reader->Check(points.size() >= 2 && 3 * points.size() == rest.size(),
                     "its bodies do not match its control points: attach or copy the soft body as a whole")) {
    return {};
  }
  // every ancestor pair needs its place in the inertia matrix
  for (ControlPoint& point : points) {
    if (!point.moves()) continue;
    std::vector<int> path;
    for (const ControlPoint* p = &point;; p = &points[p->parent]) {
      path.push_back(p->dof);
      if (p->parent < 0) break;
    }
    std::reverse(path.begin(), path.end());
    for (int r = 0; r < 3; r++) {
      const int row = point.dof + r;
      const int length = 3 * point.depth + r + 1;
      point.inertia[r] = m->M_rowadr[row] + m->M_rownnz[row] - length;
      bool stored = m->M_rownnz[row] >= length;
      for (int c = 0; stored && c < length; c++) {
        stored = m->M_colind[point.inertia[r] + c] == path[c / 3] + c % 3;
      }
      if (!reader->Check(stored, "its bodies are not nested in the order they were written in")) return {};
    }
  }
  return points;
}

// True if the points are fixed ones and then one path from a root, ancestors first.
bool OnOnePath(const std::vector<ControlPoint>& points, const std::vector<int32_t>& list) {
  for (size_t a = 0; a < list.size(); a++) {
    if (list[a] < 0 || list[a] >= static_cast<int>(points.size())) return false;
    if (a == 0 || !points[list[a - 1]].moves()) continue;
    int p = list[a];
    while (p >= 0 && points[p].depth > points[list[a - 1]].depth) p = points[p].parent;
    if (p != list[a - 1] || list[a] == list[a - 1]) return false;
  }
  return !list.empty();
}

std::vector<Region> ReadRegions(const std::vector<ControlPoint>& points, Reader* reader) {
  const auto size = reader->Array<int32_t>("region_size");
  const auto point = reader->Array<int32_t>("region_point");
  const auto gradient = reader->Array<double>("region_gradient");
  const auto stiffness = reader->Array<double>("region_stiffness");
  size_t p = 0, s = 0;
  std::vector<Region> regions;
  for (const int32_t m : size) {
    const size_t n = 3 * static_cast<size_t>(std::max(m, 0));
    if (!reader->Check(
            m > 0 && p + m <= point.size() && 3 * (p + m) <= gradient.size() && s + n * (n + 1) / 2 <= stiffness.size(),
            "its region arrays do not match each other")) {
      return {};
    }
    Region region;
    region.point.assign(point.begin() + p, point.begin() + p + m);
    if (!reader->Check(OnOnePath(points, region.point), "a region's control points are not on one path of the tree")) {
      return {};
    }
    Vec3 mean{};
    for (const int32_t j : region.point) mean = mean + (1.0 / m) * points[j].rest;
    double extent = 0;
    for (int j = 0; j < m; j++) {
      region.rest.push_back(points[region.point[j]].rest - mean);
      region.gradient.push_back({gradient[3 * (p + j)], gradient[3 * (p + j) + 1], gradient[3 * (p + j) + 2]});
      extent += Dot(region.rest[j], region.rest[j]);
    }
    region.inverse_extent = 1 / std::max(extent, mjMINVAL);
    region.stiffness.resize(n * n);
    for (size_t row = 0; row < n; row++) {
      for (size_t col = 0; col <= row; col++) {
        region.stiffness[row * n + col] = region.stiffness[col * n + row] = stiffness[s++];
      }
    }
    region.blocks.assign(BlockOffset(m), 0.0);
    for (int j = 0; j < m; j++) {
      for (int k = 0; k <= j; k++) {
        for (int e = 0; e < 9; e++) {
          region.blocks[BlockOffset(j) + e * BlockStride(j) + k] =
              region.stiffness[(3 * j + e / 3) * n + 3 * k + e % 3];
        }
        const ControlPoint& deeper = points[region.point[j]];
        const ControlPoint& shallower = points[region.point[k]];
        region.pair.push_back(shallower.moves() ? deeper.pair + shallower.depth : -1);
      }
    }
    p += m;
    regions.push_back(std::move(region));
  }
  reader->Check(!regions.empty(), "it has no regions");
  return regions;
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

std::vector<Patch> ReadPatches(const mjModel* m, int instance, const std::vector<ControlPoint>& points,
                               Reader* reader) {
  std::vector<Patch> patches;
  for (int geom = 0; geom < m->ngeom; geom++) {
    if (m->geom_plugin[geom] == instance) patches.push_back({geom, -1, 0, {}, {}, {}});
  }
  if (patches.empty()) return patches;
  const auto size = reader->Array<int32_t>("patch_size");
  const auto clusters = reader->Array<int32_t>("patch_clusters");
  const auto cluster_size = reader->Array<int32_t>("patch_cluster_size");
  const auto point = reader->Array<int32_t>("patch_point");
  const auto weight = reader->Array<double>("patch_weight");
  if (!reader->Check(size.size() == patches.size() && clusters.size() == patches.size(),
                     "its patch geoms do not match its patches")) {
    return {};
  }
  size_t p = 0, w = 0, c = 0;
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
    patch.owner = patch.point.back();
    if (!reader->Check(OnOnePath(points, patch.point) && points[patch.owner].body == m->geom_bodyid[patch.geom],
                       "a patch is not on the body of its deepest control point")) {
      return {};
    }
    p += count;
    w += count * n;
    c += groups;
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
  reader.Check(std::strcmp(reader.Text("law"), "corotational") == 0, "law has to be 'corotational'");
  reader.Check(m->opt.integrator != mjINT_RK4,
               "integrator RK4 evaluates forces between steps and cannot hold implicit elasticity: use Euler, "
               "implicitfast, implicit or discrete");
  reader.Check(m->opt.solver != mjSOL_PGS || m->opt.integrator == mjINT_DISCRETE,
               "solver PGS does not see the effective inertia: use Newton or CG");
  reader.Check(m->opt.noslip_iterations == 0 || m->opt.integrator == mjINT_DISCRETE,
               "the noslip solver does not see the effective inertia: set noslip_iterations to 0");
  if (reader.ok()) {
    body->alpha_ = reader.Number("alpha");
    body->beta_ = reader.Number("beta");
  }
  if (reader.ok()) body->points_ = FindPoints(m, instance, &reader);
  if (reader.ok()) body->regions_ = ReadRegions(body->points_, &reader);
  if (reader.ok()) body->patches_ = ReadPatches(m, instance, body->points_, &reader);
  if (reader.ok() && !body->patches_.empty()) {
    body->contact_radius_ = reader.Number("contact_radius");
    body->lattice_ = ReadLattice(static_cast<int>(body->points_.size()), body->patches_, &reader);
    for (size_t i = 0; reader.ok() && i < body->patches_.size(); i++) {
      body->volumes_.push_back(PatchVolume::Create(*body, static_cast<int>(i)));
    }
    body->hulls_ = CollisionHulls(m);
    body->features_ = GeomFeatures(m, body->hulls_);
    CheckHeightFields(m, body->patches_.front().geom, &reader);
  }
  if (!reader.ok()) {
    mju_warning("mjframes: soft body '%s': %s.", m->names + m->name_pluginadr[instance], reader.error().c_str());
    return nullptr;
  }

  const int slot = m->plugin[instance];
  body->first_ = std::find(m->plugin, m->plugin + instance, slot) == m->plugin + instance;
  body->last_ = std::find(m->plugin + instance + 1, m->plugin + m->nplugin, slot) == m->plugin + m->nplugin;
  const size_t k = body->points_.size();
  body->x_.resize(k);
  body->v_.resize(k);
  body->force_.resize(k);
  size_t pairs = 0;
  for (const ControlPoint& point : body->points_) pairs += point.depth + 1;
  body->pair_stiffness_.resize(9 * pairs);
  body->pair_sum_.resize(9 * pairs);
  int largest = 0;
  for (const Region& region : body->regions_) largest = std::max(largest, region.size());
  body->scratch_ = std::make_unique<RegionScratch>(largest);
  if (body->last_) body->contact_scratch_ = std::make_unique<ContactScratch>(m->nv, m->nbody);
  return body;
}

int SoftBody::FindPatch(int geom) const {
  // patches are in the order of their geoms
  const auto found = std::lower_bound(patches_.begin(), patches_.end(), geom,
                                      [](const Patch& patch, int value) { return patch.geom < value; });
  return found != patches_.end() && found->geom == geom ? static_cast<int>(found - patches_.begin()) : -1;
}

void SoftBody::Compute(const mjModel* m, mjData* d) {
  const double h = m->opt.timestep;
  GatherState(d);
  AddElasticity();
  AddDamping(h);
  StoreForce(d);
  // compute may run again on the same position: start from the rigid inertia each time
  if (first_) mj_makeM(m, d);
  StoreInertia(h, d);
  if (last_) {
    mj_factorM(m, d);
    WriteContactRows(m, d, contact_scratch_.get());
  }
}

// x_j = x̄_j + the slides of j and of all its ancestors
void SoftBody::GatherState(const mjData* d) {
  for (size_t j = 0; j < points_.size(); j++) {
    const ControlPoint& point = points_[j];
    if (!point.moves()) {
      x_[j] = point.rest;
      v_[j] = {};
      continue;
    }
    const Vec3 slide = {d->qpos[point.qpos] - point.reference[0], d->qpos[point.qpos + 1] - point.reference[1],
                        d->qpos[point.qpos + 2] - point.reference[2]};
    const Vec3 rate = {d->qvel[point.dof], d->qvel[point.dof + 1], d->qvel[point.dof + 2]};
    x_[j] = point.rest + slide;
    v_[j] = rate;
    if (point.parent >= 0) {
      x_[j] = x_[j] + (x_[point.parent] - points_[point.parent].rest);
      v_[j] = v_[j] + v_[point.parent];
    }
  }
}

void SoftBody::AddElasticity() {
  std::fill(force_.begin(), force_.end(), Vec3{});
  std::fill(pair_stiffness_.begin(), pair_stiffness_.end(), 0.0);
  // neighbouring regions turn alike, so each starts its rotation from the one before
  Mat3 R = kIdentity;
  for (const Region& region : regions_) {
    R = RegionRotation(region, x_.data(), R);
    AddRegion(region, x_.data(), R, scratch_.get(), force_.data(), pair_stiffness_.data());
  }
}

// f −= (h + β) K v + α M v: the implicit step's K h v and Rayleigh damping
void SoftBody::AddDamping(double h) {
  const double scale = h + beta_;
  for (size_t j = 0; j < points_.size(); j++) {
    const ControlPoint& point = points_[j];
    force_[j] = force_[j] - (alpha_ * point.mass) * v_[j];
    int k = static_cast<int>(j);
    for (int depth = point.depth; depth >= 0; depth--) {
      const double* block = pair_stiffness_.data() + 9 * (point.pair + depth);
      const Mat3 K = {block[0], block[1], block[2], block[3], block[4], block[5], block[6], block[7], block[8]};
      force_[j] = force_[j] - scale * Mul(K, v_[k]);
      if (k != static_cast<int>(j)) force_[k] = force_[k] - scale * MulT(K, v_[j]);
      k = points_[k].parent;
    }
  }
}

// A slide moves its point and all points below it: generalized force = sum over the subtree.
void SoftBody::StoreForce(mjData* d) {
  for (size_t j = points_.size(); j-- > 0;) {
    const ControlPoint& point = points_[j];
    if (!point.moves()) continue;
    for (int r = 0; r < 3; r++) d->qfrc_passive[point.dof + r] += force_[j][r];
    if (point.parent >= 0) force_[point.parent] = force_[point.parent] + force_[j];
  }
}

// d->M += Tᵀ ((h² + hβ) K + hα M) T, with T_jk = 1 where k is j or an ancestor of j.
void SoftBody::StoreInertia(double h, mjData* d) {
  const double scale = h * h + h * beta_;
  std::transform(pair_stiffness_.begin(), pair_stiffness_.end(), pair_sum_.begin(),
                 [scale](double k) { return scale * k; });
  for (const ControlPoint& point : points_) {
    if (!point.moves()) continue;
    double* own = pair_sum_.data() + 9 * (point.pair + point.depth);
    for (int r = 0; r < 3; r++) own[4 * r] += h * alpha_ * point.mass;
  }
  // rows: sum over subtrees, from the leaves up; a point's own pair becomes the sum over its subtree's square
  for (size_t j = points_.size(); j-- > 1;) {
    const ControlPoint& point = points_[j];
    if (point.parent < 0) continue;
    const ControlPoint& parent = points_[point.parent];
    const double* row = pair_sum_.data() + 9 * point.pair;
    double* into = pair_sum_.data() + 9 * parent.pair;
    for (int e = 0; e < 9 * parent.depth; e++) into[e] += row[e];
    const double* cross = row + 9 * parent.depth;
    const double* own = row + 9 * point.depth;
    double* parent_own = into + 9 * parent.depth;
    for (int e = 0; e < 9; e++) parent_own[e] += own[e] + cross[e] + cross[3 * (e % 3) + e / 3];
  }
  // columns: along each path, from the point up to the root
  for (const ControlPoint& point : points_) {
    double sum[9] = {};
    const double* row = pair_sum_.data() + 9 * point.pair;
    for (int depth = point.depth; depth >= 0; depth--) {
      for (int e = 0; e < 9; e++) sum[e] += row[9 * depth + e];
      for (int r = 0; r < 3; r++) {
        double* entry = d->M + point.inertia[r] + 3 * depth;
        const int columns = depth == point.depth ? r + 1 : 3;
        for (int c = 0; c < columns; c++) entry[c] += sum[3 * r + c];
      }
    }
  }
}

SoftBody* GetSoftBody(const mjModel* m, const mjData* d, int instance) {
  if (instance < 0 || m->plugin[instance] != g_slot) return nullptr;
  return reinterpret_cast<SoftBody*>(d->plugin_data[instance]);
}

void RegisterPlugin() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = kPluginName;
  plugin.capabilityflags = mjPLUGIN_PASSIVE | mjPLUGIN_SDF;
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
  g_slot = mjp_registerPlugin(&plugin);
}

}  // namespace mjframes
