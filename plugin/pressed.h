// What is pressed gets stiffer: energy that a region of the law `corotational` has beside W (corotational.h),
//
//   ψ = c Σ_i g(1 − b − σ_i),   σ the eigenvalues of 1 + ε,   ε = C⁻¹ Uᵀ K_e y,   C = Uᵀ K_e U,   c = λ μ V / (λ + μ)
//
// U are the uniform strains of the points: ε is that strain whose stress is the mean of what the region has. Of all
// measures of strain it is the one that K_e resists most, so that bends hardly change it. (What a linear fit to the
// points shows, bends of thin and branching bodies change for almost nothing; with a ψ of that they stayed crumpled.)
//
// Hooke's law in axes that turn with the material does not get stiffer where it is pressed, and loses its resistance to
// shear there: a plate with half of Young's modulus went through a pad. Between free sides, rubber that keeps its
// volume resists μ (1/σ² − σ) where Hooke's law has 3 μ (1 − σ), and a material without λ resists no more than Hooke's
// law. g′ = 18 e² for e > 0 is nearly the difference for ν = 0.45; where σ is below kPressedEnd it goes straight on. As
// g is convex, ψ has no other minimum than rest, and its Hessian is positive semi-definite.
//
// R is the rotation of least energy, this one with it. Index letters: s, t strains, of the symmetric S of unit |S|:
// three along the axes, then three across them.

#ifndef MJFRAMES_PLUGIN_PRESSED_H_
#define MJFRAMES_PLUGIN_PRESSED_H_

#include "constants.h"
#include "simd.h"
#include "svd.h"

namespace mjframes {

inline constexpr int kStrains = 6;

template <typename V>
struct Pressed {
  V energy;                        // ψ [J]
  V stress[kStrains];              // P = ∂ψ/∂ε [J]
  V hessian[kStrains * kStrains];  // ∂P/∂ε [J]
};

// A : S_s
template <typename V>
MJFRAMES_INLINE V AlongStrain(const V* A, int s) {
  const int a = s % 3, b = (s + 1) % 3;
  return s < 3 ? A[4 * a] : kSqrtHalf * (A[3 * a + b] + A[3 * b + a]);
}

// F = 1 + Σ_s ε_s S_s
template <typename V>
MJFRAMES_INLINE void FromStrains(const V* strain, V* F) {
  for (int s = 0; s < 3; s++) {
    const int a = s, b = (s + 1) % 3;
    F[4 * a] = 1.0 + strain[s];
    F[3 * a + b] = F[3 * b + a] = kSqrtHalf * strain[3 + s];
  }
}

// g, g′ and g″
template <typename V>
MJFRAMES_INLINE void Stiffening(const V& e, V* g) {
  constexpr double kEnd = 1 - kPressedBegin - kPressedEnd;
  const V in = e > 0.0 ? (e < kEnd ? e : Fill<V>(kEnd)) : V{}, beyond = e > kEnd ? e - kEnd : V{};
  const V square = in * in;
  g[2] = 36.0 * in;
  g[1] = 18.0 * square;
  g[0] = 6.0 * in * square + beyond * (g[1] + 0.5 * beyond * g[2]);
  g[1] += beyond * g[2];
}

template <typename V>
MJFRAMES_INLINE Pressed<V> PressedAt(const V& firmness, const V* strain) {
  Pressed<V> at;
  V B[9], axes[9], excess[3], g[9];
  FromStrains(strain, B);
  V square = {};
  for (int e = 0; e < 9; e++) square += B[e] * B[e];
  const V shift = Sqrt(square);  // with it all eigenvalues are positive, so that singular vectors are eigenvectors
  for (int e = 0; e < 9; e += 4) B[e] += shift;
  Orthogonalize(B, axes);
  at.energy = V{};
  for (int i = 0; i < 3; i++) {
    const V value = Sqrt(B[i] * B[i] + B[3 + i] * B[3 + i] + B[6 + i] * B[6 + i]) - shift;
    excess[i] = 1.0 - kPressedBegin - value;
    Stiffening(excess[i], g + 3 * i);
    at.energy += firmness * g[3 * i];
  }
  for (int n = 0; n < kStrains * kStrains; n++) at.hessian[n] = V{};
  for (int s = 0; s < kStrains; s++) at.stress[s] = V{};
  for (int m = 0; m < kStrains; m++) {  // strains along and across the axes of ε
    const int i = m % 3, j = m < 3 ? i : (m + 1) % 3;
    V mode[9], along[kStrains], curvature = g[3 * i + 2];
    for (int e = 0; e < 9; e++) {
      const int a = e / 3, b = e % 3;
      mode[e] = m < 3 ? axes[3 * a + i] * axes[3 * b + i]
                      : kSqrtHalf * (axes[3 * a + i] * axes[3 * b + j] + axes[3 * a + j] * axes[3 * b + i]);
    }
    if (m >= 3) {  // (g′_i − g′_j)/(e_i − e_j)
      const V apart = excess[i] - excess[j], mean = 0.5 * (curvature + g[3 * j + 2]);
      curvature = Abs(apart) > kAlike ? (g[3 * i + 1] - g[3 * j + 1]) / apart : mean;
    }
    curvature *= firmness;
    for (int s = 0; s < kStrains; s++) along[s] = AlongStrain(mode, s);
    for (int s = 0; s < kStrains; s++) {
      if (m < 3) at.stress[s] -= firmness * g[3 * i + 1] * along[s];
      for (int t = 0; t < kStrains; t++) at.hessian[kStrains * s + t] += curvature * along[s] * along[t];
    }
  }
  return at;
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PRESSED_H_
