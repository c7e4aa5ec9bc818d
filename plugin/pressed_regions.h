// What regions have of pressed.h, side by side: as a cell that is all of the region (corotational.h).

#ifndef MJFRAMES_PLUGIN_PRESSED_REGIONS_H_
#define MJFRAMES_PLUGIN_PRESSED_REGIONS_H_

#include <utility>

#include "pressed.h"
#include "region_lanes.h"
#include "rotation.h"

namespace mjframes {

// C⁻¹ A of an A with so many columns, in place.
template <typename V>
MJFRAMES_INLINE void Comply(const Half<V>& half, int columns, V* A) {
  for (int c = 0; c < columns; c++) {
    V before[kStrains];
    for (int s = 0; s < kStrains; s++) before[s] = A[columns * s + c];
    for (int s = 0; s < kStrains; s++) {
      V sum = half.Of(half.moduli.compliance.data(), kStrains * s) * before[0];
      for (int t = 1; t < kStrains; t++) sum += half.Of(half.moduli.compliance.data(), kStrains * s + t) * before[t];
      A[columns * s + c] = sum;
    }
  }
}

// ε, from w_j = (K_e y)_j, each `stride` entries after the one before.
template <typename V>
MJFRAMES_INLINE void StrainOf(const Half<V>& half, const double* w, int stride, V* strain) {
  V moment[9] = {};
  for (int j = 0; j < half.size; j++) {
    V f[3];
    for (int r = 0; r < 3; r++) f[r] = half.Of(w, static_cast<size_t>(stride) * j + r);
    for (int e = 0; e < 9; e++) moment[e] += half.Of(half.batch.rest.data(), 3 * j + e / 3) * f[e % 3];
  }
  for (int s = 0; s < kStrains; s++) strain[s] = AlongStrain(moment, s);
  Comply(half, 1, strain);
}

// K_e U of a point: row s.
template <typename V>
MJFRAMES_INLINE void ByStrain(const Half<V>& half, int j, V* G) {
  for (int n = 0; n < 3 * kStrains; n++) G[n] = half.Of(half.moduli.by_strain.data(), 3 * kStrains * j + n);
}

template <typename V>
struct PressedRegions {
  Pressed<V> at;
  V load[4 * kStrains];            // C⁻¹ P and C⁻¹ H E Z side by side
  V hessian[kStrains * kStrains];  // C⁻¹ H C⁻¹

  // product: w of K_e alone.
  MJFRAMES_INLINE PressedRegions(const Half<V>& half, const double* product) {
    V strain[kStrains];
    StrainOf(half, product, 12, strain);
    at = PressedAt(half.Of(half.moduli.pressed.data(), 0), strain);
  }
};

// The regions that have a ψ at this ε.
template <typename V>
MJFRAMES_INLINE Mask<V> ArePressed(const Half<V>& half, const V* strain) {
  V F[9];
  FromStrains(strain, F);
  return half.Of(half.moduli.pressed.data(), 0) > 0.0 && !EigenvaluesExceed(F, Fill<V>(1 - kPressedBegin));
}

// Adds Eᵀ [P | H E Z] to the product, the first column alone unless `curved`.
template <typename V>
MJFRAMES_INLINE void AddPressed(const Half<V>& half, bool curved, const double* z, PressedRegions<V>* of,
                                double* product) {
  V* load = of->load;
  for (int n = 0; n < 4 * kStrains; n++) load[n] = n % 4 == 0 ? of->at.stress[n / 4] : V{};
  if (curved) {
    V turned[3 * kStrains] = {};  // E Z
    for (int j = 0; j < half.size; j++) {
      V G[3 * kStrains], at[3], cross[3];
      ByStrain(half, j, G);
      for (int r = 0; r < 3; r++) at[r] = half.Of(z, 3 * j + r);
      for (int s = 0; s < kStrains; s++) {
        Cross3(at, G + 3 * s, cross);  // its component c is G·(e_c × z)
        for (int c = 0; c < 3; c++) turned[3 * s + c] += cross[c];
      }
    }
    Comply(half, 3, turned);
    for (int s = 0; s < kStrains; s++) {
      for (int t = 0; t < kStrains; t++) {
        of->hessian[kStrains * s + t] = of->at.hessian[kStrains * s + t];
        for (int c = 0; c < 3; c++) load[4 * s + 1 + c] += of->at.hessian[kStrains * s + t] * turned[3 * t + c];
      }
    }
    Comply(half, kStrains, of->hessian);
    for (int s = 0; s < kStrains; s++) {
      for (int t = 0; t < s; t++) std::swap(of->hessian[kStrains * s + t], of->hessian[kStrains * t + s]);
    }
    Comply(half, kStrains, of->hessian);
  }
  Comply(half, 4, load);
  for (int j = 0; j < half.size; j++) {
    V G[3 * kStrains];
    ByStrain(half, j, G);
    for (int c = 0; c < (curved ? 4 : 1); c++) {
      for (int r = 0; r < 3; r++) {
        V sum = half.Of(product, 12 * j + 3 * c + r);
        for (int s = 0; s < kStrains; s++) sum += G[3 * s + r] * load[4 * s + c];
        half.Put(sum, product, 12 * j + 3 * c + r);
      }
    }
  }
}

// T (3 × 6): what a point has of Eᵀ H C⁻¹, entry 6 r + s.
template <typename V>
MJFRAMES_INLINE void PressedRow(const Half<V>& half, const PressedRegions<V>& of, int j, V* T) {
  V G[3 * kStrains];
  ByStrain(half, j, G);
  for (int r = 0; r < 3; r++) {
    for (int t = 0; t < kStrains; t++) {
      V sum = G[r] * of.hessian[t];
      for (int s = 1; s < kStrains; s++) sum += G[3 * s + r] * of.hessian[kStrains * s + t];
      T[kStrains * r + t] = sum;
    }
  }
}

// block += T (K_e U)_kᵀ, T of the point j.
template <typename V>
MJFRAMES_INLINE void AddPressedBlock(const Half<V>& half, const V* T, int k, V* block) {
  V G[3 * kStrains];
  ByStrain(half, k, G);
  for (int e = 0; e < 9; e++) {
    for (int s = 0; s < kStrains; s++) block[e] += T[kStrains * (e / 3) + s] * G[3 * s + e % 3];
  }
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PRESSED_REGIONS_H_
