// Stress and projected Hessian of the laws at several deformation gradients at once, from their invariants
// (laws/law.h).
//
//   P = 2 f' F + 2 c₂ (I₁ F − F Fᵀ F) + g' cof F,   g' = κ (J − 1) − d
//
// With F = U diag(σ) Vᵀ, the Hessian of an isotropic law falls apart (Smith et al., ACM TOG 38(1), 2019): into a 3×3
// block A on the modes u_i v_iᵀ and, for each pair i ≠ j and the third index k, twist and flip (u_i v_jᵀ ∓ u_j
// v_iᵀ)/√2:
//
//   A_ii = 2 f' + 4 f'' σ_i² + 2 c₂ (I₁ − σ_i²) + κ (J/σ_i)²,   A_ij = 4 (f'' + c₂) σ_i σ_j + κ (J/σ_i)(J/σ_j) + g'
//   σ_k, twist, flip = 2 f' + 2 c₂ (σ_k² ± σ_i σ_j) ± g' σ_k.
//
// These are (ψ_i ± ψ_j)/(σ_i ± σ_j) divided out, so that equal and opposite σ are no special case. Eigenvalues are
// taken by their magnitude (Chen et al., Stabler Neo-Hookean Simulation, 2024): with zero for negative ones a crumpled
// body had nothing but its mass against a large force there, and steps of 4 ms threw it apart. On the way to rest some
// pass through zero where the stress does not, and the step grows without bound: a stiff bar of ten times its length
// flew apart. So a block's eigenvalue λ along n becomes max(|λ|, |p·n| / (kLongestStep max(1, σ₀))), p the principal
// stresses: no step of Newton's goes further than that.

#ifndef MJFRAMES_PLUGIN_HESSIAN_H_
#define MJFRAMES_PLUGIN_HESSIAN_H_

#include "constants.h"
#include "laws/laws.h"
#include "simd.h"
#include "svd.h"

