#include "parse.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>

#include "constants.h"
#include "interned.h"
#include "patch_field.h"
#include "tendon.h"

namespace mjframes {
namespace {

constexpr char kVersion[] = "10";  // of the attributes; a model written by another version is refused

constexpr char kRegionMismatch[] = "its region arrays do not match each other";

// The control points of each region, and the pairs that their blocks belong to.
struct Coupling {
  std::vector<int32_t> point;  // (m)
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
    if (!reader->Check(m > 0 && p + m <= point.size(), kRegionMismatch)) return {};
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
        if (!reader->Check(block < difference.size(), kRegionMismatch)) return {};
        (*mass_difference)[pair] += difference[block++];
      }
    }
    p += m;
    couplings.push_back(std::move(coupling));
  }
  reader->Check(!couplings.empty(), "it has no regions");
  reader->Check(p == point.size() && block == difference.size(), kRegionMismatch);
  return couplings;
}

std::vector<Vec3> Vectors(const std::vector<double>& values, size_t first, size_t count) {
  std::vector<Vec3> vectors(count);
  for (size_t e = 0; e < 3 * count; e++) vectors[e / 3][e % 3] = values[3 * first + e];
  return vectors;
}

// Whether Σ_j x̄_j g_jᵀ is the identity, as it is where the points reach along all axes.
bool ShowsAll(const std::vector<Vec3>& rest, const std::vector<Vec3>& gradient) {
  Mat3 F{};
  for (size_t j = 0; j < rest.size(); j++) {
    for (int e = 0; e < 9; e++) F[e] += rest[j][e / 3] * gradient[j][e % 3];
  }
  double off = 0;
  for (int e = 0; e < 9; e++) off = std::max(off, std::abs(F[e] - kIdentity[e]));
  return off < kSameShape;
}

// Which factor each material follows.  constants: how many the laws have of all of them.
std::vector<int32_t> ReadFactors(size_t constants, int factors, Reader* reader) {
  reader->Check(constants % kLawConstants == 0, "law_constants has not as many values for each material");
  std::vector<int32_t> factor = reader->ArrayOr<int32_t>("law_factor", 0, constants / kLawConstants);
  const bool known = std::all_of(factor.begin(), factor.end(), [=](int32_t i) { return i >= 0 && i < factors; });
  return reader->Check(known, "a material has no factor") ? factor : std::vector<int32_t>(factor.size(), 0);
}

// The cells of a hyperelastic law, added to the regions.
void ReadCells(Law law, int factors, std::vector<Region>* regions, Reader* reader) {
  constexpr char kMismatch[] = "its cell arrays do not match each other";
  const auto constants = reader->Array<double>("law_constants");
  const auto count = reader->Array<int32_t>("cell_count");
  const auto volume = reader->Array<double>("cell_volume");
  const auto material = reader->Array<int32_t>("cell_material");
  const auto slope = reader->Array<double>("cell_slope");
  const std::vector<int32_t> factor = ReadFactors(constants.size(), factors, reader);
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
      region.cells.push_back({volume[first],
                              ParametersOf(law, constants.data() + at),
                              factor[material[first]],
                              {slope.begin() + s, slope.begin() + s + length}});
    }
  }
  reader->Check(first == volume.size() && s == slope.size(), kMismatch);
}

