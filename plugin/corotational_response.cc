#include <algorithm>
#include <cmath>
#include <optional>

#include "constants.h"
#include "corotational.h"
#include "hessian.h"
#include "pressed_regions.h"
#include "region_lanes.h"
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

// z_j = Rᵀ x_j centred, R, the rotation closest to F, and S = RᵀF.
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

// `start` and `moment`, and of the energy as a function of Δ (turn.h) A and b.
template <typename V>
MJFRAMES_INLINE void Multiply(const Half<V>& half, BatchScratch* scratch, V* A, V* b) {
  const double* stiffness = half.moduli.stiffness.data();
  for (int e = 0; e < 81; e++) A[e] = V{};
  for (int e = 0; e < 9; e++) b[e] = V{};
  for (int j = 0; j < half.size; j++) {
    V w[3] = {}, moment[27] = {};
    for (int k = 0; k < half.size; k++) {
      V z[3], y[3], K[9];
      half.Block(stiffness, j, k, K);
      for (int s = 0; s < 3; s++) {
        z[s] = half.Of(scratch->z.data(), 3 * k + s);
        y[s] = z[s] - half.Of(half.batch.rest.data(), 3 * k + s);
      }
      for (int e = 0; e < 9; e++) {
        w[e / 3] += K[e] * y[e % 3];
        for (int s = 0; s < 3; s++) moment[3 * e + s] += K[e] * z[s];
      }
    }
    for (int r = 0; r < 3; r++) {
      const V z = half.Of(scratch->z.data(), 3 * j + r);
      for (int a = 0; a < 3; a++) {
        b[3 * r + a] += z * w[a];
        for (int n = 0; n < 9; n++) A[9 * (3 * r + a) + 3 * (n % 3) + n / 3] += z * moment[9 * a + n];
      }
    }
    for (int r = 0; r < 3; r++) half.Put(w[r], scratch->start.data(), 3 * j + r);
    for (int e = 0; e < 27; e++) half.Put(moment[e], scratch->moment.data(), 27 * j + e);
  }
}

// Newton's method for the Δ of least energy, cells left out, from Δ = 0; the lanes where it ended.
template <typename V>
MJFRAMES_INLINE Mask<V> FollowTurn(const V* A, const V* b, V* delta) {
  V size = A[0] + A[40] + A[80];
  auto good = size > 0.0, close = size < 0.0;
  for (int e = 0; e < 9; e++) delta[e] = V{};
  for (int step = 0; step < kRotationSteps && !All<V>(close || !good); step++) {
    V D[9], slope[9], M[9], columns[27], H[9], adjugate[9];
    for (int n = 0; n < 9; n++) {
      D[n] = delta[n] + kIdentity[n];
      slope[n] = b[n];
      for (int k = 0; k < 9; k++) slope[n] += A[9 * n + k] * delta[k];
    }
    MulT3(D, slope, M);
    for (int c = 0; c < 3; c++) {  // D [e_c]×
      const int u = (c + 1) % 3, v = (c + 2) % 3;
      for (int r = 0; r < 3; r++) {
        columns[9 * c + 3 * r + c] = V{};
        columns[9 * c + 3 * r + u] = D[3 * r + v];
        columns[9 * c + 3 * r + v] = -D[3 * r + u];
      }
    }
    const V trace = M[0] + M[4] + M[8];
    for (int c = 0; c < 3; c++) {
      V product[9];
      for (int n = 0; n < 9; n++) {
        product[n] = V{};
        for (int k = 0; k < 9; k++) product[n] += A[9 * n + k] * columns[9 * c + k];
      }
      for (int d = 0; d < 3; d++) {
        V sum = 0.5 * (M[3 * d + c] + M[3 * c + d]) - (c == d ? trace : V{});
        for (int n = 0; n < 9; n++) sum += columns[9 * d + n] * product[n];
        H[3 * d + c] = sum;
      }
    }
    const V determinant = Adjugate(H, adjugate);
    const V floor = kMinTwist * size, minor2 = adjugate[8];
    const V moment[3] = {M[5] - M[7], M[6] - M[2], M[1] - M[3]};
    V q[3];  // half Newton's correction
    for (int r = 0; r < 3; r++) {
      q[r] = 0.5 * (adjugate[3 * r] * moment[0] + adjugate[3 * r + 1] * moment[1] + adjugate[3 * r + 2] * moment[2]) /
             determinant;
    }
    const V square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2];
    good = good && H[0] > floor && minor2 > floor * H[0] && determinant > floor * minor2 &&
           4.0 * square < kTrustRadius * kTrustRadius;
    V turn[9], more[9];
    CayleyTurn(q, turn);
    Mul3(D, turn, more);
    for (int e = 0; e < 9; e++) delta[e] += more[e];
    close = 4.0 * square < kRotated * kRotated;
  }
  const auto found = good && close;
  for (int e = 0; e < 9; e++) delta[e] = found ? delta[e] : V{};
  return found;
}

