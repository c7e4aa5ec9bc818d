#include <algorithm>
#include <cmath>

#include "constants.h"
#include "corotational.h"
#include "hessian.h"
#include "rotation.h"
#include "simd.h"

namespace mjframes {
namespace {

// A⁻¹; where A has rank two, as s (I − u uᵀ) for points along u, its pseudo-inverse; zero for less.
Mat3 PseudoInverse(const Mat3& A) {
  double size = 0;
  for (const double a : A) size = std::max(size, std::abs(a));
  if (std::abs(Det(A)) > kSingular * size * size * size) return Inverse(A);
  const Vec3 row[3] = {{A[0], A[1], A[2]}, {A[3], A[4], A[5]}, {A[6], A[7], A[8]}};
  Vec3 axis{};
  for (int r = 0; r < 3; r++) {
    const Vec3 normal = Cross(row[r], row[(r + 1) % 3]);
    if (Dot(normal, normal) > Dot(axis, axis)) axis = normal;
  }
  const double length = Norm(axis);
  if (!(length > kSingular * size * size)) return {};
  axis = (1 / length) * axis;
  Mat3 filled = A;
  for (int e = 0; e < 9; e++) filled[e] += size * axis[e / 3] * axis[e % 3];
  if (std::abs(Det(filled)) < kSingular * size * size * size) return {};
  Mat3 inverse = Inverse(filled);
  for (int e = 0; e < 9; e++) inverse[e] -= axis[e / 3] * axis[e % 3] / size;
  return inverse;
}

// The lanes from `first` on that one call computes: V of the batch's eight.
template <typename V>
struct Half {
  const RegionBatch& batch;
  const RegionBatch::Moduli& moduli;
  int first;
  int size = batch.sizes[first / kLanes];  // m, of the largest in these lanes

