// What of a soft body never changes; read by parse.h from its plugin instance and the model's tree of bodies.

#ifndef MJFRAMES_PLUGIN_SOFT_MODEL_H_
#define MJFRAMES_PLUGIN_SOFT_MODEL_H_

#include <vector>

#include "elasticity.h"
#include "kinematics.h"
#include "patch.h"

namespace mjframes {

struct SoftModel {
  bool implicit = true;
  bool changes_inertia = true;  // explicit bodies with lumped masses leave MuJoCo's as it is
  double alpha = 0, beta = 0;   // Rayleigh damping [1/s], [s]
  Kinematics kinematics;        // before any step
  ElasticModel elastic;
  ContactModel contact;
  std::vector<double> mass;  // of each pair of points [kg]
  bool has_difference = false;
  std::vector<double> mass_difference;  // how much of it MuJoCo does not know of: consistent minus lumped mass [kg]
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SOFT_MODEL_H_
