// Where the control points are, and how MuJoCo's degrees of freedom move them (J in x_j' = J_j qvel).
//
// A control point is a point fixed on a body: on one of its own with three slide joints, on the body of a rigid frame,
// on a link of a robot, on the world. A mover is a body with joints that moves some of the points and not all: what
// moves all of them strains nothing. With the twist S_a of degree of freedom a and X_j = [I, −[x_j]×]
//
//   v_j = X_j Σ_a S_a qvel_a        over the movers at and above j
//   Jᵀf at a = S_aᵀ Σ_j X_jᵀ f_j     over the points at and below a's mover
//   JᵀKJ at (a, b) = S_aᵀ (Σ_jk X_jᵀ K_jk X_k) S_b
//
// summed over subtrees from the leaves up. Forces on a mover that turns have a stiffness of their own, K_n
// (inertia.cc), on its rotation. Where all movers are slides along the axes, twists are translations, X = I and the
// blocks 3 × 3; else they are 6 × 6. Everything is in the soft body's own axes, those of the body that its outermost
// movers hang on, seen from there [SI]. Index letters: j, k control point; n mover; a, b degree of freedom.

#ifndef MJFRAMES_PLUGIN_KINEMATICS_H_
#define MJFRAMES_PLUGIN_KINEMATICS_H_

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cstdint>
#include <vector>

#include "attributes.h"
#include "constants.h"
#include "linear.h"

namespace mjframes {

struct ControlPoint {
  int body;        // MuJoCo body that it is fixed on
  int mover;       // the closest mover at or above that body, −1 for none
  int branch;      // points of different branches are coupled by their forces only (see PointPair)
  bool still;      // whether it never moves in the soft body's axes
  bool offset;     // whether it is elsewhere than at the body's origin
  Vec3 local;      // in the body's axes [m]
  Vec3 rest;       // x̄_j [m]
  double mass;     // as built [kg]
  double carried;  // of all points on that body, as built [kg]
};

struct Mover {
  int body;    // MuJoCo body
  int parent;  // mover, −1 for none
  int depth;   // number of movers above
  int dof;     // its degrees of freedom start here …
  int dofs;    // … and are so many
  int twist;   // their twists start here
  int pair;    // its pairs with the movers at depth 0, 1, … start here; the last is with itself
  int entry;   // the addresses in d->M of its rows start here: dof by dof, column by column
  bool arms;   // whether some of its own points are elsewhere than at its body's origin
};

// Two coupled control points, or one with itself.
struct PointPair {
  int j, k;
  int sum;    // mover pair that its stiffness goes to, −1 where d->M has no room for it or neither moves
  bool flip;  // whether k is the deeper of the two
};

// What a contact's point is made of at and below a mover: Σ ω_j and Σ ω_j x_j.
struct Moments {
  double weight;
  Vec3 moment;
};

inline Moments operator+(const Moments& a, const Moments& b) { return {a.weight + b.weight, a.moment + b.moment}; }

class Kinematics {
 public:
  // Finds the instance's points among the bodies. What is wrong is told to `reader`.
  void Create(const mjModel* m, int instance, Reader* reader);

  // The pair of points j and k, a new one if need be. False where the two are on one branch but not on one path.
  bool Couple(int j, int k, int* pair);

  // After all couplings: memory, and the places of the movers in d->M. What is wrong is told to `reader`.
  void Finish(const mjModel* m, Reader* reader);

  // Whether points are on kinematic trees or mocap bodies that move without waking the soft body's own tree, of which
  // some may fall asleep.
  bool MissesWaking(const mjModel* m) const;

  // Whether its tree sleeps: MuJoCo then leaves forces and inertia of its degrees of freedom as they are.
  bool Asleep(const mjModel* m, const mjData* d) const;

  // x, v of this step.
  void Gather(const mjModel* m, const mjData* d);

  // The points' accelerations at qacc = 0, dJ/dt qvel, in the soft body's axes: centripetal and Coriolis's. Zero where
  // all points but slide along axes at rest, and then null.
  const Vec3* BiasAccelerations(const mjModel* m, const mjData* d);

  // J a of the points, where they only slide.  a: one a degree of freedom.
  void Slide(const double* a, std::vector<Vec3>* out);

  // qfrc_passive += Jᵀ f; force: one a point.
  void StoreForce(const std::vector<Vec3>& force, mjData* d);

  // K_n of all movers, for the inertia of this step; after Gather. force: one a point, −∂E/∂x.
  void StiffenTurns(const std::vector<Vec3>& force, const mjData* d);

  // d->M += Jᵀ B J with B_jk = stiffness_scale K_jk + mass_jk I, and stiffness_scale K_n on the movers' rotations, if
  // any. stiffness: 3×3 row-major block a pair; mass: one a pair. d->M is the rigid inertia, or, if this body replaces
  // its entries, any.
  void StoreInertia(const double* stiffness, double stiffness_scale, const double* mass, const mjModel* m, mjData* d);

  // Where control point j is in the world; needs d alone, so that several threads may ask.
  Vec3 WorldPosition(const mjData* d, int j) const;

  // Its velocity there.
  Vec3 WorldVelocity(const mjModel* m, const mjData* d, int j) const;

  // From the point Σ_j ω_j x_j to `position` (soft body's axes). omega: one a point.
  Vec3 Lever(const double* omega, const Vec3& position) const;