  MJFRAMES_INLINE V Of(const double* array, size_t entry) const { return Load<V>(array + kWideLanes * entry + first); }
  MJFRAMES_INLINE void Put(const V& value, double* array, size_t entry) const {
    Store(value, array + kWideLanes * entry + first);
  }
};

// z_j = Rᵀ x_j centred, R, and S = Rᵀ F, for the regions' own gradients.
template <typename V>
MJFRAMES_INLINE void Unturn(const Half<V>& half, const Vec3* x, BatchScratch* scratch, V* R, V* S) {
  const RegionBatch& batch = half.batch;
  double* z = scratch->z.data();
  V mean[3] = {}, F[9] = {};
  for (int j = 0; j < half.size; j++) {
    const int32_t* point = batch.point.data() + kWideLanes * j + half.first;
    const V present = half.Of(batch.present.data(), j);
    for (int r = 0; r < 3; r++) {
      V at;
      for (int lane = 0; lane < kWidth<V>; lane++) at[lane] = x[point[lane]][r];
      for (int c = 0; c < 3; c++) F[3 * r + c] += at * half.Of(batch.gradient.data(), 3 * j + c);
      mean[r] += present * at;
      half.Put(at, z, 3 * j + r);
    }
  }
  FollowRotation(F, R);
  MulT3(R, F, S);
  // centred: positions far from the origin would cost digits, translations carry no energy
  for (V& m : mean) m *= Load<V>(batch.inverse_size + half.first);
  for (int j = 0; j < half.size; j++) {
    const V present = half.Of(batch.present.data(), j);
    V d[3];
    for (int r = 0; r < 3; r++) d[r] = present * (half.Of(z, 3 * j + r) - mean[r]);
    for (int r = 0; r < 3; r++) half.Put(R[r] * d[0] + R[3 + r] * d[1] + R[6 + r] * d[2], z, 3 * j + r);
  }
}

// least = min(least, λ_min(sym S)) in the lanes that count, of those below kAgreeing.
template <typename V>
MJFRAMES_INLINE void Lower(const V* S, const Mask<V>& counts, V* least) {
  const auto disagrees = counts && !EigenvaluesExceed(S, Fill<V>(kAgreeing));
  if (!Any<V>(disagrees)) return;
  for (int lane = 0; lane < kWidth<V>; lane++) {
    if (disagrees[lane]) (*least)[lane] = std::min((*least)[lane], SmallestEigenvalue(LaneOf(S, lane)));
  }
}

// θ of each region; z and S: for its own gradients.
template <typename V>
MJFRAMES_INLINE V Trust(const Half<V>& half, const double* z, const V* S) {
  const RegionBatch& batch = half.batch;
  V least = Fill<V>(kAgreeing), of_frame[9] = {};
  Lower(S, Load<V>(batch.falls_back + half.first) > 0.0, &least);
  for (int j = 0; j < half.size; j++) {
    for (int e = 0; e < 9; e++) of_frame[e] += half.Of(z, 3 * j + e / 3) * half.Of(batch.own.data(), 3 * j + e % 3);
    const auto ends = half.Of(batch.ends.data(), j) > 0.0;
    if (!Any<V>(ends)) continue;
    Lower(of_frame, ends, &least);
    for (V& s : of_frame) s = ends ? V{} : s;
  }
  return TrustOf(least);
}

// For regions with θ < 1: g = θ ḡ + (1 − θ) ĝ, and R, z and S of that; the others keep what they have.
template <typename V>
MJFRAMES_INLINE void FallBack(const Half<V>& half, const V& theta, BatchScratch* scratch, V* R, V* S) {
  const RegionBatch& batch = half.batch;
  double* z = scratch->z.data();
  V F[9] = {};  // seen from R, as z is
  for (int j = 0; j < half.size; j++) {
    for (int c = 0; c < 3; c++) {
      const V g =
          theta * half.Of(batch.gradient.data(), 3 * j + c) + (1.0 - theta) * half.Of(batch.fallback.data(), 3 * j + c);
      for (int r = 0; r < 3; r++) F[3 * r + c] += half.Of(z, 3 * j + r) * g;
      half.Put(g, scratch->gradient.data(), 3 * j + c);
    }
  }
  V turn[9], turned[9], stretch[9];
  for (int e = 0; e < 9; e++) turn[e] = Fill<V>(kIdentity[e]);
  FollowRotation(F, turn);
  MulT3(turn, F, stretch);
  Mul3(R, turn, turned);
  const auto changes = theta < 1.0;
  for (int e = 0; e < 9; e++) {
    R[e] = changes ? turned[e] : R[e];
    S[e] = changes ? stretch[e] : S[e];
    turn[e] = changes ? turn[e] : Fill<V>(kIdentity[e]);
  }
  for (int j = 0; j < half.size; j++) {
    V at[3];
    for (int r = 0; r < 3; r++) at[r] = half.Of(z, 3 * j + r);
    for (int r = 0; r < 3; r++) half.Put(turn[r] * at[0] + turn[3 + r] * at[1] + turn[6 + r] * at[2], z, 3 * j + r);
  }
}

// λ of each region.
template <typename V>
MJFRAMES_INLINE V SoftTwist(const V* S, const V& theta) {
  const V soft = theta * kSoftTwist + (1.0 - theta) * kSoftTwistApart;
  const V trace = S[0] + S[4] + S[8];
  V H[9], lambda = {};
  for (int e = 0; e < 9; e++) H[e] = e % 4 == 0 ? trace - S[e] : -S[e];
  const auto firm = EigenvaluesExceed(H, soft);
  if (All<V>(firm)) return lambda;
  for (int lane = 0; lane < kWidth<V>; lane++) {
    if (!firm[lane]) lambda[lane] = std::max(0.0, soft[lane] - SmallestEigenvalue(LaneOf(H, lane))) / soft[lane];
  }
  return lambda;
}

// Adds λ N (z_j − c) to h over the points that show how the shape turns, N = (Σ_j (z_j − c)(z_j − c)ᵀ)⁻¹ and c their
// mean: gradients of the shape as it is now.
template <typename V>
MJFRAMES_INLINE void AddShapeGradient(const Half<V>& half, const V& lambda, BatchScratch* scratch) {
  const RegionBatch& batch = half.batch;
  const double* z = scratch->z.data();
  V count = {}, mean[3] = {}, moment[9] = {}, N[9];
  for (int j = 0; j < half.size; j++) {
    const V shows = half.Of(batch.shows.data(), j);
    count += shows;
    for (int r = 0; r < 3; r++) mean[r] += shows * half.Of(z, 3 * j + r);
  }
  for (V& m : mean) m /= count;
  for (int j = 0; j < half.size; j++) {
    const V shows = half.Of(batch.shows.data(), j);
    V d[3];
    for (int r = 0; r < 3; r++) d[r] = half.Of(z, 3 * j + r) - mean[r];
    for (int e = 0; e < 9; e++) moment[e] += shows * d[e / 3] * d[e % 3];
  }
  const V floor = kFlatShape * (moment[0] + moment[4] + moment[8]) + kTinyShape;
  for (int e = 0; e < 9; e += 4) moment[e] += floor;
  const V determinant = Adjugate(moment, N);
  for (int j = 0; j < half.size; j++) {
    const V weight = half.Of(batch.shows.data(), j) * lambda / determinant;
    V d[3];
    for (int r = 0; r < 3; r++) d[r] = half.Of(z, 3 * j + r) - mean[r];
    for (int r = 0; r < 3; r++) {
      const V h = N[3 * r] * d[0] + N[3 * r + 1] * d[1] + N[3 * r + 2] * d[2];
      half.Put(half.Of(scratch->h.data(), 3 * j + r) + weight * h, scratch->h.data(), 3 * j + r);
    }
  }
}

// h_j = g_j, the gradients that R is made of, and what λ adds, and (A Z)⁻¹, A Z = Σ_j (h_j·z_j) I − z_j h_jᵀ.
template <typename V>
MJFRAMES_INLINE void Constrain(const Half<V>& half, const double* g, const V& theta, const V* S, BatchScratch* scratch,
                               V* inverse) {
  const double* z = scratch->z.data();
  for (int e = 0; e < 3 * half.size; e++) half.Put(half.Of(g, e), scratch->h.data(), e);
  const V lambda = SoftTwist(S, theta);
  if (Any<V>(lambda > 0.0)) AddShapeGradient(half, lambda, scratch);
  V AZ[9] = {};
  for (int j = 0; j < half.size; j++) {
    V zj[3], h[3];
    for (int r = 0; r < 3; r++) {
      zj[r] = half.Of(z, 3 * j + r);
      h[r] = half.Of(scratch->h.data(), 3 * j + r);
    }
    const V hz = h[0] * zj[0] + h[1] * zj[1] + h[2] * zj[2];
    for (int e = 0; e < 9; e++) AZ[e] -= zj[e / 3] * h[e % 3];
    for (int r = 0; r < 3; r++) AZ[4 * r] += hz;
  }
  const V determinant = Adjugate(AZ, inverse);
  V size = Abs(AZ[0]);
  for (int e = 1; e < 9; e++) size = size > Abs(AZ[e]) ? size : Abs(AZ[e]);
  const auto regular = Abs(determinant) > kSingular * size * size * size;
  const V factor = 1.0 / determinant;
  for (int e = 0; e < 9; e++) inverse[e] *= factor;
  for (int lane = 0; lane < kWidth<V>; lane++) {
    if (regular[lane]) continue;  // points on a line can turn about it unseen
    const Mat3 one = PseudoInverse(LaneOf(AZ, lane));
    for (int e = 0; e < 9; e++) inverse[e][lane] = one[e];
  }
}

// y, z of a point, and what K's block and its transpose do to [y | Z], Z's columns being e_c × z.
template <typename V>
struct Columns {
  V y[3], z[3];

