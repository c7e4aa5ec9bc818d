// The deformed volume under a patch: which material point is where, how deep, and which way is out (the paper, §5.4).
//
// x(ξ) = Σ_n c_n(ξ) x(n) is inverted by Newton's method. The depth of the material point in the rest shape leads to the
// surface point q above it; n = F⁻ᵀ ∇φ(q), normalised, and the distance of p is n · (p − x(q)).

#ifndef MJFRAMES_PLUGIN_DEFORMED_H_
#define MJFRAMES_PLUGIN_DEFORMED_H_

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <vector>

#include "lattice.h"
#include "linear.h"

namespace mjframes {

class SoftBody;
struct Patch;

// What a patch answers for: the material below it, and those control points whose weights its contact rows can hold,
// on the path from the root to its geom's body or fixed. Other weights are left out and the rest scaled to sum 1.
struct PatchVolume {
  static PatchVolume Create(const SoftBody& body, int patch);

  std::vector<uint8_t> holds;  // whether rows hold the control point              (k)
  int first_vertex;            // of the patch in Lattice::vertex
  double depth;                // the largest below the surface [m]
  // A sphere around all of it: centre Σ mean_j x_j, radius Σ spread_j |x_j − centre|.
  std::vector<int32_t> point;        //                                            (p)
  std::vector<double> mean, spread;  //                                            (p)
};

struct Sphere {
  Vec3 centre;
  double radius;
};

class DeformedPatch {
 public:
  DeformedPatch(const SoftBody& body, int patch, const mjData* d);

  // A sphere that holds the patch's vertices and the material below them.
  Sphere Bounds() const;

  // The material point ξ that is at p in the world, from a guess; false if none was found.
  bool Find(const Vec3& p, Vec3* xi) const;

  // Signed distance [m] of p from the surface, negative inside, and the outward normal there. xi: a guess, becomes the
  // material point at p. False where p is too far outside, or under another patch.
  bool Distance(const Vec3& p, Vec3* xi, double* distance, Vec3* normal) const;

  // Where the surface nearest to material point ξ is, and its outward normal there; false midway between two sides and,
  // if only this patch's own surface counts, under another patch.
  bool Surface(const Vec3& xi, bool own, Vec3* position, Vec3* normal) const;

  // weight[j] += scale W_j(ξ) for all control points j.
  void AddWeights(const Vec3& xi, double scale, double* weight) const;

  // The material point ξ of vertex s of the patch.
  Vec3 VertexPoint(int s) const;

  double depth() const { return volume_.depth; }
  const SoftBody& body() const { return body_; }
  const Patch& patch() const;

 private:
  struct Cell {
    int nodes[8];
    Vec3 x[8];  // deformed [m]
  };

  bool Deform(const int* nodes, Cell* cell) const;

  const SoftBody& body_;
  const mjData* data_;
  const Lattice& lattice_;
  const PatchVolume& volume_;
  int patch_;
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_DEFORMED_H_