// The cells of one lane as functions of Δ.
template <typename V>
void CellsOf(const Half<V>& half, int lane, const double* z, Turn* turn) {
  const RegionBatch& batch = half.batch;
  const int at = half.first + lane;
  turn->law = batch.law;
  turn->groups = (batch.cells + kLanes - 1) / kLanes;
  for (int q = 0; q < turn->groups * kLanes; q++) {
    TurnCells& cells = turn->cells[q / kLanes];
    const int n = q % kLanes, real = std::min(q, batch.cells - 1);
    cells.volume[n] = q < batch.cells ? batch.volume[kWideLanes * q + at] : 0;
    cells.material[n] = half.moduli.material[kWideLanes * real + at];
    double F[9], slope[81] = {};
    for (int e = 0; e < 9; e++) F[e] = kIdentity[e];
    for (int j = 0; j < half.size && q < batch.cells; j++) {
      const double* E = batch.slope.data() + kWideLanes * 27 * (static_cast<size_t>(q) * batch.size + j) + at;
      for (int e = 0; e < 9; e++) {
        for (int a = 0; a < 3; a++) {
          const double entry = E[kWideLanes * (3 * e + a)], zja = z[kWideLanes * (3 * j + a) + at];
          F[e] += entry * (zja - batch.rest[kWideLanes * (3 * j + a) + at]);
          for (int r = 0; r < 3; r++) slope[9 * e + 3 * r + a] += entry * z[kWideLanes * (3 * j + r) + at];
        }
      }
    }
    for (int e = 0; e < 9; e++) cells.F[e][n] = F[e];
    for (int e = 0; e < 81; e++) cells.slope[e][n] = slope[e];
  }
}

// What a lane has of pressed.h as a function of Δ; after Multiply.
template <typename V>
void PressedOf(const Half<V>& half, int lane, const BatchScratch& scratch, TurnPressed* pressed) {
  const int at = half.first + lane;
  const double* C = half.moduli.compliance.data() + at;
  pressed->firmness = half.moduli.pressed[at];
  double moment[90] = {};  // Σ_j x̄_j w_jᵀ and, for each entry of Δ, Σ_j x̄_j (∂w_j/∂Δ)ᵀ, w = K y
  for (int j = 0; j < half.size; j++) {
    for (int e = 0; e < 9; e++) {
      const int r = e / 3, a = e % 3;
      const double rest = half.batch.rest[kWideLanes * (3 * j + r) + at];
      moment[e] += rest * scratch.start[kWideLanes * (3 * j + a) + at];
      for (int n = 0; n < 9; n++) {
        moment[9 * (1 + n) + e] += rest * scratch.moment[kWideLanes * (27 * j + 9 * a + 3 * (n % 3) + n / 3) + at];
      }
    }
  }
  std::fill_n(pressed->strain, kStrains, 0.0);
  std::fill_n(pressed->slope, 9 * kStrains, 0.0);
  for (int s = 0; s < kStrains; s++) {
    for (int t = 0; t < kStrains; t++) {
      const double c = C[kWideLanes * (kStrains * s + t)];
      pressed->strain[s] += c * AlongStrain(moment, t);
      for (int n = 0; n < 9; n++) pressed->slope[9 * s + n] += c * AlongStrain(moment + 9 * (1 + n), t);
    }
  }
}