// Of one frame each, or of the law `corotational`.
std::vector<Region> ReadRegions(const std::vector<Coupling>& couplings, const std::vector<ControlPoint>& points,
                                int factors, Reader* reader) {
  const auto gradient = reader->Array<double>("region_gradient");
  const auto stiffness = reader->Array<double>("region_stiffness");
  const auto enlargement = reader->ArrayOr<double>("region_enlargement", 1, couplings.size());
  std::vector<int32_t> own(couplings.size(), 0);
  std::vector<double> share;
  if (factors > 1) {
    own = reader->ArrayOr<int32_t>("region_own", 0, couplings.size());
    share = reader->Array<double>("region_share");
  }
  if (!reader->ok()) return {};
  size_t p = 0, s = 0, t = 0;
  std::vector<Region> regions;
  for (const Coupling& coupling : couplings) {
    const int m = static_cast<int>(coupling.point.size());
    const size_t n = 3 * static_cast<size_t>(m);
    if (!reader->Check(3 * (p + m) <= gradient.size() && s + n * (n + 1) / 2 <= stiffness.size(), kRegionMismatch))
      return {};
    Region region;
    region.law = {};
    region.number = static_cast<int>(regions.size());
    region.point = coupling.point;
    region.pair = coupling.pair;
    region.enlargement = enlargement[regions.size()];
    Vec3 mean{};
    for (const int32_t j : region.point) mean = mean + (1.0 / m) * points[j].rest;
    region.gradient = Vectors(gradient, p, m);
    for (int j = 0; j < m; j++) region.rest.push_back(points[region.point[j]].rest - mean);
    region.solid = ShowsAll(region.rest, region.gradient);
    region.stiffens = reader->Has("region_stiffens");
    region.stiffness.resize(n * n);
    for (size_t row = 0; row < n; row++) {
      for (size_t col = 0; col <= row; col++) {
        region.stiffness[row * n + col] = region.stiffness[col * n + row] = stiffness[s++];
      }
    }
    if (factors > 1) {
      region.shares.own = 3 * std::clamp(own[regions.size()], 0, m);
      const size_t size = (factors - 1) * ShareSize(static_cast<int>(n), region.shares.own);
      if (!reader->Check(own[regions.size()] > 0 && own[regions.size()] <= m && t + size <= share.size(),
                         "its shares of materials do not match its regions")) {
        return {};
      }
      region.shares.rows.assign(share.begin() + t, share.begin() + t + size);
      region.shares.rest = RestOf(region.stiffness, static_cast<int>(n), region.shares.own);
      t += size;
    }
    p += m;
    regions.push_back(std::move(region));
  }
  reader->Check(3 * p == gradient.size() && s == stiffness.size() && t == share.size(), kRegionMismatch);
  return regions;
}

// The other laws, at quadrature points.
std::vector<QuadratureRegion> ReadQuadrature(const std::vector<Coupling>& couplings, Law law, int factors,
                                             Reader* reader) {
  constexpr char kMismatch[] = "its quadrature arrays do not match each other";
  const auto constants = reader->Array<double>("law_constants");
  const auto count = reader->Array<int32_t>("quadrature_count");
  const auto volume = reader->Array<double>("quadrature_volume");
  const auto material = reader->Array<int32_t>("quadrature_material");
  const auto gradient = reader->Array<double>("quadrature_gradient");
  const std::vector<int32_t> factor = ReadFactors(constants.size(), factors, reader);
  if (!reader->Check(count.size() == couplings.size() && material.size() == volume.size(), kMismatch)) return {};
  size_t first = 0, g = 0;
  std::vector<QuadratureRegion> regions;
  for (size_t e = 0; e < couplings.size(); e++) {
    const size_t q = std::max(count[e], 0), length = 3 * q * couplings[e].point.size();
    if (!reader->Check(q > 0 && first + q <= volume.size() && g + length <= gradient.size(), kMismatch)) return {};
    std::vector<LawParameters> parameters;
    std::vector<int32_t> follows;
    for (size_t i = first; i < first + q; i++) {
      const size_t at = kLawConstants * static_cast<size_t>(std::max(material[i], 0));
      if (!reader->Check(material[i] >= 0 && at < constants.size(), "a quadrature point has no material")) return {};
      parameters.push_back(ParametersOf(law, constants.data() + at));
      follows.push_back(factor[material[i]]);
    }
    regions.emplace_back(law, couplings[e].point, gradient.data() + g, volume.data() + first, parameters.data(),
                         static_cast<int>(q), couplings[e].pair, std::move(follows));
    first += q;
    g += length;
  }
  reader->Check(first == volume.size() && g == gradient.size(), kMismatch);
  std::stable_sort(regions.begin(), regions.end(), [](const auto& a, const auto& b) { return a.point < b.point; });
  return regions;
}

