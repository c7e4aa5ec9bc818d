#include "world.h"

#include <algorithm>
#include <utility>

#include "parse.h"
#include "plugin.h"
#include "requirements.h"
#include "stack.h"
#include "tendon.h"
#include "touch.h"

namespace mjframes {
namespace {

int g_slot = -1;  // of this plugin in MuJoCo's registry; written once, at load

// Whether no instance before this one is a soft body's. plugin: the slot of each.
bool IsFirst(const int* plugin, int instance) {
  return std::find(plugin, plugin + instance, g_slot) == plugin + instance;
}

}  // namespace

std::unique_ptr<World> World::Create(const mjModel* m) {
  std::vector<std::unique_ptr<SoftBody>> bodies;
  for (int instance = 0; instance < m->nplugin; instance++) {
    if (!IsSoftBody(m, instance)) continue;
    bodies.push_back(SoftBody::Create(m, instance));
    if (!bodies.back()) return nullptr;
  }
  return std::unique_ptr<World>(new World(m, std::move(bodies)));
}

World::World(const mjModel* m, std::vector<std::unique_ptr<SoftBody>> bodies)
    : bodies_(std::move(bodies)),
      of_instance_(m->nplugin),
      factor_(m, ChangedTrees(m)),
      contact_rows_(m),
      rows_(m, ChangedDofs(m)) {
  for (const std::unique_ptr<SoftBody>& body : bodies_) {
    const SoftModel& model = body->model();
    of_instance_[body->instance()] = body.get();
    adds_ = adds_ || (model.changes_inertia && !model.kinematics.replaces());
    touches_ = touches_ || !model.contact.patches.empty();
    dents_ = dents_ || model.contact.makes_dents();
  }
  for (int instance = 0; instance < m->nplugin; instance++) {
    if (IsTendon(m, instance)) tendons_.push_back(instance);
  }
}

// The kinematic trees whose inertia the soft bodies change.
std::vector<bool> World::ChangedTrees(const mjModel* m) const {
  std::vector<bool> changed(m->ntree, false);
  for (const std::unique_ptr<SoftBody>& soft : bodies_) {
    for (int body = 1; soft->model().changes_inertia && body < m->nbody; body++) {
      const int tree = m->body_treeid[body];
      if (m->body_plugin[body] == soft->instance() && tree >= 0) changed[tree] = true;
    }
  }
  return changed;
}

// Whether each degree of freedom is one of a soft body that changes the inertia.
std::vector<char> World::ChangedDofs(const mjModel* m) const {
  std::vector<char> changed(m->nv, 0);
  for (const std::unique_ptr<SoftBody>& body : bodies_) {
    if (!body->model().changes_inertia) continue;
    for (const Mover& mover : body->kinematics().movers()) std::fill_n(changed.begin() + mover.dof, mover.dofs, 1);
  }
  return changed;
}

// visit(tendon, its soft body)
template <typename Visit>
void World::ForTendons(const mjData* d, const Visit& visit) const {
  for (const int instance : tendons_) {
    Tendon* tendon = GetTendon(d, instance);
    visit(tendon, *Body(tendon->soft()));
  }
}

void World::Step(const mjModel* m, mjData* d) {
  const double h = m->opt.timestep;
  bool fast = false;
  const auto awake = [&](const SoftBody& body) { return !body.kinematics().Asleep(m, d); };

  // forces: qfrc_passive += Jᵀ (f − (h + β) K v − α M v − D dJ/dt qvel)
  for (const std::unique_ptr<SoftBody>& body : bodies_) {
    if (!awake(*body)) continue;
    body->Locate(m, d);
    body->AddElasticity(d);
    body->AddDamping(h);
    fast = body->IsFast(h, d->nefc > 0) || fast;
    body->AddMassBias(m, d);
    body->StoreForce(d);
  }
  ForTendons(d, [&](Tendon* tendon, const SoftBody& body) {
    tendon->CheckFlags(m);
    if (tendon->has_gas() && awake(body)) tendon->AddGas(m, d);
  });

  // inertia: d->M += Jᵀ ((h² + h β) K + h α M + D) J. The step may be called again on the same position: what is added
  // to starts from the rigid inertia each time.
  const auto store_inertia = [&](bool consistent) {
    for (const std::unique_ptr<SoftBody>& body : bodies_) {
      if (body->model().changes_inertia && awake(*body)) body->StoreInertia(m, d, consistent);
    }
    ForTendons(d, [&](Tendon* tendon, const SoftBody& body) {
      if (tendon->has_gas() && awake(body)) tendon->AddGasInertia(m, d);
    });
  };
  // factor: d->M = Lᵀ D L. Consistent masses miss how what all of a body hangs on turns it: with points in far places
  // d->M can lose its definiteness. Lumped ones keep it.
  const auto factor = [&] {
    if (adds_) mj_makeM(m, d);
    store_inertia(true);
    if (factor_.Factor(m, d)) return;
    mj_makeM(m, d);
    store_inertia(false);
    factor_.Factor(m, d);
  };
  factor();

  // rows: of each contact tᵀ Σ_j ω_j J_j, then the impedance of all for the inertia as it is now, and their forces
  const bool starts = Starts(m, d);
  fast = fast && !IsInverse(d);
  MarkStack(d);
  ContactDents* dents = nullptr;
  const bool has_room = HasRoom(d, d->ncon * sizeof(ContactDents) / sizeof(mjtNum));
  if (dents_ && has_room) {
    dents = static_cast<ContactDents*>(mj_stackAllocByte(d, d->ncon * sizeof(ContactDents), alignof(ContactDents)));
  }
  double* lies = HasRoom(d, d->ncon) ? mj_stackAllocNum(d, d->ncon) : nullptr;
  WriteContactRows(m, d, &contact_rows_, dents, lies);
  bool dented = rows_.Finish(m, d, dents, lies, starts);

  // corrections: of bodies that would make energy in this step, before it is taken
  double* a = fast && HasRoom(d, 2 * m->nv) ? mj_stackAllocNum(d, m->nv) : nullptr;
  for (int pass = 0; a && pass < kCorrections; pass++) {
    bool firmer = false, corrected = false;
    Foresee(m, d, starts, a);
    for (const std::unique_ptr<SoftBody>& body : bodies_) {
      if (awake(*body)) corrected |= body->Correct(m, d, a, pass == kCorrections - 1, &firmer);
    }
    if (!corrected) break;
    if (firmer) factor();
    dented = rows_.Finish(m, d, dents, lies, starts);
  }
  FreeStack(d);
  if (dents_ && !told_memory_ && !(has_room && dented)) {
    mju_warning("mjframes: the memory of mjData is too small for the dents of %d contacts: give <size memory> more.",
                d->ncon);
    told_memory_ = true;
  }
}

void World::CheckOptions(const mjModel* m) {
  for (const std::unique_ptr<SoftBody>& body : bodies_) {
    const SoftModel& model = body->model();
    const char* wrong = told_ ? nullptr : WrongOption(m, model.implicit, model.changes_inertia);
    if (!wrong) continue;
    mju_warning("mjframes: soft body '%s': %s.", m->names + m->name_pluginadr[body->instance()], wrong);
    told_ = true;
  }
  if (touches_ && m->opt.sdf_initpoints < kMaxTouches && !told_few_) {
    mju_warning(
        "mjframes: option sdf_initpoints is %d, and MuJoCo gives a patch of a soft body no more contacts with a "
        "geom: leave it at 40, or at %d at least.",
        m->opt.sdf_initpoints, kMaxTouches);
    told_few_ = true;
  }
  if (!touches_ || told_number_) return;
  if (const auto [geom, name] = FirstWrongNumber(m); name) {
    mju_warning(
        "mjframes: geom %d '%s' has a %s that is no finite number: it does not touch soft bodies until it has one.",
        geom, m->names + m->name_geomadr[geom], name);
    told_number_ = true;
  }
}

bool IsSoftBody(const mjModel* m, int instance) { return instance >= 0 && m->plugin[instance] == g_slot; }

SoftBody* GetSoftBody(const mjData* d, int instance) {
  return instance >= 0 && d->plugin[instance] == g_slot ? DataOf<World>(d, instance)->Body(instance) : nullptr;
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

// The first instance of an mjData owns its world, which the others point to.
void RegisterWorld() {
  mjpPlugin plugin = StatelessPlugin(kPluginName, mjPLUGIN_PASSIVE);
  plugin.nattribute = sizeof(kSoftAttributes) / sizeof(kSoftAttributes[0]);
  plugin.attributes = kSoftAttributes;
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    const auto first = static_cast<int>(std::find(m->plugin, m->plugin + instance, g_slot) - m->plugin);
    World* world = first == instance ? World::Create(m).release() : DataOf<World>(d, first);
    SetData(d, instance, world);
    return world ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    if (IsFirst(d->plugin, instance)) delete DataOf<World>(d, instance);
    SetData<World>(d, instance, nullptr);
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int) {
    if (IsFirst(m->plugin, instance)) DataOf<World>(d, instance)->Step(m, d);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    if (IsFirst(m->plugin, instance)) DataOf<World>(d, instance)->CheckOptions(m);
  };
  g_slot = mjp_registerPlugin(&plugin);
}

}  // namespace mjframes