// Searches for the Δ of one lane.
template <typename V>
void Search(const Half<V>& half, int lane, const V* A, const V* b, const V* S, V* delta, BatchScratch* scratch) {
  Turn& turn = scratch->turn;
  for (int e = 0; e < 81; e++) turn.curvature[e] = A[e][lane];
  for (int e = 0; e < 9; e++) turn.slope[e] = b[e][lane];
  turn.S = LaneOf(S, lane);
  turn.solid = half.batch.solid[half.first + lane] > 0;
  CellsOf(half, lane, scratch->z.data(), &turn);
  PressedOf(half, lane, *scratch, &turn.pressed);
  const Mat3 found = LeastTurn(turn);
  for (int e = 0; e < 9; e++) delta[e][lane] = found[e];
}

// z after the turn D = 1 + Δ, and the product without cells.
template <typename V>
MJFRAMES_INLINE void TurnAll(const Half<V>& half, const V* delta, const V* D, BatchScratch* scratch) {
  double *z = scratch->z.data(), *product = scratch->product.data();
  for (int j = 0; j < half.size; j++) {
    V at[3], moment[27], w[3];
    for (int r = 0; r < 3; r++) at[r] = half.Of(z, 3 * j + r);
    for (int r = 0; r < 3; r++) half.Put(D[r] * at[0] + D[3 + r] * at[1] + D[6 + r] * at[2], z, 3 * j + r);
    for (int e = 0; e < 27; e++) moment[e] = half.Of(scratch->moment.data(), 27 * j + e);
    for (int a = 0; a < 3; a++) {
      w[a] = half.Of(scratch->start.data(), 3 * j + a);
      for (int n = 0; n < 9; n++) w[a] += moment[9 * a + n] * delta[3 * (n % 3) + n / 3];
      half.Put(w[a], product, 12 * j + a);
      V turned[9];  // Σ_k K_jk,ab z_k,c after the turn
      Mul3(moment + 9 * a, D, turned);
      for (int c = 0; c < 3; c++) {
        const int u = (c + 1) % 3, v = (c + 2) % 3;
        half.Put(turned[3 * v + u] - turned[3 * u + v], product, 12 * j + 3 * (1 + c) + a);
      }
    }
  }
}

// y and z of a point.
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

// Adds E_qᵀ times each column of `load` (9 × columns, `stride` apart) to those of the product.
template <typename V>
MJFRAMES_INLINE void AddLoads(const Half<V>& half, int q, const V* load, int stride, int columns,
                              BatchScratch* scratch) {
  const size_t first = static_cast<size_t>(q) * half.batch.size;
  for (int j = 0; j < half.size; j++) {
    for (int c = 0; c < columns; c++) {
      for (int s = 0; s < 3; s++) {
        V sum = half.Of(scratch->product.data(), 12 * j + 3 * c + s);
        for (int e = 0; e < 9; e++) {
          sum += half.Of(half.batch.slope.data(), 27 * (first + j) + 3 * e + s) * load[stride * e + c];
        }
        half.Put(sum, scratch->product.data(), 12 * j + 3 * c + s);
      }
    }
  }
}

// Adds the cells' V_q E_qᵀ [P_q | H_q E_q Z] to the product, the first column alone unless `curved`; then V_q P_q and
// V_q H_q E_q are kept, too.
template <typename V>
MJFRAMES_INLINE void AddCells(const Half<V>& half, bool curved, BatchScratch* scratch) {
  const RegionBatch& batch = half.batch;
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
      for (int e = 0; e < 9; e++) half.Put(load[4 * e], scratch->stress.data(), 9 * q + e);
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
    AddLoads(half, q, load, 4, curved ? 4 : 1, scratch);
  }
}

// ½ Σ_j y_j·w_j of each region, w the product's first column without cells.
template <typename V>
MJFRAMES_INLINE V Quadratic(const Half<V>& half, const BatchScratch& scratch) {
  V energy = {};
  for (int j = 0; j < half.size; j++) {
    const Columns<V> of(half, scratch.z.data(), j);
    for (int r = 0; r < 3; r++) energy += 0.5 * of.y[r] * half.Of(scratch.product.data(), 12 * j + r);
  }
  return energy;
}