  // Replaces the moments (one a mover) by those of the point Σ_j ω_j (x_j + lever), which turns with the bodies.
  void PointMoments(const double* omega, const Vec3& lever, std::vector<Moments>* moments) const {
    SumToMovers(omega, [&](size_t j) { return Moments{omega[j], omega[j] * (lever_[j] + lever)}; }, moments->data());
  }

  // Replaces the sums (one a mover) by Σ value(j) over the points at and below it whose ω_j is not zero.
  template <typename T, typename Value>
  void SumToMovers(const double* omega, const Value& value, T* sums) const {
    std::fill_n(sums, movers_.size(), T{});
    for (size_t j = 0; j < points_.size(); j++) {
      const int mover = points_[j].mover;
      if (mover >= 0 && omega[j] != 0) sums[mover] = sums[mover] + value(j);
    }
    for (size_t n = movers_.size(); n-- > 0;) {
      if (const int parent = movers_[n].parent; parent >= 0) sums[parent] = sums[parent] + sums[n];
    }
  }

  // Velocity of that point along `direction` (soft body's axes) for a unit rate of degree of freedom a of mover n.
  double RowEntry(const Moments& moments, const Vec3& direction, int n, int a) const;

  // Whether mover `upper` is at or above mover `lower`; −1 is above all.
  bool IsAbove(int upper, int lower) const;

  // The mover that has degree of freedom `dof`, −1 for none.
  int MoverOfDof(int dof) const;

  // Whether some of the soft body is fixed to this body of the scene.
  bool IsHeldBy(int body) const { return std::find(held_by_.begin(), held_by_.end(), body) != held_by_.end(); }

  // Whether some of it is fixed to any body of the scene.
  bool held() const { return !held_by_.empty(); }

  // The soft body's axes in the world, a world position and a world direction in them.
  Mat3 Axes(const mjData* d) const;
  Vec3 PositionToLocal(const mjData* d, const Vec3& position) const;
  // The other way.
  Vec3 PositionToWorld(const mjData* d, const Vec3& position) const;
  // The body whose axes they are.
  int holder() const { return holder_; }
  Vec3 ToLocal(const mjData* d, const Vec3& direction) const { return MulT(Axes(d), direction); }

  // Whether its entries of d->M are replaced: where all movers are slides along the axes, the rigid inertia of two of
  // them is the mass at and below the lower one, which mj_makeM leaves in d->crb, and nobody else's to change.
  bool replaces() const { return replaces_; }

  // Whether its first mover moves all of it, so that nothing holds it.
  bool is_free() const { return free_; }

  // Whether movers are more than slides along the soft body's axes.
  bool turning() const { return turning_; }

  const std::vector<ControlPoint>& points() const { return points_; }
  const std::vector<Mover>& movers() const { return movers_; }
  const std::vector<PointPair>& pairs() const { return pairs_; }
  const std::vector<Vec3>& x() const { return x_; }
  const std::vector<Vec3>& v() const { return v_; }

 private:
  void FindPoints(const mjModel* m, int instance, Reader* reader);
  void FindMovers(const mjModel* m, int instance);
  bool OwnsInertia(const mjModel* m, int instance) const;
  template <int N>
  void StoreForceOf(const std::vector<Vec3>& force, mjData* d);
  void AddTurns(double stiffness_scale);
  void SumMass(const double* mass);
  void StoreSlideInertia(const double* stiffness, double stiffness_scale, const double* mass, const mjModel* m,
                         mjData* d);
  void StoreTurningInertia(const double* stiffness, double stiffness_scale, const double* mass, mjData* d);

  int outermost_ = -1;  // of the soft body's own bodies that move, −1 for none
  int holder_ = 0;      // body whose axes are the soft body's
  bool turning_ = false;
  bool replaces_ = false;
  bool stiffens_ = false;  // whether all points ride on frames that turn, so that their turns are stiffened
  bool turns_ = false;     // whether points turn, or the axes along which they slide
  bool free_ = false;      // whether the first mover moves all points
  std::vector<ControlPoint> points_;
  std::vector<Mover> movers_;  // ancestors first
  std::vector<int> held_by_;   // bodies of the scene that some of it is fixed to
  std::vector<PointPair> pairs_;
  std::vector<int> pair_of_;  // (k × k) until Finish
  std::vector<int> entry_;    // addresses in d->M

  // of this step
  std::vector<Vec3> x_, v_;     // of the points
  std::vector<Vec3> bias_;      // their accelerations at qacc = 0, where they turn
  std::vector<Vec3> lever_;     // x − the middle of all, where they turn
  Vec3 middle_{};               // of all points, in the soft body's axes; zero where they only slide
  std::vector<Moments> load_;   // mass and its moment at and below the movers
  std::vector<double> weight_;  // the mass alone, where they only slide
  std::vector<Vec3> slide_;     // of the movers, where they only slide
  std::vector<double> twist_;   // S_a: translation, rotation                 (6 a degree of freedom)
  std::vector<double> motion_;  // velocity, then force, of the movers         (6 a mover)
  std::vector<Mat3> turn_;      // K_n of the movers, where they turn
  std::vector<double> sum_;     // Σ XᵀBX of the mover pairs                   (N × N a pair)
};

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_KINEMATICS_H_