std::vector<Patch> ReadPatches(const mjModel* m, int instance, const std::vector<ControlPoint>& points, int factors,
                               Reader* reader) {
  constexpr char kMismatch[] = "its patch arrays do not match each other";
  std::vector<Patch> patches;
  for (int geom = 0; geom < m->ngeom; geom++) {
    if (SoftInstanceOf(m, geom) != instance) continue;
    patches.emplace_back();
    patches.back().geom = geom;
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
  std::vector<double> dent;
  std::vector<int32_t> factor;
  if (reader->Has("patch_dent")) {
    dent = reader->Array<double>("patch_dent");
    factor = reader->Array<int32_t>("patch_factor");
    const bool match = dent.size() == 3 * factor.size();
    const auto [least, largest] = std::minmax_element(factor.begin(), factor.end());
    const bool are = match && !factor.empty() && *least >= 0 && *largest < factors;
    const bool positive = std::all_of(dent.begin(), dent.end(), [](double value) { return value >= 0; });
    if (!reader->Check(are && positive, "the dents of its patches do not match each other, or are negative")) return {};
  }
  if (!reader->Check(size.size() == patches.size() && clusters.size() == patches.size(),
                     "its patch geoms do not match its patches")) {
    return {};
  }
  size_t p = 0, w = 0, c = 0, v = 0;
  for (size_t i = 0; i < patches.size(); i++) {
    Patch& patch = patches[i];
    const size_t count = std::max(size[i], 0), groups = std::max(clusters[i], 0);
    if (!reader->Check(groups > 0 && groups <= kMaxClusters && c + groups <= cluster_size.size(), kMismatch)) return {};
    patch.cluster.assign(cluster_size.begin() + c, cluster_size.begin() + c + groups);
    size_t n = 0;
    for (const int32_t vertices : patch.cluster) {
      if (!reader->Check(vertices > 0 && vertices <= kMaxPatchVertices, "a cluster of a patch has no valid size")) {
        return {};
      }
      n += vertices;
    }
    const bool there = p + count <= point.size() && w + count * n <= weight.size();
    if (!reader->Check(there && count > 0 && n <= kMaxPatchVertices, kMismatch)) return {};
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
      if (!reader->Check(3 * (v + n) <= offset.size(), kMismatch)) return {};
      patch.offset.assign(offset.begin() + 3 * v, offset.begin() + 3 * (v + n));
    }
    if (!dent.empty()) {
      if (!reader->Check(v + n <= factor.size(), kMismatch)) return {};
      for (size_t s = v; s < v + n; s++) patch.dent.push_back({dent[3 * s], dent[3 * s + 1], dent[3 * s + 2]});
      patch.factor.assign(factor.begin() + v, factor.begin() + v + n);
    }
    p += count;
    w += count * n;
    c += groups;
    v += n;
  }
  const bool all = p == point.size() && w == weight.size() && c == cluster_size.size();
  const bool each = (offset.empty() || 3 * v == offset.size()) && (dent.empty() || v == factor.size());
  reader->Check(all && each, kMismatch);
  return patches;
}

// How wide the body is across the normal of each vertex: in the mean over its thickness there.
void SetSections(double volume, std::vector<Patch>* patches) {
  for (Patch& patch : *patches) {
    for (Dent& dent : patch.dent) dent.section = dent.thickness > 0 ? volume / dent.thickness : 0;
  }
}