// Σ_q V_q ψ of one lane.
template <typename V>
double CellEnergy(const Half<V>& half, int lane, const BatchScratch& scratch) {
  const RegionBatch& batch = half.batch;
  const int at = half.first + lane;
  double energy = 0;
  for (int q = 0; q < batch.cells; q++) {
    Mat3 F = kIdentity;
    for (int j = 0; j < half.size; j++) {
      const double* E = batch.slope.data() + kWideLanes * 27 * (static_cast<size_t>(q) * batch.size + j) + at;
      for (int e = 0; e < 27; e++) {
        const size_t entry = kWideLanes * (3 * static_cast<size_t>(j) + e % 3) + at;
        F[e / 3] += E[kWideLanes * e] * (scratch.z[entry] - batch.rest[entry]);
      }
    }
    const Invariants<double> is = InvariantsOf(F.data());
    energy += batch.volume[kWideLanes * q + at] *
              EnergyDensity(batch.law, half.moduli.material[kWideLanes * q + at], is.i1, is.i2, is.j);
  }
  return energy;
}

// Zᵀ U
template <typename V>
MJFRAMES_INLINE void Twist(const Half<V>& half, const BatchScratch& scratch, V* twist) {
  V ZU[9] = {};
  for (int j = 0; j < half.size; j++) {
    V z[3], u[3], moment[3];
    for (int r = 0; r < 3; r++) z[r] = half.Of(scratch.z.data(), 3 * j + r);
    for (int c = 0; c < 3; c++) {
      for (int r = 0; r < 3; r++) u[r] = half.Of(scratch.product.data(), 12 * j + 3 * (1 + c) + r);
      Cross3(z, u, moment);
      for (int r = 0; r < 3; r++) ZU[3 * r + c] += moment[r];
    }
  }
  for (int e = 0; e < 9; e++) twist[e] = 0.5 * (ZU[e] + ZU[3 * (e % 3) + e / 3]);
}

// (Zᵀ U)⁻¹; where points on a line can turn about it unseen, its pseudo-inverse.
template <typename V>
MJFRAMES_INLINE void InvertTwist(const V* twist, V* inverse) {
  const V determinant = Adjugate(twist, inverse);
  V size = Abs(twist[0]);
  for (int e = 1; e < 9; e++) size = size > Abs(twist[e]) ? size : Abs(twist[e]);
  const auto regular = Abs(determinant) > kSingular * size * size * size;
  const V factor = 1.0 / determinant;
  for (int e = 0; e < 9; e++) inverse[e] *= factor;
  for (int lane = 0; lane < kWidth<V>; lane++) {
    if (regular[lane]) continue;
    const Mat3 one = PseudoInverse(LaneOf(twist, lane));
    for (int e = 0; e < 9; e++) inverse[e][lane] = one[e];
  }
}

// force −= R w, of a point
template <typename V>
MJFRAMES_INLINE void SubtractTurned(const Half<V>& half, int j, const V* R, const V* w, Vec3* force) {
  const int32_t* point = half.batch.point.data() + kWideLanes * j + half.first;
  for (int r = 0; r < 3; r++) {
    const V f = R[3 * r] * w[0] + R[3 * r + 1] * w[1] + R[3 * r + 2] * w[2];
    for (int lane = 0; lane < kWidth<V>; lane++) force[point[lane]][r] -= f[lane];
  }
}

// The torque that the search for R left, which is rounding, is taken from the force as a turn would.
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
  for (int r = 0; r < 3; r++)
    s[r] = inverse[3 * r] * torque[0] + inverse[3 * r + 1] * torque[1] + inverse[3 * r + 2] * torque[2];
  for (int j = 0; j < half.size; j++) {
    V w[3];
    for (int r = 0; r < 3; r++) {
      w[r] = half.Of(product, 12 * j + r);
      for (int c = 0; c < 3; c++) w[r] -= half.Of(product, 12 * j + 3 * (1 + c) + r) * s[c];
    }
    SubtractTurned(half, j, R, w, force);
  }
}

