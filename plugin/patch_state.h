// What is known of a patch where its control points are now: its pose, its vertices, nodes of the lattice that were
// asked for, and where it touches other geoms.
//
// MuJoCo asks for contacts first, on several threads where it has a pool, and for their rows later. What was found is
// kept from one to the other, and vertices from one geom to the next. Nothing tells when mjData was changed in between,
// or copied; so whoever asks hands it in, and what was made of other positions is forgotten and made again.

#ifndef MJFRAMES_PLUGIN_PATCH_STATE_H_
#define MJFRAMES_PLUGIN_PATCH_STATE_H_

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <mutex>
#include <vector>

#include "deformed.h"
#include "linear.h"
#include "patch.h"
#include "touch.h"

namespace mjframes {

class Kinematics;

// It belongs to one mjData; whoever uses its states has locked their mutex.
class PatchState {
 public:
  // pairs: whether the scene has patches of other soft bodies.
  PatchState(const ContactModel& contact, const Kinematics& kinematics, int patch, bool pairs);

  // Forgets what is not so where the control points are in `d`.
  void Update(const mjData* d);

  // The volume below the patch there.
  DeformedPatch Deformed() { return {contact_, number_, x_.data(), &nodes_}; }

  // Empty where the soft body has no volume.
  const PatchPose& Pose();

  // World positions of the vertices by component: [c n + s] = Σ_j W_j(s) x_j
  const double* Vertices();

  // Around them.
  const AlignedBox& VertexBox() {
    Vertices();
    return box_;
  }

  // Keeps the touches with a geom for as long as neither moves, if there is room. other: the geom's patch, null where
  // it is rigid. share, xi: of the vertices; material points xi of the other patch.
  void Keep(const mjData* d, int geom, const PatchState* other, const Touch* touch, int count, const double* share,
            const Vec3* xi);

  // Returns how many are kept of the geom where it is now, and copies them; −1 where it is not known.
  int Recall(const mjData* d, int geom, const PatchState* other, Touch* touch, double* share, Vec3* xi) const;

  std::mutex mutex;

 private:
  struct Kept {
    int geom, count;
    uint64_t version;              // of the other patch, 0 for rigid geoms
    std::array<mjtNum, 12> place;  // of the geom
    std::array<Touch, kMaxTouches> touch;
    std::vector<double> share;
    std::vector<Vec3> xi;  // empty without other soft bodies
  };

  const ContactModel& contact_;
  const Kinematics& kinematics_;
  const Patch& patch_;
  const int number_;            // of the patch
  std::vector<int32_t> point_;  // those that the patch depends on
  std::vector<Vec3> x_;         // (k)
  Mat3 axes_;                   // of the soft body, in the world
  uint64_t version_ = 0;        // how often they have moved

  // of these positions
  bool posed_ = false, skinned_ = false;
  PatchPose pose_{{}, {}, {}, 0, 1};
  std::vector<double> vertices_;
  AlignedBox box_{};  // of these
  DeformedNodes nodes_;
  int kept_ = 0;  // so many of these
  std::vector<Kept> touches_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PATCH_STATE_H_