  MJFRAMES_INLINE Columns(const Half<V>& half, const double* all, int j) {
    for (int r = 0; r < 3; r++) {
      z[r] = half.Of(all, 3 * j + r);
      y[r] = z[r] - half.Of(half.batch.rest.data(), 3 * j + r);
    }
  }
};

// add(3 c + r, Σ_s K_rs [y | Z]_sc); row, column: strides of r and s in K.
template <int kRow, int kColumn, typename V, typename Add>
MJFRAMES_INLINE void AddProduct(const V* K, const Columns<V>& of, const Add& add) {
  for (int r = 0; r < 3; r++) {
    const V k0 = K[kRow * r], k1 = K[kRow * r + kColumn], k2 = K[kRow * r + 2 * kColumn];
    add(r, k0 * of.y[0] + k1 * of.y[1] + k2 * of.y[2]);
    add(3 + r, k2 * of.z[1] - k1 * of.z[2]);
    add(6 + r, k0 * of.z[2] - k2 * of.z[0]);
    add(9 + r, k1 * of.z[0] - k0 * of.z[1]);
  }
}

// product = K_e [y | Z]
template <typename V>
MJFRAMES_INLINE void Multiply(const Half<V>& half, BatchScratch* scratch) {
  const double* stiffness = half.moduli.stiffness.data();
  double* product = scratch->product.data();
  for (int j = 0, block = 0; j < half.size; j++, block++) {
    const Columns<V> of_j(half, scratch->z.data(), j);
    V sum[12] = {}, K[9];
    const auto add = [&](int c, const V& value) MJFRAMES_KERNEL { sum[c] += value; };
    for (int k = 0; k < j; k++, block++) {
      for (int e = 0; e < 9; e++) K[e] = half.Of(stiffness, 9 * static_cast<size_t>(block) + e);
      AddProduct<3, 1>(K, Columns<V>(half, scratch->z.data(), k), add);
      AddProduct<1, 3>(K, of_j, [&](int c, const V& value) MJFRAMES_KERNEL {
        half.Put(half.Of(product, 12 * k + c) + value, product, 12 * k + c);
      });
    }
    for (int e = 0; e < 9; e++) K[e] = half.Of(stiffness, 9 * static_cast<size_t>(block) + e);
    AddProduct<3, 1>(K, of_j, add);
    MJFRAMES_UNROLL
    for (int c = 0; c < 12; c++) half.Put(sum[c], product, 12 * j + c);
  }
}

// Adds the cells' V_q E_qᵀ [P_q | H_q E_q Z] to the product, the first column alone unless `curved`.
template <typename V>
MJFRAMES_INLINE void AddCells(const Half<V>& half, bool curved, BatchScratch* scratch) {
  const RegionBatch& batch = half.batch;
  double* product = scratch->product.data();
  for (int q = 0; q < batch.cells; q++) {
    const size_t first = 27 * static_cast<size_t>(q) * batch.size;
    const double* slope = batch.slope.data() + kWideLanes * first;
    V F[9], turned[27] = {}, load[36];  // E Z, and P and H E Z side by side
    for (int e = 0; e < 9; e++) F[e] = Fill<V>(kIdentity[e]);
    for (int j = 0; j < half.size; j++) {
      const Columns<V> of(half, scratch->z.data(), j);
      for (int e = 0; e < 9; e++) {
        V E[3], cross[3];
        for (int s = 0; s < 3; s++) E[s] = half.Of(slope, 27 * static_cast<size_t>(j) + 3 * e + s);
        F[e] += E[0] * of.y[0] + E[1] * of.y[1] + E[2] * of.y[2];
        Cross3(of.z, E, cross);  // its component c is E·(e_c × z)
        for (int c = 0; c < 3; c++) turned[3 * e + c] += cross[c];
      }
    }
    const Invariants<V> is = InvariantsOf(F);
    const Slopes<V> of = SlopesOf(batch.law, half.moduli.material.data() + kWideLanes * q + half.first, is);
    const V volume = half.Of(batch.volume.data(), q);
    V P[9];
    FirstPiola(F, is, of, P);
    for (int e = 0; e < 9; e++) load[4 * e] = volume * P[e];
    if (curved) {
      V H[81];
      ProjectedHessian(F, of, H);
      for (V& h : H) h *= volume;
      for (int e = 0; e < 9; e++) {
        for (int c = 0; c < 3; c++) {
          V sum = H[9 * e] * turned[c];
          for (int n = 1; n < 9; n++) sum += H[9 * e + n] * turned[3 * n + c];
          load[4 * e + 1 + c] = sum;
        }
      }
      for (int j = 0; j < half.size; j++) {
        V E[27];
        for (int e = 0; e < 27; e++) E[e] = half.Of(slope, 27 * static_cast<size_t>(j) + e);
        for (int n = 0; n < 9; n++) {
          for (int s = 0; s < 3; s++) {
            V sum = H[9 * n] * E[s];
            for (int e = 1; e < 9; e++) sum += H[9 * n + e] * E[3 * e + s];
            half.Put(sum, scratch->curved.data(), first + 27 * static_cast<size_t>(j) + 3 * n + s);
          }
        }
      }
    }
    for (int j = 0; j < half.size; j++) {
      for (int c = 0; c < (curved ? 4 : 1); c++) {
        for (int s = 0; s < 3; s++) {
          V sum = half.Of(product, 12 * j + 3 * c + s);
          for (int e = 0; e < 9; e++) sum += half.Of(slope, 27 * static_cast<size_t>(j) + 3 * e + s) * load[4 * e + c];
          half.Put(sum, product, 12 * j + 3 * c + s);
        }
      }
    }
  }
}

template <typename V>
MJFRAMES_INLINE void AddForce(const Half<V>& half, const V* R, const V* inverse, const BatchScratch& scratch,
                              Vec3* force) {
  const double* product = scratch.product.data();
  V torque[3] = {}, s[3];
  for (int j = 0; j < half.size; j++) {
    V z[3], w[3], moment[3];
    for (int r = 0; r < 3; r++) {
      z[r] = half.Of(scratch.z.data(), 3 * j + r);
      w[r] = half.Of(product, 12 * j + r);
    }
    Cross3(z, w, moment);
    for (int r = 0; r < 3; r++) torque[r] += moment[r];
  }
  for (int r = 0; r < 3; r++) s[r] = inverse[r] * torque[0] + inverse[3 + r] * torque[1] + inverse[6 + r] * torque[2];
  for (int j = 0; j < half.size; j++) {
    V h[3], w[3];
    for (int r = 0; r < 3; r++) h[r] = half.Of(scratch.h.data(), 3 * j + r);
    Cross3(h, s, w);
    for (int r = 0; r < 3; r++) w[r] += half.Of(product, 12 * j + r);
    const int32_t* point = half.batch.point.data() + kWideLanes * j + half.first;
    for (int r = 0; r < 3; r++) {
      const V f = R[3 * r] * w[0] + R[3 * r + 1] * w[1] + R[3 * r + 2] * w[2];
      for (int lane = 0; lane < kWidth<V>; lane++) force[point[lane]][r] -= f[lane];
    }
  }
}

// G_j
template <typename V>
MJFRAMES_INLINE void Correct(const Half<V>& half, const V* inverse, BatchScratch* scratch) {
  const double* product = scratch->product.data();
  V ZU[9] = {};  // Zᵀ U
  for (int j = 0; j < half.size; j++) {
    V z[3], u[3], moment[3];
    for (int r = 0; r < 3; r++) z[r] = half.Of(scratch->z.data(), 3 * j + r);
    for (int c = 0; c < 3; c++) {
      for (int r = 0; r < 3; r++) u[r] = half.Of(product, 12 * j + 3 * (1 + c) + r);
      Cross3(z, u, moment);
      for (int r = 0; r < 3; r++) ZU[3 * r + c] += moment[r];
    }
  }
  for (int j = 0; j < half.size; j++) {
    V h[3], N[9], correction[9], left[9], G[9];
    for (int r = 0; r < 3; r++) h[r] = half.Of(scratch->h.data(), 3 * j + r);
    for (int r = 0; r < 9; r += 3) Cross3(inverse + r, h, N + r);  // a row times [h]×
    MulT3(N, ZU, correction);
    for (int e = 0; e < 9; e++) left[e] = half.Of(product, 12 * j + 3 + 3 * (e % 3) + e / 3) - 0.5 * correction[e];
    Mul3(left, inverse, G);
    for (int e = 0; e < 9; e++) half.Put(G[e], scratch->g.data(), 9 * j + e);
  }
}

// Adds V_q E_qjᵀ H_q E_qk to a block of H.
template <typename V>
MJFRAMES_INLINE void AddCell(const Half<V>& half, int q, int j, int k, const BatchScratch& scratch, V* block) {
  const size_t first = static_cast<size_t>(q) * half.batch.size;
  for (int n = 0; n < 9; n++) {
    V curved[3];
    for (int s = 0; s < 3; s++) curved[s] = half.Of(scratch.curved.data(), 27 * (first + k) + 3 * n + s);
    for (int r = 0; r < 3; r++) {
      const V slope = half.Of(half.batch.slope.data(), 27 * (first + j) + 3 * n + r);
      for (int s = 0; s < 3; s++) block[3 * r + s] += slope * curved[s];
    }
  }
}

// (2 − θ) R (K_jk − G_j [h_k]× − ([h_j]×)ᵀ G_kᵀ) Rᵀ of all blocks
template <typename V>
MJFRAMES_INLINE void AddStiffness(const Half<V>& half, const V* R, const V& theta, const BatchScratch& scratch,
                                  double* stiffness, double* enlarged) {
  V scaled[9];
  for (int e = 0; e < 9; e++) scaled[e] = (2.0 - theta) * R[e];
  const V enlargement = Load<V>(half.batch.enlargement + half.first);
  const int32_t* pair = half.batch.pair.data() + half.first;
  size_t entry = 0;
  for (int j = 0; j < half.size; j++) {
    V Gj[9], hj[3];
    for (int e = 0; e < 9; e++) Gj[e] = half.Of(scratch.g.data(), 9 * j + e);
    for (int r = 0; r < 3; r++) hj[r] = half.Of(scratch.h.data(), 3 * j + r);
    for (int k = 0; k <= j; k++, entry += 9, pair += kWideLanes) {
      V block[9], left[9], Gk[9], hk[3];
      for (int e = 0; e < 9; e++) Gk[e] = half.Of(scratch.g.data(), 9 * k + e);
      for (int r = 0; r < 3; r++) hk[r] = half.Of(scratch.h.data(), 3 * k + r);
      for (int r = 0; r < 3; r++) {
        const int t = (r + 1) % 3, u = (r + 2) % 3;
        for (int s = 0; s < 3; s++) {
          const int v = (s + 1) % 3, w = (s + 2) % 3;
          block[3 * r + s] = half.Of(half.moduli.stiffness.data(), entry + 3 * r + s) -
                             (Gj[3 * r + v] * hk[w] - Gj[3 * r + w] * hk[v]) -
                             (Gk[3 * s + t] * hj[u] - Gk[3 * s + u] * hj[t]);
        }
      }
      for (int q = 0; q < half.batch.cells; q++) AddCell(half, q, j, k, scratch, block);
      Mul3(scaled, block, left);
      for (int e = 0; e < 9; e++) {
        const V* row = left + e / 3 * 3;
        const V* axis = R + e % 3 * 3;
        block[e] = row[0] * axis[0] + row[1] * axis[1] + row[2] * axis[2];
      }
      Scatter(block, pair, stiffness);
      if (!enlarged) continue;
      for (V& b : block) b *= enlargement;
      Scatter(block, pair, enlarged);
    }
  }
}

template <typename V>
MJFRAMES_INLINE void AddBatchOf(const RegionBatch& batch, const RegionBatch::Moduli& moduli, const Vec3* x,
                                BatchScratch* scratch, Vec3* force, double* stiffness, double* enlarged) {
  for (int first = 0; first < kWideLanes; first += kWidth<V>) {
    const Half<V> half = {batch, moduli, first};
    if (batch.pair[first] < 0) break;  // the last regions do not fill all lanes
    V R[9], S[9], inverse[9];
    for (int e = 0; e < 9; e++) R[e] = half.Of(scratch->rotation, e);
    Unturn(half, x, scratch, R, S);
    for (int e = 0; e < 9; e++) half.Put(R[e], scratch->rotation, e);
    const double* gradient = batch.gradient.data();
    V theta = Fill<V>(1);
    if (!batch.fallback.empty()) {
      theta = Trust(half, scratch->z.data(), S);
      if (Any<V>(theta < 1.0)) {
        FallBack(half, theta, scratch, R, S);
        gradient = scratch->gradient.data();
      }
    }
    Constrain(half, gradient, theta, S, scratch, inverse);
    Multiply(half, scratch);
    if (batch.cells) AddCells(half, stiffness != nullptr, scratch);
    AddForce(half, R, inverse, *scratch, force);
    if (!stiffness) continue;
    Correct(half, inverse, scratch);
    AddStiffness(half, R, theta, *scratch, stiffness, enlarged);
  }
}

void AddBatch(const RegionBatch& batch, const RegionBatch::Moduli& moduli, const Vec3* x, BatchScratch* scratch,
              Vec3* force, double* stiffness, double* enlarged) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL { AddBatchOf<V>(batch, moduli, x, scratch, force, stiffness, enlarged); });
}

}  // namespace

void AddBatches(const std::vector<RegionBatch>& batches, const RegionBatch::Moduli* moduli, const Vec3* x,
                BatchScratch* scratch, Vec3* force, double* stiffness, double* enlarged) {
  if (batches.empty()) return;
  // a body turns as a whole: one region shows the others where to start
  const RegionBatch& first = batches.front();
  Mat3 F{};
  for (int j = 0; j < first.size; j++) {
    for (int e = 0; e < 9; e++) {
      F[e] += x[first.point[kWideLanes * j]][e / 3] * first.gradient[kWideLanes * (3 * j + e % 3)];
    }
  }
  const Mat3 R = ClosestRotation(F, kIdentity);
  for (int e = 0; e < 9; e++) std::fill_n(scratch->rotation + kWideLanes * e, kWideLanes, R[e]);
  for (size_t b = 0; b < batches.size(); b++) {
    AddBatch(batches[b], moduli ? moduli[b] : batches[b].moduli, x, scratch, force, stiffness, enlarged);
  }
}

}  // namespace mjframes
