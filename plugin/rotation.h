// The proper rotation closest to a deformation gradient: R = argmax over SO(3) of tr(Rᵀ F).
//
// det R = +1 always, also for an inverted or flattened F ("SVD with the smallest singular direction flipped"). For one
// F, and for several side by side, one a lane.

#ifndef MJFRAMES_PLUGIN_ROTATION_H_
#define MJFRAMES_PLUGIN_ROTATION_H_

#include "constants.h"
#include "linear.h"
#include "simd.h"

namespace mjframes {

// F: deformation gradient [-].  guess: any rotation; a close one makes it cheap. The result depends on it only
// in rounding, and on a set of measure zero (F with no unique closest rotation).
Mat3 ClosestRotation(const Mat3& F, const Mat3& guess);

// Eigenvalues of the symmetric part of S (row major), and its eigenvectors, as columns.
Vec3 Eigenvectors(const Mat3& S, Mat3* vector);

// Whether the symmetric part of S has no eigenvalue below `bound`: the leading minors of it − bound I are positive.
template <typename V>
MJFRAMES_INLINE Mask<V> EigenvaluesExceed(const V* S, const V& bound) {
  const V a = S[0] - bound, b = S[4] - bound, c = S[8] - bound;
  const V xy = 0.5 * (S[1] + S[3]), xz = 0.5 * (S[2] + S[6]), yz = 0.5 * (S[5] + S[7]);
  const V minor2 = a * b - xy * xy;
  return a > 0.0 && minor2 > 0.0 && c * minor2 + xz * (2.0 * xy * yz - b * xz) - a * yz * yz > 0.0;
}

// Cayley's map less the identity, 2 ([q]× + [q]×²) / (1 + |q|²): an exact rotation by about 2 q [rad], precise for
// small q.
template <typename V>
MJFRAMES_INLINE void CayleyTurn(const V* q, V* turn) {
  const V x = q[0], y = q[1], z = q[2];
  const V twice = 2.0 / (1.0 + (x * x + y * y + z * z));
  turn[0] = -twice * (y * y + z * z);
  turn[1] = twice * (x * y - z);
  turn[2] = twice * (x * z + y);
  turn[3] = twice * (x * y + z);
  turn[4] = -twice * (x * x + z * z);
  turn[5] = twice * (y * z - x);
  turn[6] = twice * (x * z - y);
  turn[7] = twice * (y * z + x);
  turn[8] = -twice * (x * x + y * y);
}

// Rotations closest to F by Newton's iteration from R, see rotation.cc; lanes where it fails start anew.
template <typename V>
MJFRAMES_INLINE void FollowRotation(const V* F, V* R) {
  V scale = Abs(F[0]);
  for (int e = 1; e < 9; e++) scale = scale > Abs(F[e]) ? scale : Abs(F[e]);
  const V floor = kMinTwist * scale;
  auto good = scale > 0.0, close = scale < 0.0;
  for (int step = 0; step < kRotationSteps && !All<V>(close || !good); step++) {
    V S[9], adjugate[9];
    MulT3(R, F, S);
    const V trace = S[0] + S[4] + S[8];
    const V xy = -0.5 * (S[1] + S[3]), xz = -0.5 * (S[2] + S[6]), yz = -0.5 * (S[5] + S[7]);
    const V H[9] = {trace - S[0], xy, xz, xy, trace - S[4], yz, xz, yz, trace - S[8]};
    const V determinant = Adjugate(H, adjugate);
    // a maximum has H positive definite (leading minors); only then is it the global one
    const V minor2 = adjugate[8];
    const V moment[3] = {S[7] - S[5], S[2] - S[6], S[3] - S[1]};
    V q[3];  // half Newton's correction
    for (int r = 0; r < 3; r++) {
      q[r] = 0.5 * (adjugate[3 * r] * moment[0] + adjugate[3 * r + 1] * moment[1] + adjugate[3 * r + 2] * moment[2]) /
             determinant;
    }
    const V square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2];
    good = good && H[0] > floor && minor2 > floor * H[0] && determinant > floor * minor2 &&
           4.0 * square < kTrustRadius * kTrustRadius;
    V turn[9], turned[9];
    CayleyTurn(q, turn);
    for (int e = 0; e < 9; e += 4) turn[e] += 1.0;
    Mul3(R, turn, turned);
    for (int e = 0; e < 9; e++) R[e] = turned[e];
    close = 4.0 * square < kRotated * kRotated;
  }
  for (int lane = 0; lane < kWidth<V>; lane++) {
    if (good[lane] && close[lane]) continue;
    const Mat3 one = ClosestRotation(LaneOf(F, lane), kIdentity);
    for (int e = 0; e < 9; e++) R[e][lane] = one[e];
  }
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_ROTATION_H_
