// The deformed volume under a patch: which material point is where, how deep, and which way is out (the paper, §5.4).
//
// x(ξ) = Σ_n c_n(ξ) x(n) is inverted by Newton's method. The depth of the material point in the rest shape leads to the
// surface point q above it; n = F⁻ᵀ ∇φ(q), normalised, and the distance of p is n · (p − x(q)).

#ifndef MJFRAMES_PLUGIN_DEFORMED_H_
#define MJFRAMES_PLUGIN_DEFORMED_H_

#include <cstdint>
#include <vector>

#include "distance_field.h"
#include "linear.h"
#include "patch.h"

namespace mjframes {

// Nodes of the distance field where a patch's control points are now. Each is found when it is asked for and kept in a
// place that it shares with others.
class DeformedNodes {
 public:
  struct Node {
    Vec3 x;             // deformed, where the total is at least kLeastInRows [m]
    double total;       // weight of the patch's rows in the node [-]
    int32_t node = -1;  // which
    uint32_t version;   // of the control points that it was found for
  };

  // places: how many; not asked for any node where there are none.
  explicit DeformedNodes(size_t places) : nodes_(places) {}

  // After the control points have moved.
  void Forget();

  // x: of the control points in the world, by control point [m].
  const Node& At(int node, const DistanceField& field, const PatchVolume& volume, const Vec3* x) {
    Node& kept = nodes_[static_cast<size_t>(node) % nodes_.size()];
    if (kept.node != node || kept.version != version_) kept = Deform(field, volume, x, node);
    return kept;
  }

 private:
  Node Deform(const DistanceField& field, const PatchVolume& volume, const Vec3* x, int node) const;

  std::vector<Node> nodes_;
  uint32_t version_ = 0;
};

class DeformedPatch {
 public:
  // x: where the control points are in the world, by control point [m]; those that the patch's rows have. nodes: of
  // these.
  DeformedPatch(const ContactModel& contact, int patch, const Vec3* x, DeformedNodes* nodes);

  bool Near(const Vec3& xi, double error) const { return volume_.Near(field_, xi, error); }

  // The material point ξ that is at p in the world, from a guess; false if none was found. own: only under this patch,
  // and no farther than a cube outside.
  bool Find(const Vec3& p, bool own, Vec3* xi) const {
    Cube cube;
    return Find(p, own, xi, &cube);
  }

  // Signed distance [m] of p from the surface, negative inside, and the outward normal there. xi: a guess, becomes the
  // material point at p. False where p is too far outside, midway between two sides or, if `own`, under another patch.
  bool Distance(const Vec3& p, bool own, Vec3* xi, double* distance, Vec3* normal) const;

  // Where the surface nearest to material point ξ is, and its outward normal there; false midway between two sides.
  bool Surface(const Vec3& xi, Vec3* position, Vec3* normal) const {
    Cube cube;
    return Surface(xi, &cube, position, normal);
  }

  // weight[j] += scale W_j(ξ) for all control points j.
  void AddWeights(const Vec3& xi, double scale, double* weight) const;

  // The material point ξ of vertex s of the patch.
  Vec3 VertexPoint(int s) const;

  const ContactModel& contact() const { return contact_; }
  const Patch& patch() const { return contact_.patches[patch_]; }

 private:
  struct Cube {
    int nodes[8] = {-1};
    Vec3 x[8];  // deformed [m]
  };

  bool Find(const Vec3& p, bool own, Vec3* xi, Cube* cube) const;
  bool Surface(const Vec3& xi, Cube* cube, Vec3* position, Vec3* normal) const;

  bool Owns(const int* nodes) const;
  bool Nearest(const int* nodes, const Vec3& fraction) const;
  bool Deform(const int* nodes, Cube* cube) const;  // if it is another than before

  const ContactModel& contact_;
  const Vec3* x_;
  DeformedNodes* nodes_;
  const DistanceField& field_;
  const PatchVolume& volume_;
  int patch_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_DEFORMED_H_
