// mjframes.soft: a soft body made of frames, inside mj_step.
//
// A control point is one MuJoCo body with three slide joints, nested along the elimination tree of the stiffness
// matrix, so that every coupled pair of points is an ancestor pair and all of K fits the sparsity of d->M. Each step
//
//   qfrc_passive += f_elastic − (h + β) K v − α M v
//   d->M         += (h² + h β) K + h α M,   then factored
//
// and MuJoCo's own solver finishes the linearly implicit Euler step (7) with contacts and all.
// Index letters: j, k control point; e region; s surface vertex. Everything is in the soft body's own axes [SI].

#ifndef MJFRAMES_PLUGIN_SOFT_H_
#define MJFRAMES_PLUGIN_SOFT_H_

#include <mujoco/mujoco.h>

#include <memory>
#include <vector>

#include "contact.h"
#include "corotational.h"
#include "deformed.h"
#include "distance.h"
#include "features.h"
#include "lattice.h"
#include "linear.h"
#include "patch_volume.h"

namespace mjframes {

inline constexpr char kPluginName[] = "mjframes.soft";

// A control point and where its degrees of freedom stand in MuJoCo's arrays. A fixed one has none: its body stands
// still in the soft body's axes, that is, in the body that the soft body was attached to.
struct ControlPoint {
  int body;        // MuJoCo body
  int parent;      // control point, −1 for roots and fixed points
  int depth;       // number of ancestor points, −1 for fixed points
  int pair;        // its pairs with the ancestors at depth 0, 1, … start here; the last is with itself
  int qpos;        // address of its three coordinates
  int dof;         // address of its three velocities
  int inertia[3];  // entry of d->M in row dof + r and the root point's first column
  double mass;     // [kg]
  Vec3 reference;  // qpos0 [m]
  Vec3 rest;       // x̄_j [m]

  bool moves() const { return depth >= 0; }
};

class SoftBody {
 public:
  // Validates instance `instance` of the model; on failure warns in one sentence and returns null.
  static std::unique_ptr<SoftBody> Create(const mjModel* m, int instance);

  // Adds this step's forces and effective inertia; the model's last soft body then writes all contact rows.
  void Compute(const mjModel* m, mjData* d);

  // Number of the patch of a geom, −1 if it has none.
  int FindPatch(int geom) const;
  double contact_radius() const { return contact_radius_; }
  const std::vector<Patch>& patches() const { return patches_; }
  const std::vector<PatchVolume>& volumes() const { return volumes_; }
  const Lattice& lattice() const { return lattice_; }
  const Hulls& hulls() const { return hulls_; }
  const std::vector<Features>& features() const { return features_; }
  const std::vector<ControlPoint>& points() const { return points_; }

 private:
  SoftBody() = default;

  void GatherState(const mjData* d);
  void AddElasticity();
  void AddDamping(double h);
  void StoreForce(mjData* d);
  void StoreInertia(double h, mjData* d);

  bool first_ = false, last_ = false;  // among the model's instances of this plugin
  double alpha_ = 0, beta_ = 0;        // Rayleigh damping [1/s], [s]
  double contact_radius_ = 0;          // [m]
  std::vector<ControlPoint> points_;
  std::vector<Region> regions_;
  std::vector<Patch> patches_;
  std::vector<PatchVolume> volumes_;  // by patch
  Lattice lattice_;
  Hulls hulls_;                     // of the scene's meshes
  std::vector<Features> features_;  // of the scene's geoms

  // of this step; one SoftBody belongs to one mjData
  std::vector<Vec3> x_, v_, force_;     // position, velocity, force of the control points
  std::vector<double> pair_stiffness_;  // K, 3×3 row-major block a pair (deeper, shallower)
  std::vector<double> pair_sum_;        // the effective inertia's addition, summed over subtrees
  std::unique_ptr<RegionScratch> scratch_;
  std::unique_ptr<ContactScratch> contact_scratch_;
};

// The soft body behind plugin instance `instance` of the model, or null if that is another plugin's.
SoftBody* GetSoftBody(const mjModel* m, const mjData* d, int instance);

void RegisterPlugin();

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SOFT_H_