DistanceField ReadDistanceField(int points, const std::vector<Patch>& patches, Reader* reader) {
  DistanceField field;
  field.spacing = reader->Number("lattice_spacing");
  field.axes = reader->Array<double>("lattice_axes");
  field.origin = reader->Array<double>("lattice_origin");
  field.shape = reader->Array<int32_t>("lattice_shape");
  field.node = reader->Array<int32_t>("lattice_node");
  field.distance = reader->Array<double>("lattice_distance");
  field.patch = reader->Array<int32_t>("lattice_patch");
  const auto weight = reader->Array<int32_t>("lattice_weight");
  field.vertex = reader->Array<double>("lattice_vertex");
  field.normal = reader->Array<int32_t>("lattice_normal");
  const auto size = reader->Array<int32_t>("set_size");
  const auto point = reader->Array<int32_t>("set_point");
  const auto set = reader->Array<int32_t>("lattice_set");
  int vertices = 0;
  for (const Patch& patch : patches) vertices += patch.vertices;
  if (!reader->ok()) return {};
  constexpr char kMismatch[] = "its lattice arrays do not match each other";
  std::vector<size_t> start(1, 0);
  for (const int32_t points_of_set : size) {
    const size_t first = start.back(), end = first + std::max(points_of_set, 0);
    if (!reader->Check(end > first && end <= point.size(), kMismatch)) return {};
    for (size_t e = first; e < end; e++) {
      const bool in_order = point[e] > (e > first ? point[e - 1] : -1) && point[e] < points;
      if (!reader->Check(in_order, "a set of its lattice has control points twice, unordered or not of the body")) {
        return {};
      }
    }
    start.push_back(end);
  }
  if (!reader->Check(start.back() == point.size() && points <= UINT16_MAX, kMismatch)) return {};
  for (const int32_t some : set) {
    if (!reader->Check(some >= 0 && some < static_cast<int32_t>(size.size()), kMismatch)) return {};
    const size_t first = start[some], end = start[some + 1];
    if (!reader->Check(field.weight.size() + end - first <= weight.size(), kMismatch)) return {};
    int64_t sum = 0;  // at most UINT16_MAX × INT16_MAX, an int
    for (size_t e = first; e < end; e++) {
      const int32_t units = weight[field.weight.size()];
      const bool fits = units >= -INT16_MAX && units <= INT16_MAX && units != 0;
      if (!reader->Check(fits, "a weight of its lattice is zero or has more than 16 bits")) return {};
      field.weight.push_back({static_cast<int16_t>(units), static_cast<uint16_t>(point[e])});
      sum += units;
    }
    if (!reader->Check(sum > 0, "the weights of a node of its lattice have no positive sum")) return {};
    field.count.push_back(static_cast<int32_t>(end - first));
    field.units.push_back(static_cast<int32_t>(sum));
  }
  if (!reader->Check(field.weight.size() == weight.size(), kMismatch)) return {};
  const std::string wrong = field.Finish(static_cast<int>(patches.size()), vertices);
  if (!wrong.empty()) reader->Fail(wrong);
  return field;
}

// Every point is a pair with itself that carries its mass.
void AssignMass(SoftModel* model) {
  Kinematics& kinematics = model->kinematics;
  std::vector<double>& difference = model->mass_difference;
  const size_t points = kinematics.points().size();
  std::vector<int> own(points);
  for (size_t j = 0; j < points; j++) kinematics.Couple(static_cast<int>(j), static_cast<int>(j), &own[j]);
  difference.resize(kinematics.pairs().size(), 0.0);
  model->has_difference = std::any_of(difference.begin(), difference.end(), [](double m) { return m != 0; });
  model->mass = difference;
  for (size_t j = 0; j < points; j++) model->mass[own[j]] += kinematics.points()[j].mass;
}

