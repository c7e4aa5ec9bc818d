// The proper rotation closest to a deformation gradient: R = argmax over SO(3) of tr(Rᵀ F).
//
// det R = +1 always, also for an inverted or flattened F ("SVD with the smallest singular direction flipped").

#ifndef MJFRAMES_PLUGIN_ROTATION_H_
#define MJFRAMES_PLUGIN_ROTATION_H_

#include "linear.h"

namespace mjframes {

// Of Newton's iteration.
inline constexpr int kRotationSteps = 8;     // quadratic convergence: a guess within 1 rad needs 3 to 5
inline constexpr double kRotated = 1e-8;     // [rad] quadratic convergence: the next correction is below rounding
inline constexpr double kTrustRadius = 0.7;  // [rad] longest Newton correction that is followed
inline constexpr double kMinTwist = 1e-6;    // [-] relative to |F|: below, Newton's matrix is useless

// F: deformation gradient [-].  guess: any rotation; a close one makes it cheap. The result depends on it only
// in rounding, and on a set of measure zero (F with no unique closest rotation).
Mat3 ClosestRotation(const Mat3& F, const Mat3& guess);

// H = tr(S) I − S for S = Rᵀ F: its smallest eigenvalue says how firmly F determines R.
inline Mat3 TwistMatrix(const Mat3& S) {
  const double trace = S[0] + S[4] + S[8];
  return {trace - S[0], -S[1], -S[2], -S[3], trace - S[4], -S[5], -S[6], -S[7], trace - S[8]};
}

// Smallest eigenvalue of the symmetric part of S (row major).
double SmallestEigenvalue(const Mat3& S);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_ROTATION_H_
