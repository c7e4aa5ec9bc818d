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

// z_j = Rᵀ x_j centred, and R, the rotation closest to F.
template <typename V>
MJFRAMES_INLINE void Unturn(const Half<V>& half, const Vec3* x, BatchScratch* scratch, V* R) {
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
      const size_t block = k <= j ? j * (j + 1) / 2 + k : k * (k + 1) / 2 + j;
      for (int e = 0; e < 9; e++) K[e] = half.Of(stiffness, 9 * block + (k <= j ? e : 3 * (e % 3) + e / 3));
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

// Newton's method for the Δ of least energy, frames and cells left out, from Δ = 0; the lanes where it ended.
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

// The lanes where no frame, nor the region itself, opposes it after the turn D, and one shows that.
template <typename V>
MJFRAMES_INLINE Mask<V> Agree(const Half<V>& half, const double* z, const V* D) {
  const RegionBatch& batch = half.batch;
  const V bound = Fill<V>(kOpposed);
  V S[9] = {}, of_frame[9] = {}, turned[9];
  for (int j = 0; j < half.size; j++) {
    for (int e = 0; e < 9; e++) S[e] += half.Of(z, 3 * j + e / 3) * half.Of(batch.gradient.data(), 3 * j + e % 3);
  }
  MulT3(D, S, turned);
  auto shown = Load<V>(batch.solid + half.first) > 0.0;
  auto agree = EigenvaluesExceed(turned, bound) || !shown;
  for (int j = 0; j < half.size && !batch.own.empty(); j++) {
    for (int e = 0; e < 9; e++) of_frame[e] += half.Of(z, 3 * j + e / 3) * half.Of(batch.own.data(), 3 * j + e % 3);
    const auto ends = half.Of(batch.ends.data(), j) > 0.0;
    if (!Any<V>(ends)) continue;
    MulT3(D, of_frame, turned);
    agree = agree && (!ends || EigenvaluesExceed(turned, bound));
    shown = shown || ends;
    for (V& s : of_frame) s = ends ? V{} : s;
  }
  return agree && shown;
}

// S of the region itself and of each of its frames, of one lane.
template <typename V>
int FramesOf(const Half<V>& half, int lane, const double* z, Mat3* frame) {
  const RegionBatch& batch = half.batch;
  const auto at = [&](const double* array, int entry) { return array[kWideLanes * entry + half.first + lane]; };
  int frames = batch.solid[half.first + lane] > 0;
  frame[0] = {};
  for (int j = 0; j < half.size && frames; j++) {
    for (int e = 0; e < 9; e++) frame[0][e] += at(z, 3 * j + e / 3) * at(batch.gradient.data(), 3 * j + e % 3);
  }
  if (batch.own.empty()) return frames;
  frame[frames] = {};
  for (int j = 0; j < half.size; j++) {
    for (int e = 0; e < 9; e++) frame[frames][e] += at(z, 3 * j + e / 3) * at(batch.own.data(), 3 * j + e % 3);
    if (at(batch.ends.data(), j) > 0) frame[++frames] = {};
  }
  return frames;
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

// Searches for the Δ of one lane; whether any of its frames opposes it there.
template <typename V>
bool Search(const Half<V>& half, int lane, bool everywhere, const V* A, const V* b, V* delta, BatchScratch* scratch) {
  Turn& turn = scratch->turn;
  for (int e = 0; e < 81; e++) turn.curvature[e] = A[e][lane];
  for (int e = 0; e < 9; e++) turn.slope[e] = b[e][lane];
  turn.firmness = half.moduli.firmness[half.first + lane];
  turn.frames = FramesOf(half, lane, scratch->z.data(), turn.frame.data());
  CellsOf(half, lane, scratch->z.data(), &turn);
  const Mat3 found = LeastTurn(turn, everywhere);
  Mat3 D = found;
  for (int e = 0; e < 9; e++) {
    delta[e][lane] = found[e];
    D[e] += kIdentity[e];
  }
  Opposition of;
  for (int p = 0; p < turn.frames; p++) {
    if (Opposes(Mul(Transpose(D), turn.frame[p]), turn.firmness, &of)) return true;
  }
  return false;
}

// Calls act(opposition, S, gradients, first point, one after the last) for all that oppose one lane's region after its
// turn.
template <typename V, typename Act>
void ForOpposed(const Half<V>& half, int lane, const BatchScratch& scratch, const Act& act) {
  const RegionBatch& batch = half.batch;
  const int at = half.first + lane;
  Opposition of;
  const auto look = [&](const std::vector<double>& gradient, int begin, int end) {
    Mat3 S{};
    for (int j = begin; j < end; j++) {
      for (int e = 0; e < 9; e++) {
        S[e] += scratch.z[kWideLanes * (3 * j + e / 3) + at] * gradient[kWideLanes * (3 * j + e % 3) + at];
      }
    }
    if (Opposes(S, half.moduli.firmness[at], &of)) act(of, S, gradient, begin, end);
  };
  if (batch.solid[at] > 0) look(batch.gradient, 0, half.size);
  for (int j = 0, begin = 0; j < half.size && !batch.own.empty(); j++) {
    if (!(batch.ends[kWideLanes * j + at] > 0)) continue;
    look(batch.own, begin, j + 1);
    begin = j + 1;
  }
}

// z after the turn D = 1 + Δ, and the product without cells and frames.
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

// Adds what opposing frames have of the product of one lane; returns their energy.
template <typename V>
double AddOpposed(const Half<V>& half, int lane, BatchScratch* scratch) {
  const int at = half.first + lane;
  double energy = 0;
  const auto add = [&](const Opposition& of, const Mat3& S, const std::vector<double>& gradient, int begin, int end) {
    energy += of.energy;
    const auto g = [&](int j) {
      Vec3 gj;
      for (int a = 0; a < 3; a++) gj[a] = gradient[kWideLanes * (3 * static_cast<size_t>(j) + a) + at];
      return gj;
    };
    Mat3 column[4] = {of.Slope()};
    for (int c = 0; c < 3; c++) {
      Vec3 axis{};
      axis[c] = 1;
      column[1 + c] = of.SlopeChange(Mul(Skew(axis), S));
    }
    for (int j = begin; j < end; j++) {
      const Vec3 gj = g(j);
      for (int c = 0; c < 4; c++) {
        const Vec3 added = Mul(column[c], gj);
        for (int r = 0; r < 3; r++) scratch->product[kWideLanes * (12 * j + 3 * c + r) + at] += added[r];
      }
    }
  };
  ForOpposed(half, lane, *scratch, add);
  return energy;
}

// ½ Σ_j y_j·w_j of each region, w the product's first column without cells and frames.
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

// (Zᵀ U)⁻¹; where points on a line can turn about it unseen, its pseudo-inverse.
template <typename V>
MJFRAMES_INLINE void InvertTwist(const Half<V>& half, const BatchScratch& scratch, V* inverse) {
  V ZU[9] = {}, H[9];
  for (int j = 0; j < half.size; j++) {
    V z[3], u[3], moment[3];
    for (int r = 0; r < 3; r++) z[r] = half.Of(scratch.z.data(), 3 * j + r);
    for (int c = 0; c < 3; c++) {
      for (int r = 0; r < 3; r++) u[r] = half.Of(scratch.product.data(), 12 * j + 3 * (1 + c) + r);
      Cross3(z, u, moment);
      for (int r = 0; r < 3; r++) ZU[3 * r + c] += moment[r];
    }
  }
  for (int e = 0; e < 9; e++) H[e] = 0.5 * (ZU[e] + ZU[3 * (e % 3) + e / 3]);
  const V determinant = Adjugate(H, inverse);
  V size = Abs(H[0]);
  for (int e = 1; e < 9; e++) size = size > Abs(H[e]) ? size : Abs(H[e]);
  const auto regular = Abs(determinant) > kSingular * size * size * size;
  const V factor = 1.0 / determinant;
  for (int e = 0; e < 9; e++) inverse[e] *= factor;
  for (int lane = 0; lane < kWidth<V>; lane++) {
    if (regular[lane]) continue;
    const Mat3 one = PseudoInverse(LaneOf(H, lane));
    for (int e = 0; e < 9; e++) inverse[e][lane] = one[e];
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
    const int32_t* point = half.batch.point.data() + kWideLanes * j + half.first;
    for (int r = 0; r < 3; r++) {
      const V f = R[3 * r] * w[0] + R[3 * r + 1] * w[1] + R[3 * r + 2] * w[2];
      for (int lane = 0; lane < kWidth<V>; lane++) force[point[lane]][r] -= f[lane];
    }
  }
}

// U (Zᵀ U)⁻¹
template <typename V>
MJFRAMES_INLINE void Correct(const Half<V>& half, const V* inverse, BatchScratch* scratch) {
  for (int j = 0; j < half.size; j++) {
    for (int r = 0; r < 3; r++) {
      V u[3];
      for (int c = 0; c < 3; c++) u[c] = half.Of(scratch->product.data(), 12 * j + 3 * (1 + c) + r);
      for (int c = 0; c < 3; c++) {
        half.Put(u[0] * inverse[c] + u[1] * inverse[3 + c] + u[2] * inverse[6 + c], scratch->g.data(),
                 9 * j + 3 * r + c);
      }
    }
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

// R (K_jk − U_j (Zᵀ U)⁻¹ U_kᵀ) Rᵀ of all blocks, `firmer` times
template <typename V>
MJFRAMES_INLINE void AddStiffness(const Half<V>& half, const V* R, const V& firmer, const BatchScratch& scratch,
                                  const Wanted& wanted) {
  V scaled[9];
  for (int e = 0; e < 9; e++) scaled[e] = firmer * R[e];
  const V enlargement = Load<V>(half.batch.enlargement + half.first);
  const int32_t* pair = half.batch.pair.data() + half.first;
  size_t entry = 0;
  for (int j = 0; j < half.size; j++) {
    V Gj[9];
    for (int e = 0; e < 9; e++) Gj[e] = half.Of(scratch.g.data(), 9 * j + e);
    for (int k = 0; k <= j; k++, entry += 9, pair += kWideLanes) {
      V block[9], left[9];
      for (int e = 0; e < 9; e++) block[e] = half.Of(half.moduli.stiffness.data(), entry + e);
      for (int c = 0; c < 3; c++) {
        for (int s = 0; s < 3; s++) {
          const V u = half.Of(scratch.product.data(), 12 * k + 3 * (1 + c) + s);
          for (int r = 0; r < 3; r++) block[3 * r + s] -= Gj[3 * r + c] * u;
        }
      }
      for (int q = 0; q < half.batch.cells; q++) AddCell(half, q, j, k, scratch, block);
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

// R K Rᵀ of the opposing frames of one lane, kOpposedStep times
template <typename V>
void AddOpposedStiffness(const Half<V>& half, int lane, const Mat3& R, const BatchScratch& scratch,
                         const Wanted& wanted) {
  const RegionBatch& batch = half.batch;
  const int at = half.first + lane;
  const auto add = [&](const Opposition& of, const Mat3&, const std::vector<double>& gradient, int begin, int end) {
    const Mat3 axes = Mul(R, of.axes);
    const auto along = [&](int j) {
      Vec3 g;
      for (int a = 0; a < 3; a++) g[a] = gradient[kWideLanes * (3 * static_cast<size_t>(j) + a) + at];
      return MulT(of.axes, g);
    };
    for (int j = begin; j < end; j++) {
      const Vec3 gj = along(j);
      for (int k = begin; k <= j; k++) {
        const int32_t pair = batch.pair[kWideLanes * (static_cast<size_t>(j) * (j + 1) / 2 + k) + at];
        if (pair < 0) continue;
        const Vec3 gk = along(k);
        Mat3 block;  // in V's axes
        for (int e = 0; e < 9; e++) block[e] = of.firmness[e] * gk[e / 3] * gj[e % 3];
        for (int e = 0; e < 9; e++) block[e - e % 3 + e / 3] += of.firmness[e] * gk[e % 3] * gj[e % 3];
        block = Mul(axes, Mul(block, Transpose(axes)));
        for (double& b : block) b *= 0.5 * kOpposedStep;
        for (int e = 0; e < 9; e++) {
          wanted.stiffness[9 * static_cast<size_t>(pair) + e] += block[e];
          if (wanted.enlarged) wanted.enlarged[9 * static_cast<size_t>(pair) + e] += batch.enlargement[at] * block[e];
        }
      }
    }
  };
  ForOpposed(half, lane, scratch, add);
}

template <typename V>
MJFRAMES_INLINE void AddBatchOf(const RegionBatch& batch, const RegionBatch::Moduli& moduli, const Vec3* x,
                                BatchScratch* scratch, const Wanted& wanted) {
  for (int first = 0; first < kWideLanes; first += kWidth<V>) {
    const Half<V> half = {batch, moduli, first};
    const int regions = std::min(static_cast<int>(batch.region.size()) - first, kWidth<V>);
    if (regions <= 0) break;  // the last regions do not fill all lanes
    V R[9], A[81], b[9], delta[9], D[9], turned[9], inverse[9];
    for (int e = 0; e < 9; e++) R[e] = half.Of(scratch->rotation, e);
    Unturn(half, x, scratch, R);
    for (int e = 0; e < 9; e++) half.Put(R[e], scratch->rotation, e);
    Multiply(half, scratch, A, b);
    const auto found = FollowTurn(A, b, delta);
    for (int e = 0; e < 9; e++) D[e] = delta[e] + kIdentity[e];
    const auto agree = Agree(half, scratch->z.data(), D);
    bool opposed[kWidth<V>] = {};
    for (int lane = 0; lane < regions; lane++) {
      if (found[lane] && agree[lane] && !batch.cells) continue;
      opposed[lane] = Search(half, lane, !agree[lane], A, b, delta, scratch);
    }
    for (int e = 0; e < 9; e++) D[e] = delta[e] + kIdentity[e];
    Mul3(R, D, turned);
    TurnAll(half, delta, D, scratch);
    V energy = {};
    if (wanted.energy) energy = Quadratic(half, *scratch);
    for (int lane = 0; lane < regions; lane++) {
      const double of_frames = opposed[lane] ? AddOpposed(half, lane, scratch) : 0;
      if (wanted.energy) *wanted.energy += energy[lane] + of_frames + CellEnergy(half, lane, *scratch);
      if (wanted.rotation) wanted.rotation[batch.region[first + lane]] = LaneOf(turned, lane);
    }
    if (!wanted.force) continue;
    if (batch.cells) AddCells(half, wanted.stiffness != nullptr, scratch);
    InvertTwist(half, *scratch, inverse);
    AddForce(half, turned, inverse, *scratch, wanted.force);
    if (!wanted.stiffness) continue;
    Correct(half, inverse, scratch);
    V firmer = Fill<V>(1);
    for (int lane = 0; lane < regions; lane++) firmer[lane] = opposed[lane] ? kOpposedStep : 1;
    AddStiffness(half, turned, firmer, *scratch, wanted);
    for (int lane = 0; lane < regions; lane++) {
      if (opposed[lane]) AddOpposedStiffness(half, lane, LaneOf(turned, lane), *scratch, wanted);
    }
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
