// The signed distance field of a soft body's rest shape, and its control weights, at the nodes of a coarse lattice.
//
// A material point is written in the lattice's coordinates ξ [cubes], a cube being what is between eight nodes; there
// everything is trilinear.

#ifndef MJFRAMES_PLUGIN_DISTANCE_FIELD_H_
#define MJFRAMES_PLUGIN_DISTANCE_FIELD_H_

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "linear.h"

namespace mjframes {

// What of a node a control point moves.
struct NodeWeight {
  int16_t units;   // of its weight
  uint16_t point;  // which
};

struct DistanceField {
  double spacing = 0;              // of the nodes [m]
  std::vector<double> axes;        // its directions in the soft body's axes, columns   (3 × 3)
  std::vector<double> origin;      // of node 0 at rest [m]                        (3)
  std::vector<int32_t> shape;      // nodes along each axis                        (3)
  std::vector<int32_t> node;       // those kept, by their place in the lattice   (n, ascending)
  std::vector<double> distance;    // φ, negative inside [m]                       (n)
  std::vector<int32_t> patch;      // whose contact vertices are nearest           (n)
  std::vector<int32_t> count;      // control points that move each node           (n)
  std::vector<int32_t> units;      // that a weight of 1 has there                 (n)
  std::vector<NodeWeight> weight;  // W_j(n) in units                            (Σ count)
  std::vector<double> vertex;      // ξ of the contact vertices, patch after patch (3 × vertices)
  std::vector<int32_t> normal;     // of the surface there, outward, of any length (3 × vertices)

  // Derived.
  std::vector<int32_t> place;  // from the whole lattice to the nodes kept, −1 where there is none
  std::vector<int32_t> start;  // first entry of each node, and the end          (n + 1)

  // Checks the arrays against each other and against the numbers of patches and contact vertices, and derives the rest.
  // On failure returns what is wrong.
  std::string Finish(int patches, int vertices);

  // ξ of a place at rest [m].
  Vec3 Coordinates(const Vec3& p) const;

  // The surface's normal at a contact vertex, of any length.
  Vec3 Normal(int of) const {
    const int32_t* n = normal.data() + 3 * of;
    return {static_cast<double>(n[0]), static_cast<double>(n[1]), static_cast<double>(n[2])};
  }

  // Of the body, about [m³].
  double Volume() const;

  // Where a node is at rest [m].
  Vec3 Place(int node) const;

  // The eight nodes around ξ, x fastest, and where ξ is among them; false where one is missing.
  bool CubeAt(const Vec3& xi, int* nodes, Vec3* fraction) const;

  // Whether the nearest of a cube's nodes is under the patch; of several that are as near, any.
  bool IsNearest(const int* nodes, const Vec3& fraction, int patch) const;

  // The nodes, ascending, of the cubes that reach inside and of which one is under the patch.
  std::vector<int> NodesBelow(int patch) const;

  // φ [m], and ∂φ/∂ξ.
  double Distance(const int* nodes, const Vec3& fraction) const;
  double Distance(const int* nodes, const Vec3& fraction, Vec3* gradient) const;
};

// Weights of a cube's eight nodes in a point within it.
std::array<double, 8> TrilinearWeights(const Vec3& fraction);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_DISTANCE_FIELD_H_
