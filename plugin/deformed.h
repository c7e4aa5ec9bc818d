// The deformed volume under a patch: which material point is where, how deep, and which way is out (the paper, §5.4).
//
// x(ξ) = Σ_n c_n(ξ) x(n) is inverted by Newton's method. The depth of the material point in the rest shape leads to the
// surface point q above it; n = F⁻ᵀ ∇φ(q), normalised, and the distance of p is n · (p − x(q)).

#ifndef MJFRAMES_PLUGIN_DEFORMED_H_
#define MJFRAMES_PLUGIN_DEFORMED_H_

#include <algorithm>
#include <cstdint>
#include <vector>

#include "distance_field.h"
#include "linear.h"
#include "patch.h"

namespace mjframes {

// A node of the distance field where the control points are now.
struct DeformedNode {
  double x[4];  // deformed, where the total is at least kLeastInRows [m], and behind it
                // the total: weight of the rows in the node [-]

  // in_rows: whether rows have each control point, null where they have all. x: of the control points in the world, by
  // control point [m].
  static DeformedNode Create(const DistanceField& field, const uint8_t* in_rows, const Vec3* x, int number);
};

// Nodes as all control points move them, and those of which the rows of a patch leave something out as these do. Each
// is found when it is asked for and kept in a place that it shares with others.
class DeformedNodes {
 public:
  // places: how many, a power of two.
  explicit DeformedNodes(size_t places) : key_(places, -1), deformed_(places) {}

  // After the control points have moved.
  void Forget() { std::fill(key_.begin(), key_.end(), -1); }

  // in_rows: those of the patch, null for all control points.
  const DeformedNode& At(int node, const DistanceField& field, const uint8_t* in_rows, int patch, const Vec3* x) {
    const int64_t key = node + (in_rows ? (patch + 1) * static_cast<int64_t>(field.node.size()) : 0);
    const size_t place = static_cast<size_t>(key) & (key_.size() - 1);
    if (key_[place] != key) {
      key_[place] = key;
      deformed_[place] = DeformedNode::Create(field, in_rows, x, node);
    }
    return deformed_[place];
  }

 private:
  std::vector<int64_t> key_;            // which one is kept in a place, −1 for none
  std::vector<DeformedNode> deformed_;  // in these places
};

inline constexpr int kAllPatches = -1;

class DeformedPatch {
 public:
  // What is between eight nodes.
  struct Cube {
    int nodes[8] = {-1};
    Vec3 base;              // ξ of its first node
    bool deformed = false;  // whether these are known:
    double x[8][4];         // [m], with the nodes' totals behind
  };

  // What came of looking for a material point.
  enum class Search { kFound, kAbove, kOutside, kNowhere };

  // x: where the control points are in the world, by control point [m]; those that the patch's rows have. nodes: of
  // these. patch: kAllPatches for the whole body, as if rows had all of its control points.
  DeformedPatch(const ContactModel& contact, int patch, const Vec3* x, DeformedNodes* nodes);

  bool Near(const Vec3& xi, double error) const { return patch().volume.Near(field_, xi, error); }

  // The material point ξ that is at p in the world, from a guess; false if none was found. own: only under this patch,
  // and no farther than a cube outside.
  bool Find(const Vec3& p, bool own, Vec3* xi) const {
    Cube cube;
    Mat3 slope;
    return Find(p, own, mjMAXVAL, xi, &cube, &slope) == Search::kFound;
  }

  // The same; outside where that led out of the lattice, above where p is surely farther
  // than `height` outside of the surface, and ξ then a better guess. Leaves the cube around ξ and, if ξ had to move,
  // ∂ξ/∂x near there [cubes/m]. found_own: whether `own` would have found it; may be null.
  Search Find(const Vec3& p, bool own, double height, Vec3* xi, Cube* cube, Mat3* slope,
              bool* found_own = nullptr) const;

  // Signed distance [m] of p from the surface, negative inside, and the outward normal there. xi: a guess, becomes the
  // material point at p. False where p is too far outside or midway between two sides.
  bool Distance(const Vec3& p, Vec3* xi, double* distance, Vec3* normal) const {
    Cube cube;
    return Distance(p, &cube, xi, distance, normal, nullptr);
  }

  // The same; starts in a cube that it had last, and leaves one. own: whether p is under this patch; may be null.
  bool Distance(const Vec3& p, Cube* cube, Vec3* xi, double* distance, Vec3* normal, bool* own) const;

  // Where the surface nearest to material point ξ is, and its outward normal there; false midway between two sides.
  bool Surface(const Vec3& xi, Vec3* position, Vec3* normal) const {
    Cube cube;
    Vec3 at = xi;
    double doubt;
    return Surface(&at, &cube, position, normal, &doubt);
  }

  // The same; ξ becomes that surface point. Leaves the cube around it, and by how much the distance's gradient there is
  // longer or shorter than 1: next to edges and midway between two sides it is, and its direction is not to be trusted.
  bool Surface(Vec3* xi, Cube* cube, Vec3* position, Vec3* normal, double* doubt) const;

  // weight[j] += scale W_j(ξ) for all control points j.
  void AddWeights(const Vec3& xi, double scale, double* weight) const;

  // The material point ξ of vertex s of the patch.
  Vec3 VertexPoint(int s) const;

  // The normal of the patch's own side at its vertex s, F⁻ᵀ n̄; 0 where the volume there is turned inside out.
  Vec3 VertexNormal(int s) const;

  const ContactModel& contact() const { return contact_; }
  const Patch& patch() const { return contact_.patches[patch_]; }

 private:
  bool Owns(const int* nodes) const;
  // Makes it the cube around ξ, if it is another; false where there is none.
  bool Enter(const Vec3& xi, Cube* cube, Vec3* fraction) const;
  bool Deform(Cube* cube) const;

  const ContactModel& contact_;
  const Vec3* x_;
  DeformedNodes* nodes_;
  const DistanceField& field_;
  const uint8_t* in_rows_;  // null for the whole body
  int patch_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_DEFORMED_H_