namespace mjframes {

template <typename T>
struct Invariants {
  T cofactor[9];  // J F⁻ᵀ
  T i1, i2, j;
};

// f', f'', c₂ and κ of law.h, and g', at each of them.
template <typename T>
struct Slopes {
  T f1, f2, second, volume, g1;
};

template <typename T>
MJFRAMES_INLINE Invariants<T> InvariantsOf(const T* F) {
  Invariants<T> is;
  is.i1 = Fill<T>(0);
  T square = Fill<T>(0);  // |cof F|² = I₂
  for (int r = 0; r < 3; r++) {
    const int s = (r + 1) % 3, t = (r + 2) % 3;
    for (int a = 0; a < 3; a++) {
      const int b = (a + 1) % 3, c = (a + 2) % 3;
      const T entry = F[3 * s + b] * F[3 * t + c] - F[3 * s + c] * F[3 * t + b];
      is.cofactor[3 * r + a] = entry;
      square += entry * entry;
      is.i1 += F[3 * r + a] * F[3 * r + a];
    }
  }
  is.i2 = square;
  is.j = F[0] * is.cofactor[0] + F[1] * is.cofactor[1] + F[2] * is.cofactor[2];
  return is;
}

// material: of each lane.
template <typename V>
MJFRAMES_INLINE Slopes<V> SlopesOf(Law law, const LawParameters* material, const Invariants<V>& is) {
  Slopes<V> of;
  for (int lane = 0; lane < kWidth<V>; lane++) {
    const LawParameters& p = material[lane];
    const Stretch f = Respond(law, p, is.i1[lane]);
    of.f1[lane] = f.slope;
    of.f2[lane] = f.curvature;
    of.second[lane] = p.second;
    of.volume[lane] = p.volume;
    of.g1[lane] = p.volume * (is.j[lane] - 1) - p.linear;
  }
  return of;
}

template <typename T>
MJFRAMES_INLINE void FirstPiola(const T* F, const Invariants<T>& is, const Slopes<T>& of, T* P) {
  T C[9];
  for (int a = 0; a < 3; a++) {
    for (int b = 0; b < 3; b++) C[3 * a + b] = F[a] * F[b] + F[3 + a] * F[3 + b] + F[6 + a] * F[6 + b];
  }
  const T along = 2.0 * (of.f1 + of.second * is.i1), cubed = -2.0 * of.second;
  for (int r = 0; r < 9; r += 3) {
    for (int a = 0; a < 3; a++) {
      const T fc = F[r] * C[a] + F[r + 1] * C[3 + a] + F[r + 2] * C[6 + a];
      P[r + a] = along * F[r + a] + cubed * fc + of.g1 * is.cofactor[r + a];
    }
  }
}

// Whether all eigenvalues of all symmetric A (row major) are larger than `bound`: leading minors of A − bound I.
template <typename T>
MJFRAMES_INLINE bool ExceedsAll(const T* A, const T& bound) {
  const T a = A[0] - bound, b = A[4] - bound, c = A[8] - bound;
  const T minor = a * b - A[1] * A[1];
  const T determinant = a * (b * c - A[5] * A[5]) - A[1] * (A[1] * c - A[5] * A[2]) + A[2] * (A[1] * A[5] - b * A[2]);
  bool all = true;
  for (int lane = 0; lane < kWidth<T>; lane++) all = all && a[lane] > 0 && minor[lane] > 0 && determinant[lane] > 0;
  return all;
}

// The symmetric A (row major) with eigenvalues max(|λ|, |p·n| / reach), n the eigenvector, in place.
template <typename T>
MJFRAMES_INLINE void ProjectBlock(const T* p, const T& reach, T* A) {
  T square = Fill<T>(0), along = Fill<T>(0);
  for (int e = 0; e < 9; e++) square += A[e] * A[e];
  for (int e = 0; e < 3; e++) along += p[e] * p[e];
  const T shift = Sqrt(square);
  if (ExceedsAll(A, kCertain * (Sqrt(along) / reach + kRounding * shift))) return;  // nothing to change
  // A + c I is positive, so that its singular vectors are A's eigenvectors
  T B[9], V[9];
  for (int e = 0; e < 9; e++) B[e] = e % 4 == 0 ? A[e] + shift : A[e];
  Orthogonalize(B, V);
  T excess[3];  // what to add to each eigenvalue
  for (int c = 0; c < 3; c++) {
    const T value = Sqrt(B[c] * B[c] + B[3 + c] * B[3 + c] + B[6 + c] * B[6 + c]) - shift;
    const T least = Abs(p[0] * V[c] + p[1] * V[3 + c] + p[2] * V[6 + c]) / reach;
    const T size = Abs(value);
    excess[c] = (size > least ? size : least) - value;
  }
  for (int r = 0; r < 3; r++) {
    for (int s = r; s < 3; s++) {
      const T sum = excess[0] * V[3 * r] * V[3 * s] + excess[1] * V[3 * r + 1] * V[3 * s + 1] +
                    excess[2] * V[3 * r + 2] * V[3 * s + 2];
      A[3 * r + s] += sum;
      if (s > r) A[3 * s + r] = A[3 * r + s];
    }
  }
}

// H[9 (3r + a) + 3s + b] = ∂P_ra/∂F_sb, projected.
template <typename T>
MJFRAMES_INLINE void ProjectedHessian(const T* F, const Slopes<T>& of, T* H) {
  T U[9], V[9], sigma[3];
  SignedSvd(F, U, sigma, V);

  T A[9], p[3], same[3], crossed[3];  // by k: (twist ± flip)/2, on (ij, ij) and on (ij, ji)
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    const T ji = sigma[j] * sigma[k], jj = sigma[i] * sigma[k];  // J/σ_i, J/σ_j
    A[4 * i] = 2.0 * of.f1 + 4.0 * of.f2 * sigma[i] * sigma[i] +
               2.0 * of.second * (sigma[j] * sigma[j] + sigma[k] * sigma[k]) + of.volume * ji * ji;
    p[i] = 2.0 * sigma[i] * (of.f1 + of.second * (sigma[j] * sigma[j] + sigma[k] * sigma[k])) + of.g1 * ji;
    const T product = sigma[i] * sigma[j];
    const T mixed = 4.0 * (of.f2 + of.second) * product + of.volume * ji * jj + of.g1 * sigma[k];
    A[3 * i + j] = A[3 * j + i] = mixed;
    const T even = 2.0 * of.f1 + 2.0 * of.second * sigma[k] * sigma[k];
    const T odd = 2.0 * of.second * product + of.g1 * sigma[k];
    const T twist = Abs(even + odd), flip = Abs(even - odd);
    same[k] = 0.5 * (flip + twist);
    crossed[k] = 0.5 * (flip - twist);
  }
  ProjectBlock(p, kLongestStep * (sigma[0] > 1.0 ? sigma[0] : Fill<T>(1)), A);

  // H = Σ M_ij ⊗ R_ij, M_ij = u_i v_jᵀ
  T M[9][9], R[9][9];
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++) {
      for (int e = 0; e < 9; e++) M[3 * i + j][e] = U[e / 3 * 3 + i] * V[e % 3 * 3 + j];
    }
  }
  for (int i = 0; i < 3; i++) {
    for (int e = 0; e < 9; e++) R[4 * i][e] = A[3 * i] * M[0][e] + A[3 * i + 1] * M[4][e] + A[3 * i + 2] * M[8][e];
    for (int j = 0; j < 3; j++) {
      if (j == i) continue;
      const int k = 3 - i - j;
      for (int e = 0; e < 9; e++) R[3 * i + j][e] = same[k] * M[3 * i + j][e] + crossed[k] * M[3 * j + i][e];
    }
  }
  for (int e = 0; e < 9; e++) {
    for (int f = e; f < 9; f++) {
      T sum = M[0][e] * R[0][f];
      for (int n = 1; n < 9; n++) sum += M[n][e] * R[n][f];
      H[9 * e + f] = H[9 * f + e] = sum;
    }
  }
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_HESSIAN_H_
