#include "rotation.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "constants.h"

namespace mjframes {
namespace {

Mat3 FromQuaternion(const std::array<double, 4>& q) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  return {w * w + x * x - y * y - z * z, 2 * (x * y - w * z),           2 * (x * z + w * y),
          2 * (x * y + w * z),           w * w - x * x + y * y - z * z, 2 * (y * z - w * x),
          2 * (x * z - w * y),           2 * (y * z + w * x),           w * w - x * x - y * y + z * z};
}

// Rotation by Newton's correction ω (a Cayley map: exact rotation, same first two orders as exp)
Mat3 Cayley(const Vec3& omega) {
  const double n = 1 / std::sqrt(1 + 0.25 * Dot(omega, omega));
  return FromQuaternion({n, 0.5 * n * omega[0], 0.5 * n * omega[1], 0.5 * n * omega[2]});
}

// Jacobi's method: makes a symmetric matrix diagonal, a ← vᵀ a v; the columns of v are its eigenvectors.
template <int n>
void Diagonalize(double (&a)[n][n], double (&v)[n][n]) {
  for (int p = 0; p < n; p++) {
    for (int q = 0; q < n; q++) v[p][q] = p == q;
  }
  for (int sweep = 0; sweep < kJacobiSweeps; sweep++) {
    double off = 0, diagonal = 0;
    for (int p = 0; p < n; p++) {
      diagonal += a[p][p] * a[p][p];
      for (int q = p + 1; q < n; q++) off += a[p][q] * a[p][q];
    }
    if (off <= kOrthogonal * diagonal) break;
    for (int p = 0; p < n - 1; p++) {
      for (int q = p + 1; q < n; q++) {
        if (a[p][q] == 0) continue;
        const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
        const double t = (theta >= 0 ? 1 : -1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
        const double c = 1 / std::sqrt(t * t + 1), s = t * c;
        for (int k = 0; k < n; k++) {
          const double kp = a[k][p], kq = a[k][q];
          a[k][p] = c * kp - s * kq;
          a[k][q] = s * kp + c * kq;
        }
        for (int k = 0; k < n; k++) {
          const double pk = a[p][k], qk = a[q][k];
          a[p][k] = c * pk - s * qk;
          a[q][k] = s * pk + c * qk;
        }
        for (int k = 0; k < n; k++) {
          const double kp = v[k][p], kq = v[k][q];
          v[k][p] = c * kp - s * kq;
          v[k][q] = s * kp + c * kq;
        }
      }
    }
  }
}

// The largest eigenvector of Davenport's 4×4 matrix is the quaternion that maximises tr(Rᵀ F).
Mat3 GlobalMaximum(const Mat3& F) {
  double a[4][4] = {{F[0] + F[4] + F[8], F[7] - F[5], F[2] - F[6], F[3] - F[1]},
                    {F[7] - F[5], F[0] - F[4] - F[8], F[1] + F[3], F[2] + F[6]},
                    {F[2] - F[6], F[1] + F[3], F[4] - F[0] - F[8], F[5] + F[7]},
                    {F[3] - F[1], F[2] + F[6], F[5] + F[7], F[8] - F[0] - F[4]}};
  double v[4][4];
  Diagonalize(a, v);
  int best = 0;
  for (int p = 1; p < 4; p++) {
    if (a[p][p] > a[best][best]) best = p;
  }
  std::array<double, 4> q = {v[0][best], v[1][best], v[2][best], v[3][best]};
  const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (double& c : q) c /= norm;
  return FromQuaternion(q);
}

// Newton's iteration for the stationary point of tr(Rᵀ F) near R; false if it does not end at a maximum.
bool Refine(const Mat3& F, double scale, Mat3* R) {
  for (int step = 0; step < kRotationSteps; step++) {
    const Mat3 S = Mul(Transpose(*R), F);
    const double trace = S[0] + S[4] + S[8];
    const double xy = 0.5 * (S[1] + S[3]), xz = 0.5 * (S[2] + S[6]), yz = 0.5 * (S[5] + S[7]);
    const Mat3 H = {trace - S[0], -xy, -xz, -xy, trace - S[4], -yz, -xz, -yz, trace - S[8]};
    // a maximum has H positive definite (leading minors); only then is it the global one
    const double minor2 = H[0] * H[4] - H[1] * H[3];
    const double floor = kMinTwist * scale;
    if (!(H[0] > floor && minor2 > floor * H[0] && Det(H) > floor * minor2)) return false;
    const Vec3 moment = {S[7] - S[5], S[2] - S[6], S[3] - S[1]};
    const Vec3 omega = Mul(Inverse(H), moment);
    const double angle = Norm(omega);
    if (!(angle < kTrustRadius)) return false;
    *R = Mul(*R, Cayley(omega));
    if (angle < kRotated) return true;
  }
  return false;
}

}  // namespace

Mat3 ClosestRotation(const Mat3& F, const Mat3& guess) {
  double scale = 0;
  for (double f : F) scale = std::max(scale, std::abs(f));
  if (!(scale > 0)) return kIdentity;
  Mat3 R = guess;
  if (Refine(F, scale, &R)) return R;
  R = GlobalMaximum(F);
  Mat3 refined = R;
  return Refine(F, scale, &refined) ? refined : R;
}

Vec3 Eigenvectors(const Mat3& S, Mat3* vector) {
  const double xy = 0.5 * (S[1] + S[3]), xz = 0.5 * (S[2] + S[6]), yz = 0.5 * (S[5] + S[7]);
  double a[3][3] = {{S[0], xy, xz}, {xy, S[4], yz}, {xz, yz, S[8]}}, v[3][3];
  Diagonalize(a, v);
  for (int e = 0; e < 9; e++) (*vector)[e] = v[e / 3][e % 3];
  return {a[0][0], a[1][1], a[2][2]};
}

}  // namespace mjframes
