// mjframes.tendon: a volume or a length in the material as the length of a MuJoCo tendon, with its Jacobian.
//
//   V = s Σ_abc p_a · (p_b × p_c) / 6 + (1 − s) V̄     a closed surface of triangles: of a chamber [m³]
//   L = Σ_k s_k |p_k+1 − p_k|              a path through material points and sites, s = 1: of a fibre [m];
//                                          or pairs of points: of a muscle [m³] (muscles.py)
//   … + Σ_ij c_ij (|x_i − x_j| − |x̄_i − x̄_j|)     so that at rest it pulls as finite elements say (tendon_slopes.py);
//                                          of a chamber it grows with a like sum of b_ij (chamber_growth.py)
//
// Points are p = Σ_j W_j x_j. With G_j = ∂/∂x_j the Jacobian is Jᵀ G: forces G at the
// control points, summed over the tree to wrenches and taken along MuJoCo's `cdof`. A force on V is so a pressure [Pa],
// on L a tension [N]; the tendon is MuJoCo's own, with all that acts on tendons.
//
// MuJoCo finds lengths of tendons in mj_tendon, and next calls plugins where geoms collide: before constraints,
// transmissions, springs and sensors look at tendons. Each instance has a geom of its own that always collides with
// another at the same place (contact.cc); the tendon that MuJoCo sees before is a placeholder with the columns of the
// Jacobian. An instance has the name of its tendon. Index letters: j control point; n point; a, b, c corner of a
// triangle; k stop of a path.

#ifndef MJFRAMES_PLUGIN_TENDON_H_
#define MJFRAMES_PLUGIN_TENDON_H_

#include <mujoco/mujoco.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "attributes.h"
#include "linear.h"
#include "moved_points.h"

namespace mjframes {

inline constexpr char kTendonName[] = "mjframes.tendon";

// What never changes of one, shared by the mjDatas of a model.
struct TendonModel {
  // Reads that of an instance; rest: of the soft body's control points. What is wrong is told to `reader`.
  static std::unique_ptr<const TendonModel> Read(const std::vector<Vec3>& rest, Reader* reader);

  PointWeights points;
  std::vector<int32_t> triangle;  // of a chamber: three points each, counter-clockwise seen from outside the chamber
  double scale = 1, rest_volume = 0;  // s and V̄ [m³] of a chamber
  struct Pair {
    int32_t i, j;   // places in points.point
    double slope;   // c [of the tendon's unit by m]
    double growth;  // b [1/m]
    double rest;    // distance at rest [m]
  };
  std::vector<Pair> pairs;
  bool grows = false;         // whether there are b
  std::vector<int32_t> stop;  // of a fibre: points, −1 for the next of the tendon's sites
  std::vector<double> share;  // s_k of a muscle; none where all are 1
};

class Tendon {
 public:
  // Validates instance `instance` of the model; on failure warns in one sentence and returns null.
  static std::unique_ptr<Tendon> Create(const mjModel* m, int instance);

  // Writes the tendon's length and Jacobian, and where it is drawn. Several tendons may be measured at the same time.
  void Measure(const mjModel* m, mjData* d);

  bool has_gas() const { return rest_volume_ > 0; }
  int soft() const { return soft_; }  // the soft body's plugin instance

  // With gas sealed in, p Vᵞ constant and k = −dp/dV: qfrc_passive += (p − ambient − h k dV/dt) ∂V/∂q, the last of
  // these where the step is implicit in it.
  void AddGas(const mjModel* m, mjData* d) const;

  // And d->M += h² k ∂V/∂q ∂V/∂qᵀ, as far as it has room. It has none for two branches of the tree: with J_l, the part
  // of ∂V/∂q on path l of L from the root to a leaf, and what paths share in equal parts, L Σ_l J_l J_lᵀ is no less. It
  // has inertia against turns of all, though: a body that is free and has branches has gas that is explicit.
  void AddGasInertia(const mjModel* m, mjData* d) const;

  // Warns, once, of flags that keep it from being measured.
  void CheckFlags(const mjModel* m);

 private:
  // A body whose joints the tendon pulls, the closest one at or above what it passes.
  struct Link {
    int body;
    int parent;  // link, −1 for none
  };

  struct Wrench {
    Vec3 torque;  // about the centre of mass of the link's tree [N m]
    Vec3 force;   // [N]
  };

  struct Stop {
    int point;  // of the material, −1 for a site
    int site;
    int link;  // of the site's body
  };

  Tendon(int tendon, int soft, std::shared_ptr<const TendonModel> model);

  bool FindStops(const mjModel* m);
  void ReadGas(const std::vector<Vec3>& rest, Reader* reader);
  double AddPairs(double length, Vec3* torque);
  bool FindLinks(const mjModel* m, Reader* soft);
  int LinkOf(const mjModel* m, int body) const;
  void CountPaths(const mjModel* m);
  bool IsImplicit(const mjData* d) const;
  double Pressure(const mjData* d, double* k) const;

  // Of the points where they are: the value; its gradient goes to the points, and to the links of sites.
  double Evaluate(const mjModel* m, const mjData* d, const Vec3& origin);
  double Volume();
  double Length(const mjModel* m, const mjData* d, const Vec3& origin);
  Vec3 Place(const mjData* d, const Vec3& origin, const Stop& stop) const;
  void AddForce(const mjModel* m, const mjData* d, int link, const Vec3& position, const Vec3& force);
  void Draw(const mjModel* m, mjData* d, const Vec3& origin) const;

  int tendon_;
  int soft_;         // the soft body's plugin instance
  int holder_ = -1;  // link of the body whose axes are the soft body's
  bool told_ = false;
  std::shared_ptr<const TendonModel> model_;
  MovedPoints points_;
  std::vector<Stop> stops_;       // of a fibre
  std::vector<Link> links_;       // ancestors first
  std::vector<int> point_link_;   // of each control point that moves some of it
  std::vector<int> column_link_;  // of each column of the Jacobian, −1 where it is zero
  std::vector<int> paths_;        // of each column: how many paths from the root to a leaf pass its degree of freedom
  int all_paths_ = 0;
  double gas_ = 0, ambient_ = 0, exponent_ = 1, rest_volume_ = 0;  // p₀, of the surroundings [Pa]; γ; V₀ [m³]

  std::vector<Vec3> x_, force_;          // of these control points, from the first on, and G
  std::vector<Vec3> growth_;             // ∂B/∂x of them; none without b
  std::vector<Wrench> wrench_;           // of the links
  std::vector<double> corner_, normal_;  // of a chamber's points, four numbers each
};

// Whether plugin instance `instance` of the model is a tendon's.
bool IsTendon(const mjModel* m, int instance);

// That of a plugin instance, null for those of other plugins.
Tendon* GetTendon(const mjData* d, int instance);

// The tendon that a geom keeps measured, null for other geoms.
Tendon* TendonOf(const mjModel* m, const mjData* d, int geom);

// How many of the model's tendons MuJoCo measures itself.
int CountOwnTendons(const mjModel* m);

void RegisterTendon();

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_TENDON_H_
