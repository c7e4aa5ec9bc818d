// Where the contact vertices of a soft body are in other soft bodies, and the features of rigid geoms in it.
//
// MuJoCo asks about each patch with each geom. A point is looked for once, in all of a body, and what was found is kept
// while neither of the two moves. It depends on where they are, and on nothing else: not on who asked first, nor on
// what was found before.

#ifndef MJFRAMES_PLUGIN_MEETINGS_H_
#define MJFRAMES_PLUGIN_MEETINGS_H_

#include <mujoco/mujoco.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "constants.h"
#include "deformed.h"
#include "geom_features.h"
#include "linear.h"
#include "patch.h"
#include "surface_state.h"
#include "vertices.h"

namespace mjframes {

// A point that is in a soft body, or near it.
struct MetPoint {
  int number;       // of the vertex of its patch, or of the feature of its geom
  int cluster;      // of the feature
  int patch;        // of the body, under which it is
  Vec3 place, xi;   // in the world, and the material point there
  double distance;  // of its centre from the surface [m], negative inside
  Vec3 normal;      // out of the body
};

// What a point bounds: a rigid geom for a feature, another soft body for a vertex.
struct Inside {
  Vec3 facing;   // away from the geom's middle, or which way the vertex's own surface faces; 0 if nobody knows
  Vec3 inwards;  // the way to that middle, or a short one into the other body, in the lattice of the one it met [cubes]
  bool is_geom;
  bool is_above;  // far above the surface: distance and normal of the point are known
};

// In the order of their clusters. A point that is midway between two patches may be there for each.
struct MetPoints {
  const MetPoint* first;
  int count;
};

// Of one soft body with a volume; belongs to one mjData. Whoever uses it has locked the mutex of its surface's state,
// and updated that, and the same of another body that is named.
class Meetings {
 public:
  // pairs: whether the scene has patches of other soft bodies.
  // rigid: how many other geoms it has.
  Meetings(const ContactModel& contact, const CollisionMeshes& meshes, bool pairs, size_t rigid, SurfaceState* state);

  // The body at a glance: around all vertices; no place of the surface is farther from the nearest of them than `cover`
  // [m]; and the largest margin and gap of its geoms when it moved last [m].
  struct Extent {
    AlignedBox box;
    double cover, margin;

    // Whether no vertex of either body is in the other or no higher above its surface than `height` [m].
    bool Apart(const Extent& other, double height) const {
      return box.Apart(other.box, std::max(cover, other.cover) + height);
    }
  };
  const Extent& Measured(const mjModel* m) {
    if (measured_ != state_->version()) Measure(m);
    return extent_;
  }

  // The vertices of a patch that are in the other body or no higher above its surface than `height` [m], and maybe
  // others. Both bodies were measured.
  MetPoints FindVertices(int patch, Meetings* other, double height);

  // The features of a rigid geom that are in this body or no higher above its surface, and no farther from its patches
  // than `room` [m], and maybe others.
  MetPoints FindFeatures(const mjModel* m, const mjData* d, int geom, double room, double height);

 private:
  // Of a patch with one other body.
  struct Meeting {
    const Meetings* other = nullptr;
    uint64_t version = 0, other_version = 0;  // of the positions that it was found for
    double height = 0;
    int count = 0;
    std::vector<MetPoint> found;
  };

  // Of a rigid geom.
  struct FeatureMeeting {
    int geom, type, data;  // as it is now
    GeomPlace place;
    Vec3 size;
    double room, height;
    int begin, count;  // in met_
  };

  // Where the last point was found tells where the next one is, about; so far around `start` is nothing [m].
  struct Trail {
    bool known = false;
    Vec3 xi{}, last{}, start{};
    Mat3 slope{};
    double apart = 0;
  };

  // Of a point: a patch of a soft body, or a rigid geom with its middle and the radius of the balls of its features.
  struct Owner {
    const Meetings* body;
    int patch;
    Vec3 middle;
    double ball;
  };

  // What was found, and how much fits in.
  struct Sink {
    MetPoint* out;
    int count, most;
  };

  void Measure(const mjModel* m);  // where the vertices of all patches are
  void Search(int patch, Meetings* other, double height, Meeting* out);
  void SearchFeatures(const mjModel* m, const Features& features, const mjData* d, int geom, double room, double height,
                      Sink* sink);
  void Seek(const MetPoint& sought, double height, const Owner& owner, Trail* trail, Sink* sink);
  bool SeekBelow(const MetPoint& ball, const Vec3& vertex, const Mat3& slope, Sink* sink);
  static Inside InsideOf(const Owner& owner, const MetPoint& point, const Mat3& slope);
  Vec3 Guess(const Vec3& p, Mat3* slope, Vec3* vertex, double* far);
  void Meet(const MetPoint& found, const Inside& inside, DeformedPatch::Cube* cube, Sink* sink);

  const ContactModel& contact_;
  const CollisionMeshes& meshes_;
  SurfaceState* state_;

  // of these positions, each found for a version of its own
  uint64_t measured_ = 0, posed_ = 0;
  Boxes vertex_boxes_;    // of the patches
  Boxes material_boxes_;  // and what is below them
  Extent extent_{};

  std::vector<std::array<Meeting, kKeptMeetings>> kept_;  // by patch; empty without other soft bodies
  std::vector<int> next_;                                 // of a patch's meetings, that is given up for another

  uint64_t features_version_ = 0;  // for which features were found
  std::vector<FeatureMeeting> features_;
  std::vector<MetPoint> met_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_MEETINGS_H_
