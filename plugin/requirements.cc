#include "requirements.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace mjframes {
namespace {

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

void CheckContactNumbers(const mjModel* m, Reader* reader) {
  const auto [geom, name] = FirstWrongNumber(m);
  if (!name) return;
  reader->Fail(std::string("geom ") + std::to_string(geom) + " '" + (m->names + m->name_geomadr[geom]) +
               "', which it may touch, has a " + name + " that is no finite number: give it one");
}

}  // namespace

const char* WrongOption(const mjModel* m, bool implicit, bool changes_inertia) {
  constexpr int kNoPassiveForces = mjDSBL_SPRING | mjDSBL_DAMPER;
  const bool effective = changes_inertia && m->opt.integrator != mjINT_DISCRETE;
  if (m->opt.integrator == mjINT_RK4 && implicit) {
    return "integrator RK4 evaluates forces between steps and cannot hold implicit elasticity: use Euler, "
           "implicitfast, implicit or discrete, or build the body with mode=\"explicit\"";
  }
  if (effective && m->opt.solver == mjSOL_PGS) {
    return "solver PGS does not see the effective inertia: use Newton or CG";
  }
  if (effective && m->opt.noslip_iterations != 0) {
    return "the noslip solver does not see the effective inertia: set noslip_iterations to 0";
  }
  if ((m->opt.disableflags & kNoPassiveForces) == kNoPassiveForces) {
    return "springs and dampers are both disabled, and MuJoCo then leaves out all passive forces, elasticity among "
           "them: use at least one of the two";
  }
  return nullptr;
}

const char* WrongNumber(const mjModel* m, int geom) {
  const struct {
    const char* name;
    const mjtNum* values;
    int size;
  } arrays[] = {
      {"friction", m->geom_friction, 3}, {"margin", m->geom_margin, 1},      {"gap", m->geom_gap, 1},
      {"solmix", m->geom_solmix, 1},     {"solref", m->geom_solref, mjNREF}, {"solimp", m->geom_solimp, mjNIMP}};
  for (const auto& [name, values, size] : arrays) {
    const mjtNum* first = values + size * geom;
    if (!std::all_of(first, first + size, [](mjtNum value) { return std::isfinite(value); })) return name;
  }
  return nullptr;
}

std::pair<int, const char*> FirstWrongNumber(const mjModel* m) {
  for (int geom = 0; geom < m->ngeom; geom++) {
    if (!m->geom_contype[geom] && !m->geom_conaffinity[geom]) continue;
    if (const char* name = WrongNumber(m, geom)) return {geom, name};
  }
  return {-1, nullptr};
}

void CheckRequirements(const mjModel* m, const SoftModel& model, Reader* reader) {
  if (const char* wrong = WrongOption(m, model.implicit, model.changes_inertia)) reader->Fail(wrong);
  reader->Check(
      !(m->opt.enableflags & mjENBL_SLEEP) || !model.kinematics.MissesWaking(m),
      "it is attached to bodies of several kinematic trees, or to a mocap body, and MuJoCo would not wake one "
      "with the other: give the root body of each tree sleep=\"never\", or disable sleep");
  if (model.contact.patches.empty()) return;
  CheckContactNumbers(m, reader);
  CheckHeightFields(m, model.contact.patches.front().geom, reader);
  CheckFlexes(m, model.contact.patches.front().geom, reader);
}

}  // namespace mjframes
