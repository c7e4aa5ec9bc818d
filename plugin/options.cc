#include "options.h"

namespace mjframes {

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

}  // namespace mjframes
