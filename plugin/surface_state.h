// What is known of a soft body's surface where its control points are now: the patches' poses and vertices, nodes of
// the lattice that were asked for, and where patches touch other geoms.
//
// MuJoCo asks for contacts first, on several threads where it has a pool, and for their rows later. What was found is
// kept from one to the other. Nothing tells when mjData was changed in between, or copied; so whoever asks hands it in,
// and what was made of other positions is forgotten and made again. One thread at a time has a soft body.

#ifndef MJFRAMES_PLUGIN_SURFACE_STATE_H_
#define MJFRAMES_PLUGIN_SURFACE_STATE_H_

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

// Where a geom is.
using GeomPlace = std::array<mjtNum, 12>;
GeomPlace PlaceOf(const mjData* d, int geom);

// It belongs to one mjData; whoever uses it has locked its mutex.
class SurfaceState {
 public:
  // pairs: whether the scene has patches of other soft bodies. wide: whether it has those or flexes, which meet many
  // nodes.
  SurfaceState(const ContactModel& contact, const Kinematics& kinematics, bool pairs, bool wide);

  // Forgets what is not so where the control points are in `d`.
  void Update(const mjData* d);

  // How often they have moved.
  uint64_t version() const { return version_; }

  // The volume below a patch there, or of the whole body (kAllPatches).
  DeformedPatch Deformed(int patch) { return {contact_, patch, x_.data(), &nodes_}; }

  // Empty where the soft body has no volume.
  const PatchPose& Pose(int patch);

  // World positions of a patch's vertices by component: [c n + s] = Σ_j W_j(s) x_j
  const double* Vertices(int patch);

  // Around them.
  const AlignedBox& VertexBox(int patch) {
    if (!patches_[patch].skinned) Vertices(patch);
    return patches_[patch].box;
  }

  // What the patch's field is at a place in the world, once that was found (patch_field.h).
  struct FieldPoint {
    uint64_t version = 0;  // of these positions
    int patch = -1;
    bool found = false;
    Vec3 place{};
    double distance = 0;
    Vec3 normal{};
  };

  // Where that of the place is kept, among others that are given up for it; not found if it was not asked for lately.
  FieldPoint* Asked(int patch, const Vec3& place);

  // The cube that a patch's field was last asked for.
  DeformedPatch::Cube* FieldCube(int patch) { return &patches_[patch].cube; }

  // Keeps the touches of a patch with a geom for as long as neither moves, if there is room. other: whose patch the
  // geom is, null where it is rigid. share, xi: of the vertices; material points xi of the other patch.
  void Keep(const mjData* d, int patch, int geom, const SurfaceState* other, const Touch* touch, int count,
            const double* share, const Vec3* xi);

  // Returns how many are kept of the geom where it is now, and copies them; −1 where it is not known.
  int Recall(const mjData* d, int patch, int geom, const SurfaceState* other, Touch* touch, double* share,
             Vec3* xi) const;

  std::mutex mutex;

 private:
  struct Kept {
    int geom, count;
    uint64_t version;  // of the other body, 0 for rigid geoms
    GeomPlace place;
    std::array<Touch, kMaxTouches> touch;
    std::vector<double> share;
    std::vector<Vec3> xi;  // empty without other soft bodies
  };

  struct OfPatch {
    size_t first = 0;  // of its numbers in vertices_
    bool posed = false, skinned = false;
    PatchPose pose{{}, {}, {}, 0, 1};
    AlignedBox box{};  // around its vertices
    DeformedPatch::Cube cube;
    int kept = 0;  // so many of these
    std::vector<Kept> touches;
  };

  // Whether control points are elsewhere in `d` than they were when this was updated.
  bool Moved(const mjData* d) const;

  const ContactModel& contact_;
  const Kinematics& kinematics_;
  // Of bodies that move and carry control points: the first, how many, and whether any is elsewhere than at its body's
  // origin.
  struct Run {
    int first, count;
    bool turns;
  };

  std::vector<Run> runs_;
  bool offsets_ = false;        // whether vertices move with the soft body's axes, too
  std::vector<mjtNum> placed_;  // where these bodies are
  std::vector<Vec3> x_;         // of the control points (k)
  Mat3 axes_{};                 // of the soft body, in the world
  uint64_t version_ = 0;

  // of these positions
  std::vector<OfPatch> patches_;
  std::vector<double> vertices_;  // patch after patch
  DeformedNodes nodes_;
  std::vector<FieldPoint> asked_;  // a power of two
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SURFACE_STATE_H_
