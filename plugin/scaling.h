// How stiff and how damped a soft body is in one model, to what it was built with: read from the model's numerics in
// each step, so that models that differ in nothing else are worlds of their own (mjframes/scene/scaling.py).

#ifndef MJFRAMES_PLUGIN_SCALING_H_
#define MJFRAMES_PLUGIN_SCALING_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "attributes.h"

namespace mjframes {

struct Scaling {
  std::vector<double> stiffness;  // of the moduli of each material [-]
  double alpha = 1, beta = 1;     // of Rayleigh's damping [-]
};

// The numerics `steak:stiffness` and `steak:damping` of plugin instance `steak`; where a model has none, they are 1.
class ScalingReader {
 public:
  // materials: how many can be scaled.
  ScalingReader(const mjModel* m, int instance, int materials, Reader* reader);

  // What is not positive and finite counts as 1, and is told of once.
  const Scaling& Read(const mjModel* m);

  // What was read last.
  const Scaling& latest() const { return read_; }

 private:
  double Checked(const mjModel* m, int numeric, int entry);

  int stiffness_, damping_;  // numerics, −1 for none
  Scaling read_;
  bool told_ = false;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SCALING_H_
