// mjData's own stack, where a step gets the memory whose size depends on the contacts.

#ifndef MJFRAMES_PLUGIN_STACK_H_
#define MJFRAMES_PLUGIN_STACK_H_

#include <mujoco/mujoco.h>

#include <cstddef>

#include "constants.h"

#ifdef ADDRESS_SANITIZER
// MuJoCo's headers then replace both by functions that its own library, built without the sanitizer, does not have.
extern "C" void MarkStack(mjData* d) __asm__("mj_markStack");
extern "C" void FreeStack(mjData* d) __asm__("mj_freeStack");
#else
inline void MarkStack(mjData* d) { mj_markStack(d); }
inline void FreeStack(mjData* d) { mj_freeStack(d); }
#endif

namespace mjframes {

// Whether it has room for so many numbers, and as many for MuJoCo's solver.
inline bool HasRoom(const mjData* d, size_t numbers) {
  return 2 * sizeof(mjtNum) * numbers + kStackReserve < static_cast<size_t>(d->narena) - d->pstack - d->parena;
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_STACK_H_
