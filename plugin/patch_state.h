// What is known of a patch where its control points are now: its pose, its vertices, and where it touches rigid geoms.
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

#include "linear.h"
#include "patch.h"
#include "touch.h"

namespace mjframes {

class Kinematics;

// It belongs to one mjData; whoever uses its states has locked their mutex.
class PatchState {
 public:
  PatchState(const ContactModel& contact, const Kinematics& kinematics, int patch);

  // Forgets what is not so where the control points are in `d`.
  void Update(const mjData* d);

  // Where they are, by control point [m]; only those that the patch depends on.
  const Vec3* positions() const { return x_.data(); }

  // Empty where the soft body has no volume.
  const PatchPose& Pose();

  // World positions of the vertices by component: [c n + s] = Σ_j W_j(s) x_j
  const double* Vertices();

  // Around them.
  const AlignedBox& VertexBox() {
    Vertices();
    return box_;
  }

  // Keeps the touches with a rigid geom for as long as neither moves, if there is room. share: of the vertices.
  void Keep(const mjData* d, int geom, const Touch* touch, int count, const double* share);

  // Returns how many are kept of the geom where it is now, and copies them.
  int Recall(const mjData* d, int geom, Touch* touch, double* share) const;

  std::mutex mutex;

 private:
  struct Kept {
    int geom, count;
    std::array<mjtNum, 12> place;  // of the geom
    std::array<Touch, kMaxTouches> touch;
    std::vector<double> share;
  };

  const ContactModel& contact_;
  const Kinematics& kinematics_;
  const Patch& patch_;
  std::vector<int32_t> point_;  // those that the patch depends on
  std::vector<Vec3> x_;         // (k)
  Mat3 axes_;                   // of the soft body, in the world

  // of these positions
  bool posed_ = false, skinned_ = false;
  PatchPose pose_{{}, {}, {}, 0, 1};
  std::vector<double> vertices_;
  AlignedBox box_{};  // of these
  int kept_ = 0;      // so many of these
  std::array<Kept, 4> touches_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PATCH_STATE_H_
