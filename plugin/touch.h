// Where a patch touches another geom.
//
// Four kinds of points touch: the contact vertices of a patch a rigid geom, those of two patches of different soft
// bodies the other's deformed volume, sharp features of a rigid geom (geom_features.h) the deformed volume
// (deformed.h), and a round geom the place of the surface that is deepest in it (round_touch.h). What touches within
// one cluster and is nearly as deep as its deepest point shares one contact.
//
// A row acts on a deformed volume through the weights of the material point that is at the contact, so that both sides
// feel the same force at the same place and neither momentum nor angular momentum is made.

#ifndef MJFRAMES_PLUGIN_TOUCH_H_
#define MJFRAMES_PLUGIN_TOUCH_H_

#include <mujoco/mujoco.h>

#include <cstdint>

#include "dents.h"
#include "geom_features.h"
#include "linear.h"
#include "patch.h"

namespace mjframes {

class SoftBody;

// A patch and the soft body it belongs to; body is null for other geoms.
struct SoftSide {
  const SoftBody* body = nullptr;
  int patch = -1;  // number among the body's patches
};

struct Touch {
  double distance;     // [m], negative inside
  Vec3 position;       // half way between the surfaces [m]
  Vec3 normal;         // from the first geom to the second
  int16_t side;        // of the vertices that touch, or −1 where features, round geoms or round sides do
  int16_t begin, end;  // those vertices
  float lies;          // whether it lies flat on the other: 1 if most of a flat cluster touches, else 0
  float variance;      // of what touches around the position, along one direction of the surface [m²]
  Vec3 xi;             // material point near the feature
  // These are kept with each geom, so they are short.
  float moved[3] = {};   // from the centre of the pressure to a corner [m]
  float axis[3] = {};    // of a round side: along one of its principal directions
  float radius[2] = {};  // along that and across; 0 where it is even, and of what is no round side [m]

  Vec3 Centre() const { return position - Vec3{moved[0], moved[1], moved[2]}; }
};

inline constexpr int kMaxTouches =
    kMaxClusters + (kMaxFeatureClusters > kMaxClusters ? kMaxFeatureClusters : kMaxClusters);

// Of one pair of geoms, by side.
struct TouchScratch {
  double share[2][kMaxPatchVertices];  // of each vertex in its cluster's contact
  Vec3 xi[2][kMaxPatchVertices];       // material points of the other side where the vertices are
};

// Where the two geoms touch, or would: in a fixed order, none farther than `margin`. Nothing if the two sides are the
// same soft body. Patches keep their touches.
int FindTouches(const mjModel* m, const mjData* d, const int geom[2], const SoftSide side[2], double margin,
                TouchScratch* scratch, Touch* out);

// What FindTouches found last, if nothing has moved since; else 0.
int RecallTouches(const mjData* d, const int geom[2], const SoftSide side[2], TouchScratch* scratch, Touch* out);

// weight[j] += weight of control point j of the soft body on side s in the velocity of the touching point. The touch
// was found or recalled last, with this scratch.
void AddTouchWeights(const SoftSide side[2], const Touch& touch, const TouchScratch& scratch, int s, double* weight);

// The dents that the touch makes. It was found or recalled last.
ContactDents TouchDents(const SoftSide side[2], const Touch& touch);

// weight[j] += weight of control point j in the velocity of what is at a place, or nearest to it.
void AddPlaceWeights(const SoftSide& side, const mjData* d, const Vec3& place, double* weight);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_TOUCH_H_