// How the region turns as its points move, Ω_j, and Y_j = U_j − ½ Ω_jᵀ Zᵀ U, of which Pᵀ H P = H − Yⱼ Ω_k − Ω_jᵀ Y_kᵀ.
// twist: Zᵀ U.  inverse: its inverse, which stands for that of the curvature in how R turns where this is unsure.
// Returns by how much the stiffness of a step is firmer.
template <typename V>
MJFRAMES_INLINE V Follow(const Half<V>& half, const V* twist, const V* inverse, BatchScratch* scratch) {
  const double* product = scratch->product.data();
  V M[9] = {}, C[9], adjugate[9], turns[9];
  for (int j = 0; j < half.size; j++) {
    for (int e = 0; e < 9; e++) M[e] += half.Of(scratch->z.data(), 3 * j + e / 3) * half.Of(product, 12 * j + e % 3);
  }
  const V trace = M[0] + M[4] + M[8];
  for (int e = 0; e < 9; e++) {
    C[e] = twist[e] + 0.5 * (M[e] + M[3 * (e % 3) + e / 3]) - (e % 4 == 0 ? trace : V{});
  }
  V above[9], below[9];
  for (int e = 0; e < 9; e++) {
    above[e] = kSureTurn * C[e] - twist[e];
    below[e] = kSureTurn * twist[e] - C[e];
  }
  const auto sure = EigenvaluesExceed(above, V{}) && EigenvaluesExceed(below, V{});
  const V determinant = Adjugate(C, adjugate);
  const auto shown = Load<V>(half.batch.solid + half.first) > 0.0;
  const auto known = sure && shown && Load<V>(half.batch.celled + half.first) < 0.5;
  const V factor = 1.0 / determinant, turned = known ? Fill<V>(1) : V{};
  for (int e = 0; e < 9; e++) turns[e] = known ? adjugate[e] * factor : inverse[e];
  for (int j = 0; j < half.size; j++) {
    V w[3], U[9], B[9], omega[9];  // B_j = U_j − [e_c × w_j], entry 3r + c
    for (int r = 0; r < 3; r++) w[r] = turned * half.Of(product, 12 * j + r);
    for (int e = 0; e < 9; e++) B[e] = U[e] = half.Of(product, 12 * j + 3 * (1 + e % 3) + e / 3);
    for (int c = 0; c < 3; c++) {
      const int u = (c + 1) % 3, v = (c + 2) % 3;
      B[3 * u + c] += w[v];
      B[3 * v + c] -= w[u];
    }
    for (int e = 0; e < 9; e++) {
      const V *row = turns + e / 3 * 3, *column = B + e % 3 * 3;
      omega[e] = row[0] * column[0] + row[1] * column[1] + row[2] * column[2];
    }
    for (int e = 0; e < 9; e++) {
      const int r = e / 3, c = e % 3;
      half.Put(omega[e], scratch->follow.data(), 18 * j + e);
      half.Put(U[e] - 0.5 * (omega[r] * twist[c] + omega[3 + r] * twist[3 + c] + omega[6 + r] * twist[6 + c]),
               scratch->follow.data(), 18 * j + 9 + e);
    }
  }
  return sure || !shown ? Fill<V>(1) : Fill<V>(kUnsureStep);
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

// R Pᵀ H P Rᵀ of all blocks, `firmer` times. pressed: null where no region is.
template <typename V>
MJFRAMES_INLINE void AddStiffness(const Half<V>& half, const V* R, const V& firmer, const PressedRegions<V>* pressed,
                                  const BatchScratch& scratch, const Wanted& wanted) {
  V scaled[9];
  for (int e = 0; e < 9; e++) scaled[e] = firmer * R[e];
  const V enlargement = Load<V>(half.batch.enlargement + half.first);
  const int32_t* pair = half.batch.pair.data() + half.first;
  size_t entry = 0;
  for (int j = 0; j < half.size; j++) {
    V of_j[18], T[3 * kStrains];
    for (int e = 0; e < 18; e++) of_j[e] = half.Of(scratch.follow.data(), 18 * j + e);
    if (pressed) PressedRow(half, *pressed, scratch, j, T);
    for (int k = 0; k <= j; k++, entry += 9, pair += kWideLanes) {
      V block[9], left[9];
      for (int e = 0; e < 9; e++) block[e] = half.Of(half.moduli.stiffness.data(), entry + e);
      for (int c = 0; c < 3; c++) {
        for (int s = 0; s < 3; s++) {
          const V omega = half.Of(scratch.follow.data(), 18 * k + 3 * c + s);
          const V y = half.Of(scratch.follow.data(), 18 * k + 9 + 3 * s + c);
          for (int r = 0; r < 3; r++) block[3 * r + s] -= of_j[9 + 3 * r + c] * omega + of_j[3 * c + r] * y;
        }
      }
      for (int q = 0; q < half.batch.cells; q++) AddCell(half, q, j, k, scratch, block);
      if (pressed) AddPressedBlock(half, T, scratch, k, block);
      Mul3(scaled, block, left);
      for (int e = 0; e < 9; e++) {
        const V* row = left + e / 3 * 3;
        const V* axis = R + e % 3 * 3;
        block[e] = row[0] * axis[0] + row[1] * axis[1] + row[2] * axis[2];
      }
      Scatter(block, pair, wanted.stiffness);
      if (!wanted.enlarged) continue;
      for (V& b : block) b *= enlargement;
      Scatter(block, pair, wanted.enlarged);
    }
  }
}

// The rotation R of least energy, z for it and the product without cells and what is pressed; whether anything is.
template <typename V>
MJFRAMES_INLINE bool Rotate(const Half<V>& half, int regions, const Vec3* x, BatchScratch* scratch, V* R) {
  V closest[9], S[9], A[81], b[9], delta[9], D[9], turned[9];
  for (int e = 0; e < 9; e++) closest[e] = half.Of(scratch->rotation, e);
  Unturn(half, x, scratch, closest, S);
  for (int e = 0; e < 9; e++) half.Put(closest[e], scratch->rotation, e);
  Multiply(half, scratch, A, b);
  const auto found = FollowTurn(A, b, delta);
  for (int e = 0; e < 9; e++) D[e] = delta[e] + kIdentity[e];
  MulT3(D, S, turned);
  const auto unfolded = Load<V>(half.batch.solid + half.first) > 0.0 && EigenvaluesExceed(turned, Fill<V>(kFolded));
  bool searched[kWidth<V>] = {};
  for (int lane = 0; lane < regions; lane++) {
    if (found[lane] && unfolded[lane] && !half.batch.cells) continue;
    Search(half, lane, A, b, S, delta, scratch);
    searched[lane] = true;
  }
  for (int e = 0; e < 9; e++) D[e] = delta[e] + kIdentity[e];
  Mul3(closest, D, R);
  TurnAll(half, delta, D, scratch);
  V strain[kStrains];
  StrainOf(half, scratch->product.data(), 12, strain);
  const Mask<V> pressed = ArePressed(half, strain);
  if (!Any<V>(pressed)) return false;
  MulT3(D, S, turned);
  Multiply(half, scratch, A, b);
  for (V& d : delta) d = V{};
  for (int lane = 0; lane < regions; lane++) {
    if (pressed[lane] && !searched[lane]) Search(half, lane, A, b, turned, delta, scratch);
  }
  for (int e = 0; e < 9; e++) D[e] = delta[e] + kIdentity[e];
  std::copy_n(R, 9, closest);
  Mul3(closest, D, R);
  TurnAll(half, delta, D, scratch);
  return true;
}

// Adds the cells' V_q E_qᵀ (P_q + H_q E_q (ẑ − z)) to the product's first column, with P_q and H_q that AddCells has
// found at the places z in `before`. A law at ẑ would bend thin plates: what its stress at a stretch differs from that
// is little there, but much to bending, and the stretch of a turn is to go.
template <typename V>
MJFRAMES_INLINE void AddCellsAhead(const Half<V>& half, BatchScratch* scratch) {
  for (int q = 0; q < half.batch.cells; q++) {
    const size_t first = 27 * static_cast<size_t>(q) * half.batch.size;
    V load[9];
    for (int e = 0; e < 9; e++) load[e] = half.Of(scratch->stress.data(), 9 * q + e);
    for (int j = 0; j < half.size; j++) {
      for (int s = 0; s < 3; s++) {
        const size_t entry = 3 * static_cast<size_t>(j) + s;
        const V moved = half.Of(scratch->z.data(), entry) - half.Of(scratch->before.data(), entry);
        for (int e = 0; e < 9; e++) {
          load[e] += half.Of(scratch->curved.data(), first + 27 * static_cast<size_t>(j) + 3 * e + s) * moved;
        }
      }
    }
    AddLoads(half, q, load, 1, 1, scratch);
  }
}

// force −= R Pᵀ ŵ, ŵ = ∂W/∂y at the points' places `ahead`, of cells from their tangent; after Follow, for the places
// where they are.
template <typename V>
MJFRAMES_INLINE void AddForceAhead(const Half<V>& half, int regions, const V* R, const Vec3* ahead,
                                   BatchScratch* scratch, Vec3* force) {
  V there[9], torque[3] = {};
  std::copy_n(scratch->z.begin(), 3 * kWideLanes * static_cast<size_t>(half.batch.size), scratch->before.begin());
  if (Rotate(half, regions, ahead, scratch, there)) {
    PressedRegions<V> pressed = FindPressed(half, *scratch);
    AddPressed(half, false, &pressed, scratch);
  }
  AddCellsAhead(half, scratch);
  for (int j = 0; j < half.size; j++) {
    V z[3], w[3], moment[3];
    for (int r = 0; r < 3; r++) {
      z[r] = half.Of(scratch->before.data(), 3 * j + r);
      w[r] = half.Of(scratch->product.data(), 12 * j + r);
    }
    Cross3(z, w, moment);
    for (int r = 0; r < 3; r++) torque[r] += moment[r];
  }
  for (int j = 0; j < half.size; j++) {
    V w[3];
    for (int r = 0; r < 3; r++) {
      w[r] = half.Of(scratch->product.data(), 12 * j + r);
      for (int c = 0; c < 3; c++) w[r] -= half.Of(scratch->follow.data(), 18 * j + 3 * c + r) * torque[c];
    }
    SubtractTurned(half, j, R, w, force);
  }
}

template <typename V>
MJFRAMES_INLINE void AddBatchOf(const RegionBatch& batch, const RegionBatch::Moduli& moduli, const Vec3* x,
                                BatchScratch* scratch, const Wanted& wanted) {
  for (int first = 0; first < kWideLanes; first += kWidth<V>) {
    const Half<V> half = {batch, moduli, first};
    const int regions = std::min(static_cast<int>(batch.region.size()) - first, kWidth<V>);
    if (regions <= 0) break;  // the last regions do not fill all lanes
    V R[9], twist[9], inverse[9];
    std::optional<PressedRegions<V>> pressed;
    if (Rotate(half, regions, x, scratch, R)) pressed = FindPressed(half, *scratch);
    V energy = {};
    if (wanted.energy) energy = Quadratic(half, *scratch);
    if (wanted.energy && pressed) energy += pressed->at.energy;
    for (int lane = 0; lane < regions; lane++) {
      if (wanted.energy) *wanted.energy += energy[lane] + CellEnergy(half, lane, *scratch);
      if (wanted.rotation) wanted.rotation[batch.region[first + lane]] = LaneOf(R, lane);
    }
    if (!wanted.force) continue;
    if (batch.cells) AddCells(half, wanted.stiffness || wanted.ahead, scratch);
    if (pressed) AddPressed(half, wanted.stiffness || wanted.ahead, &*pressed, scratch);
    Twist(half, *scratch, twist);
    InvertTwist(twist, inverse);
    if (!wanted.ahead) AddForce(half, R, inverse, *scratch, wanted.force);
    if (!wanted.stiffness && !wanted.ahead) continue;
    const V firmer = Follow(half, twist, inverse, scratch);
    if (wanted.stiffness) AddStiffness(half, R, firmer, pressed ? &*pressed : nullptr, *scratch, wanted);
    if (wanted.ahead) AddForceAhead(half, regions, R, wanted.ahead, scratch, wanted.force);
  }
}

void AddBatch(const RegionBatch& batch, const RegionBatch::Moduli& moduli, const Vec3* x, BatchScratch* scratch,
              const Wanted& wanted) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL { AddBatchOf<V>(batch, moduli, x, scratch, wanted); });
}

}  // namespace

void AddBatches(const std::vector<RegionBatch>& batches, const RegionBatch::Moduli* moduli, const Vec3* x,
                BatchScratch* scratch, const Wanted& wanted) {
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
    AddBatch(batches[b], moduli ? moduli[b] : batches[b].moduli, x, scratch, wanted);
  }
}

}  // namespace mjframes
