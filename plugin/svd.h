// F = U diag(σ) Vᵀ of several 3×3 matrices at once, one a lane, U and V proper rotations: σ₀ ≥ σ₁ ≥ |σ₂|, σ₂ < 0 where
// det F < 0.
//
// One-sided Jacobi: the columns of F are rotated in pairs, the longer one first, until they are orthogonal; the
// rotations make up V, the columns are σ_i u_i. Unlike the eigenvectors of Fᵀ F, this keeps small σ to all digits.

#ifndef MJFRAMES_PLUGIN_SVD_H_
#define MJFRAMES_PLUGIN_SVD_H_

#include "constants.h"
#include "simd.h"

namespace mjframes {

// Rotates columns p and q of B and V; true where they were not orthogonal yet.
template <typename T>
MJFRAMES_INLINE T RotateColumns(int p, int q, T* B, T* V) {
  const T alpha = B[p] * B[p] + B[3 + p] * B[3 + p] + B[6 + p] * B[6 + p];
  const T beta = B[q] * B[q] + B[3 + q] * B[3 + q] + B[6 + q] * B[6 + q];
  const T gamma = B[p] * B[q] + B[3 + p] * B[3 + q] + B[6 + p] * B[6 + q];
  // tan 2θ = 2γ / (α − β), with the θ of the two that puts the longer column first
  const T difference = Abs(alpha - beta);
  const T r = Sqrt(difference * difference + 4.0 * gamma * gamma);
  const T cosine2 = r > 0.0 ? difference / r : Fill<T>(1);
  const T large = Sqrt(0.5 + 0.5 * cosine2);
  const T small = r > 0.0 ? Abs(gamma) / (r * large) : Fill<T>(0);
  const T c = alpha >= beta ? large : small;
  const T size = alpha >= beta ? small : large;
  const T s = gamma < 0.0 ? -size : size;
  for (int r3 = 0; r3 < 9; r3 += 3) {
    const T bp = B[r3 + p], bq = B[r3 + q], vp = V[r3 + p], vq = V[r3 + q];
    B[r3 + p] = c * bp + s * bq;
    B[r3 + q] = c * bq - s * bp;
    V[r3 + p] = c * vp + s * vq;
    V[r3 + q] = c * vq - s * vp;
  }
  return gamma * gamma - kOrthogonal * alpha * beta;
}

// Replaces B by B V with orthogonal columns of descending length.
template <typename T>
MJFRAMES_INLINE void Orthogonalize(T* B, T* V) {
  for (int e = 0; e < 9; e++) V[e] = Fill<T>(e % 4 == 0);
  for (int sweep = 0; sweep < kSvdSweeps; sweep++) {
    const T a = RotateColumns(0, 1, B, V);
    const T b = RotateColumns(0, 2, B, V);
    const T c = RotateColumns(1, 2, B, V);
    if (!AnyPositive(a) && !AnyPositive(b) && !AnyPositive(c)) break;
  }
}

template <typename T>
MJFRAMES_INLINE void SignedSvd(const T* F, T* U, T* sigma, T* V) {
  T B[9];
  for (int e = 0; e < 9; e++) B[e] = F[e];
  Orthogonalize(B, V);
  const T zero = Fill<T>(0), one = Fill<T>(1);

  sigma[0] = Sqrt(B[0] * B[0] + B[3] * B[3] + B[6] * B[6]);
  const T x = sigma[0] > 0.0 ? B[0] / sigma[0] : one;
  const T y = sigma[0] > 0.0 ? B[3] / sigma[0] : zero;
  const T z = sigma[0] > 0.0 ? B[6] / sigma[0] : zero;

  // u₁ from the second column; any vector across u₀ where that column is zero
  sigma[1] = Sqrt(B[1] * B[1] + B[4] * B[4] + B[7] * B[7]);
  const T sign = z < 0.0 ? -one : one;
  const T a = -1.0 / (sign + z);
  const T across[3] = {1.0 + sign * x * x * a, sign * x * y * a, -sign * x};
  T u1[3];
  for (int r = 0; r < 3; r++) u1[r] = sigma[1] > 0.0 ? B[3 * r + 1] / sigma[1] : across[r];

  U[0] = x, U[3] = y, U[6] = z;
  U[1] = u1[0], U[4] = u1[1], U[7] = u1[2];
  U[2] = y * u1[2] - z * u1[1];
  U[5] = z * u1[0] - x * u1[2];
  U[8] = x * u1[1] - y * u1[0];
  sigma[2] = U[2] * B[2] + U[5] * B[5] + U[8] * B[8];
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_SVD_H_
