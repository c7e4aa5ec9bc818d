// Where the contact vertices of a soft body are in other soft bodies.
//
// MuJoCo asks about each patch of one body with each of the other. A vertex is looked for once, in all of the other
// body, and what was found is kept while neither of the two moves. It depends on where they are, and on nothing else:
// not on who asked first, nor on what was found before.

#ifndef MJFRAMES_PLUGIN_MEETINGS_H_
#define MJFRAMES_PLUGIN_MEETINGS_H_

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "constants.h"
#include "deformed.h"
#include "linear.h"
#include "patch.h"
#include "patch_state.h"
#include "vertices.h"

namespace mjframes {

class Kinematics;

// A vertex that is in another soft body, or near it.
struct MetVertex {
  int vertex;       // of its patch
  int patch;        // of the other body, under which it is
  Vec3 xi;          // material point of the other body
  double distance;  // of the vertex's centre from its surface [m], negative inside
  Vec3 normal;      // out of the other body
};

// Of one soft body with a volume; belongs to one mjData. Whoever uses it has locked its mutex, and that of the body
// that it meets; the mutexes of patches' states come later.
class Meetings {
 public:
  // states: of its patches.
  Meetings(const ContactModel& contact, const Kinematics& kinematics,
           const std::vector<std::unique_ptr<PatchState>>& states);

  // Forgets what is not so where the control points are in `d`, and finds where the patches are.
  void Update(const mjModel* m, const mjData* d);

  // The vertices of a patch that are in the other body or no higher above its surface than `height` [m], and maybe
  // others, cluster by cluster; one that is midway between two patches may be there for each. After Update of both.
  struct Found {
    const MetVertex* first;
    int count;
  };
  Found Find(const mjData* d, int patch, Meetings* other, double height);

  // World positions of a patch's vertices, by component; after Update.
  const double* Vertices(int patch) const { return vertices_.data() + 3 * contact_.patches[patch].volume.first_vertex; }

  // The largest margin and gap of its geoms [m].
  double margin() const { return margin_; }

  std::mutex mutex;

 private:
  // Of a patch with one other body.
  struct Meeting {
    const Meetings* other = nullptr;
    uint64_t version = 0, other_version = 0;  // of the positions that it was found for
    double height = 0;
    int count = 0;
    std::vector<MetVertex> found;
  };

  void Search(const mjData* d, int patch, Meetings* other, double height, Meeting* out);
  // This body, with all of its control points.
  DeformedPatch Whole() { return {contact_, kAllPatches, x_.data(), &nodes_}; }
  Vec3 Guess(const Vec3& p, Mat3* slope, double* far);
  void Meet(const mjData* d, const Vec3& p, int vertex, const Vec3& xi, DeformedPatch::Cube* cube, int most,
            Meeting* out);
  void MeetPatch(const mjData* d, const Vec3& p, int vertex, int patch, const Vec3& guess, Meeting* out);

  const ContactModel& contact_;
  const Kinematics& kinematics_;
  const std::vector<std::unique_ptr<PatchState>>& states_;
  std::vector<std::array<int, 2>> runs_;  // of bodies that carry control points: the first, how many
  bool turns_ = false;                    // whether points are elsewhere than at their bodies' origins
  std::vector<mjtNum> placed_;            // where these bodies are
  std::vector<Vec3> x_;                   // of the control points (k)
  uint64_t version_ = 0;                  // how often they have moved

  // of these positions
  double margin_ = 0;
  std::vector<double> vertices_;  // patch after patch
  std::vector<AlignedBox> box_;   // around the vertices of each patch
  Boxes boxes_;                   // the same
  std::vector<PatchPose> pose_;   // of each patch
  AlignedBox around_{};           // around all vertices
  double cover_ = 0;              // no place of the surface is farther from the nearest vertex [m]
  DeformedNodes nodes_;

  std::vector<std::array<Meeting, kKeptMeetings>> kept_;  // by patch
  std::vector<int> next_;                                 // of a patch's meetings, that is given up for another
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_MEETINGS_H_