std::unique_ptr<const SoftModel> ReadModel(const mjModel* m, int instance, Reader* reader) {
  auto model = std::make_unique<SoftModel>();
  ElasticModel& elastic = model->elastic;
  if (std::strcmp(reader->Text("version"), kVersion) != 0) {
    reader->Fail(std::string("its data has version '") + reader->Text("version") + "', this plugin reads version " +
                 kVersion + ": build it again with the mjframes that is installed");
  }
  const std::optional<Law> law = LawOfName(reader->Text("law"));
  reader->Check(law || std::strcmp(reader->Text("law"), "corotational") == 0,
                "law has to be 'corotational', 'green_lagrange', 'neo_hookean', 'mooney_rivlin' or 'arruda_boyce'");
  model->implicit = std::strcmp(reader->Text("mode"), "explicit") != 0;
  reader->Check(!model->implicit || std::strcmp(reader->Text("mode"), "implicit") == 0,
                "mode has to be 'implicit' or 'explicit'");
  model->changes_inertia = model->implicit || reader->Has("region_mass");
  if (reader->ok()) {
    model->alpha = reader->Number("alpha");
    model->beta = reader->Number("beta");
    if (reader->Has("materials")) elastic.factors = reader->Count("materials", kMaxMaterials);
  }
  if (reader->ok()) model->kinematics.Create(m, instance, reader);
  std::vector<Coupling> couplings;
  if (reader->ok()) couplings = ReadCouplings(&model->kinematics, &model->mass_difference, reader);
  const bool at_points = law && !reader->Has("cell_count");
  if (reader->ok() && at_points) elastic.quadrature = ReadQuadrature(couplings, *law, elastic.factors, reader);
  if (reader->ok() && !at_points) {
    elastic.regions = ReadRegions(couplings, model->kinematics.points(), elastic.factors, reader);
  }
  if (reader->ok() && law && !at_points) ReadCells(*law, elastic.factors, &elastic.regions, reader);
  if (reader->ok()) AssignMass(model.get());
  if (reader->ok()) model->kinematics.Finish(m, reader);
  const std::vector<ControlPoint>& points = model->kinematics.points();
  ContactModel& contact = model->contact;
  if (reader->ok()) contact.patches = ReadPatches(m, instance, points, elastic.factors, reader);
  const int patches = static_cast<int>(contact.patches.size());
  if (reader->ok() && patches > 0) {
    contact.reach = reader->Number("contact_reach");
    contact.has_volume = reader->Has("lattice_spacing") || reader->Has("lattice_node");
    if (contact.has_volume) {
      contact.field = ReadDistanceField(static_cast<int>(points.size()), contact.patches, reader);
      SetSections(contact.field.Volume(), &contact.patches);
    }
    const std::vector<Vec3> rest = RestVertices(contact, model->kinematics);
    for (int i = 0; reader->ok() && i < patches; i++) {
      PatchVolume& volume = contact.patches[i].volume;
      if (contact.has_volume) volume = PatchVolume::Create(m, contact, model->kinematics, i);
      volume.SetCover(contact, rest, i);
    }
    contact.round_spacing = RoundSpacing(contact, rest);
  }
  if (reader->ok() && at_points && reader->Has("region_enlargement")) {
    elastic.enlarges = true;
    for (const double value : reader->Array<double>("region_enlargement")) {
      elastic.enlargement = std::max(elastic.enlargement, value);
    }
  }
  if (!reader->ok()) return nullptr;
  for (const Region& region : elastic.regions) elastic.enlarges = elastic.enlarges || region.enlargement != 1;
  elastic.batches = BatchesOf(elastic.regions);
  return model;
}

}  // namespace

// All that ReadModel and the kinematics look at.
std::shared_ptr<const SoftModel> FindModel(const mjModel* m, int instance, Reader* reader) {
  Key key;
  const int first = m->plugin_attradr[instance], joints = m->njnt, bodies = m->nbody;
  int end = m->npluginattr;
  for (int other = 0; other < m->nplugin; other++) {
    if (m->plugin_attradr[other] > first) end = std::min(end, m->plugin_attradr[other]);
  }
  key.Add(m->plugin_attr + first, end - first).Add(&instance, 1).Add(m->plugin, m->nplugin);
  key.Add(m->body_plugin, bodies).Add(m->body_parentid, bodies).Add(m->body_treeid, bodies);
  key.Add(m->body_jntnum, bodies).Add(m->body_jntadr, bodies).Add(m->body_dofnum, bodies).Add(m->body_dofadr, bodies);
  key.Add(m->body_quat, 4 * static_cast<size_t>(bodies));
  key.Add(m->jnt_type, joints).Add(m->jnt_bodyid, joints).Add(m->jnt_axis, 3 * static_cast<size_t>(joints));
  key.Add(m->geom_plugin, m->ngeom).Add(m->geom_bodyid, m->ngeom);
  key.Add(m->actuator_trntype, m->nactuator).Add(m->actuator_trnid, 2 * static_cast<size_t>(m->nactuator));
  const int tendons = CountOwnTendons(m);
  key.Add(&tendons, 1).Add(m->M_rownnz, m->nv).Add(m->M_rowadr, m->nv).Add(m->M_colind, m->nM);
  return Interned<SoftModel>(key.text(), [&] { return ReadModel(m, instance, reader); });
}

}  // namespace mjframes
