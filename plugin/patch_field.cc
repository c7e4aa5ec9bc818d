#include "patch_field.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <mutex>

#include "constants.h"
#include "placed.h"
#include "plugin.h"
#include "world.h"

namespace mjframes {
namespace {

int g_slot = -1;  // of this plugin in MuJoCo's registry; written once, at load

// What an instance stands for.
struct PatchField {
  static std::unique_ptr<PatchField> Create(const mjModel* m, int instance);

  int geom;
  int instance;  // of the soft body
};

// Unit vector from a to b; z where they meet.
Vec3 Direction(const Vec3& a, const Vec3& b) {
  const double length = Norm(b - a);
  return length > mjMINVAL ? (1 / length) * (b - a) : Vec3{0, 0, 1};
}

double Measure(const Placed& soft, const Vec3& p, Vec3* normal) {
  const PatchVolume& volume = soft.deformed.patch().volume;
  const double resolution = soft.room, cover = (volume.solid ? volume.cover : volume.spread) * soft.pose.stretch;
  const AlignedBox& box = volume.solid ? soft.pose.box : soft.state->VertexBox(soft.number);
  Vec3 nearest;  // of the box
  for (int i = 0; i < 3; i++) nearest[i] = std::clamp(p[i], box.centre[i] - box.half[i], box.centre[i] + box.half[i]);
  const double gap = Norm(p - nearest);
  if (gap > cover + resolution) {
    *normal = Direction(nearest, p);
    return volume.solid ? gap : gap - cover;
  }
  double distance;
  bool own;
  if (volume.solid && soft.Distance(p, soft.state->FieldCube(soft.number), &distance, normal, &own)) {
    if (std::abs(distance) < kThere * resolution) return 0;
    if (distance > 0) return kCareful * distance;
    if (own) return distance;
  }
  const double* vertices = soft.state->Vertices(soft.number);
  const int n = soft.deformed.patch().vertices, s = soft.NearestVertex(p);
  const Vec3 vertex = Vertex(vertices, n, s);
  *normal = Direction(vertex, p);
  distance = Norm(p - vertex) - cover;
  return volume.solid ? std::max({gap, distance, kRayStep * resolution}) : distance;
}

// Signed distance [m] of p (world) from the part of the body under a patch, and which way is out. Inside it is that of
// the surface; outside it is at most that of the nearest point, and rays that go on by it come to the surface.
double FieldDistance(const SoftContact& contact, int patch, const mjData* d, const Vec3& p, Vec3* normal) {
  const std::lock_guard lock(contact.state()->mutex);
  contact.state()->Update(d);
  SurfaceState::FieldPoint* known = contact.state()->Asked(patch, p);
  if (!known->found) {
    known->distance = Measure(Place(contact, patch, d, contact.model().resolution()), p, &known->normal);
    known->found = true;
  }
  *normal = known->normal;
  return known->distance;
}

double Evaluate(const mjtNum point[3], const mjData* d, int instance, mjtNum* gradient) {
  const auto* field = DataOf<const PatchField>(d, instance);
  const SoftContact& contact = GetSoftBody(d, field->instance)->contact();
  const int patch = contact.FindPatch(field->geom);
  if (patch < 0) return mjMAXVAL;
  const Mat3 axes = ToMat3(d->geom_xmat + 9 * field->geom);
  Vec3 p = ToVec3(d->geom_xpos + 3 * field->geom) + Mul(axes, ToVec3(point));
  for (double& component : p) component = (component + kRounder) - kRounder;
  Vec3 normal;
  const double distance = FieldDistance(contact, patch, d, p, &normal);
  if (gradient) {
    const Vec3 local = MulT(axes, normal);
    std::copy(local.begin(), local.end(), gradient);
  }
  return distance;
}

std::unique_ptr<PatchField> PatchField::Create(const mjModel* m, int instance) {
  const auto* geom = std::find(m->geom_plugin, m->geom_plugin + m->ngeom, instance);
  const int found = static_cast<int>(geom - m->geom_plugin);
  const int owner = found < m->ngeom ? SoftInstanceOf(m, found) : -1;
  if (owner < 0 || !IsSoftBody(m, owner)) {
    mju_warning("mjframes: '%s' is an instance of %s, which goes with the patches of a soft body only: attach one.",
                m->names + m->name_pluginadr[instance], kPatchPluginName);
    return nullptr;
  }
  return std::make_unique<PatchField>(PatchField{found, owner});
}

}  // namespace

int SoftInstanceOf(const mjModel* m, int geom) {
  const int instance = m->geom_plugin[geom];
  return instance >= 0 && m->plugin[instance] == g_slot ? m->body_plugin[m->geom_bodyid[geom]] : -1;
}

void RegisterPatchField() {
  mjpPlugin plugin = PluginWith<PatchField>(kPatchPluginName, mjPLUGIN_SDF);
  plugin.compute = +[](const mjModel*, mjData*, int, int) {};
  plugin.sdf_distance =
      +[](const mjtNum point[3], const mjData* d, int instance) { return Evaluate(point, d, instance, nullptr); };
  plugin.sdf_gradient = +[](mjtNum gradient[3], const mjtNum point[3], const mjData* d, int instance) {
    Evaluate(point, d, instance, gradient);
  };
  // a mesh made of the field, which MuJoCo asks for before there is a body: empty
  plugin.sdf_staticdistance = +[](const mjtNum*, const mjtNum*) -> mjtNum { return 1; };
  plugin.sdf_aabb = +[](mjtNum aabb[6], const mjtNum*) { std::fill(aabb, aabb + 6, 1.0); };
  g_slot = mjp_registerPlugin(&plugin);
}

}  // namespace mjframes
