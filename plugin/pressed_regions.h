// What regions have of pressed.h, side by side: as a cell that is all of the region (corotational.h).

#ifndef MJFRAMES_PLUGIN_PRESSED_REGIONS_H_
#define MJFRAMES_PLUGIN_PRESSED_REGIONS_H_

#include <algorithm>
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

// ε = E y, from w_j = (K y)_j, each `stride` entries after the one before; of K, κ does not see U.
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

// The regions that have a ψ at this ε.
template <typename V>
MJFRAMES_INLINE Mask<V> ArePressed(const Half<V>& half, const V* strain) {
  V F[9];
  FromStrains(strain, F);
  return half.Of(half.moduli.pressed.data(), 0) > 0.0 && !EigenvaluesExceed(F, Fill<V>(1 - kPressedBegin));
}

template <typename V>
struct PressedRegions {
  Pressed<V> at;
  V hessian[kStrains * kStrains];  // C⁻¹ H C⁻¹
};

// What of the regions is pressed, but for `hessian`, from the product without it.
template <typename V>
MJFRAMES_INLINE PressedRegions<V> FindPressed(const Half<V>& half, const BatchScratch& scratch) {
  V strain[kStrains];
  StrainOf(half, scratch.product.data(), 12, strain);
  return {.at = PressedAt(half.Of(half.moduli.pressed.data(), 0), strain), .hessian = {}};
}

// `moment` of x̄.
template <typename V>
MJFRAMES_INLINE void MultiplyRest(const Half<V>& half, BatchScratch* scratch) {
  for (int j = 0; j < half.size; j++) {
    V moment[27] = {};
    for (int k = 0; k < half.size; k++) {
      V K[9];
      half.Block(half.moduli.stiffness.data(), j, k, K);
      for (int s = 0; s < 3; s++) {
        const V rest = half.Of(half.batch.rest.data(), 3 * k + s);
        for (int e = 0; e < 9; e++) moment[3 * e + s] += K[e] * rest;
      }
    }
    for (int e = 0; e < 27; e++) half.Put(moment[e], scratch->moment.data(), 27 * j + e);
  }
}

// G = (K U)_j of a point after MultiplyRest: entry 3 s + r.
template <typename V>
MJFRAMES_INLINE void ByStrain(const Half<V>& half, const BatchScratch& scratch, int j, V* G) {
  V moment[27];
  for (int e = 0; e < 27; e++) moment[e] = half.Of(scratch.moment.data(), 27 * j + e);
  for (int s = 0; s < kStrains; s++) {
    for (int r = 0; r < 3; r++) G[3 * s + r] = AlongStrain(moment + 9 * r, s);
  }
}

// Adds Eᵀ [P | H E Z] to the product [w | K Z], the first column alone unless `curved`, which also sets `hessian`.
template <typename V>
MJFRAMES_INLINE void AddPressed(const Half<V>& half, bool curved, PressedRegions<V>* of, BatchScratch* scratch) {
  const Pressed<V>& at = of->at;
  double* product = scratch->product.data();
  const int columns = curved ? 4 : 1;
  V load[4 * kStrains] = {};  // C⁻¹ P and C⁻¹ H E Z side by side
  for (int s = 0; s < kStrains; s++) load[4 * s] = at.stress[s];
  for (int c = 1; c < columns; c++) {
    V turned[kStrains];  // of E Z
    StrainOf(half, product + kWideLanes * 3 * c, 12, turned);
    for (int n = 0; n < kStrains * kStrains; n++) load[4 * (n / kStrains) + c] += at.hessian[n] * turned[n % kStrains];
  }
  if (curved) {
    std::copy_n(at.hessian, kStrains * kStrains, of->hessian);
    Comply(half, kStrains, of->hessian);
    for (int s = 0; s < kStrains; s++) {
      for (int t = 0; t < s; t++) std::swap(of->hessian[kStrains * s + t], of->hessian[kStrains * t + s]);
    }
    Comply(half, kStrains, of->hessian);
  }
  Comply(half, 4, load);
  MultiplyRest(half, scratch);
  for (int j = 0; j < half.size; j++) {
    V G[3 * kStrains];
    ByStrain(half, *scratch, j, G);
    for (int c = 0; c < columns; c++) {
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
MJFRAMES_INLINE void PressedRow(const Half<V>& half, const PressedRegions<V>& of, const BatchScratch& scratch, int j,
                                V* T) {
  V G[3 * kStrains];
  ByStrain(half, scratch, j, G);
  for (int r = 0; r < 3; r++) {
    for (int t = 0; t < kStrains; t++) {
      V sum = G[r] * of.hessian[t];
      for (int s = 1; s < kStrains; s++) sum += G[3 * s + r] * of.hessian[kStrains * s + t];
      T[kStrains * r + t] = sum;
    }
  }
}

// block += T (K U)_kᵀ, T of the point j.
template <typename V>
MJFRAMES_INLINE void AddPressedBlock(const Half<V>& half, const V* T, const BatchScratch& scratch, int k, V* block) {
  V G[3 * kStrains];
  ByStrain(half, scratch, k, G);
  for (int e = 0; e < 9; e++) {
    for (int s = 0; s < kStrains; s++) block[e] += T[kStrains * (e / 3) + s] * G[3 * s + e % 3];
  }
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PRESSED_REGIONS_H_
