// What the engine plugins of this library have in common: none has a state in mjData's arrays, and what belongs to one
// mjData hangs on its plugin_data.

#ifndef MJFRAMES_PLUGIN_PLUGIN_H_
#define MJFRAMES_PLUGIN_PLUGIN_H_

#include <mujoco/mujoco.h>

#include <cstdint>
#include <memory>

namespace mjframes {

template <typename T>
T* DataOf(const mjData* d, int instance) {
  return reinterpret_cast<T*>(d->plugin_data[instance]);
}

template <typename T>
void SetData(mjData* d, int instance, T* value) {
  d->plugin_data[instance] = reinterpret_cast<uintptr_t>(value);
}

inline mjpPlugin StatelessPlugin(const char* name, int capabilities) {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = name;
  plugin.capabilityflags = capabilities;
  plugin.nstate = +[](const mjModel*, int) { return 0; };
  plugin.reset = +[](const mjModel*, mjtNum*, void*, int) {};
  return plugin;
}

// One with a T of its own for each instance: T::Create(m, instance), null on failure.
template <typename T>
mjpPlugin PluginWith(const char* name, int capabilities) {
  mjpPlugin plugin = StatelessPlugin(name, capabilities);
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    T* made = T::Create(m, instance).release();
    if (made) SetData(d, instance, made);
    return made ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete DataOf<T>(d, instance);
    SetData<T>(d, instance, nullptr);
  };
  return plugin;
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PLUGIN_H_
