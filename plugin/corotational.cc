#include "corotational.h"

#include <algorithm>
#include <cmath>

#include "lanes.h"
#include "multiversion.h"
#include "rotation.h"

namespace mjframes {
namespace {

// Below this smallest eigenvalue of H the rotation is ill determined (flattened or inverted region) and a
// rotation fitted to the shape takes over, weighted by λ = (kSoftTwist − h_min) / kSoftTwist; at rest h_min = 2.
constexpr double kSoftTwist = 0.1;  // [-]

// product = K rhs for four right-hand sides at once; K symmetric, its rows and all columns padded to `padded`.
MJFRAMES_MULTIVERSION
void MultiplyFour(const double* __restrict K, const double* __restrict rhs, double* __restrict product, int n,
                  int padded) {
  for (int j = 0; j < padded; j += kLanes) {
    Lanes sum[4] = {Fill(0), Fill(0), Fill(0), Fill(0)};
    for (int i = 0; i < n; i++) {
      const Lanes k = Load(K + static_cast<size_t>(i) * padded + j);
      for (int c = 0; c < 4; c++) sum[c] += k * rhs[c * padded + i];
    }
    for (int c = 0; c < 4; c++) Store(sum[c], product + c * padded + j);
  }
}

// One row of blocks: out += R (K_jk − V_j N_k − N_jᵀ V_kᵀ) Rᵀ for k = 0 … stride − 1, of which those after j are void.
MJFRAMES_MULTIVERSION
void ProjectRow(const double* __restrict K, const double* __restrict N, const double* __restrict V,
                const double* __restrict Nj, const double* __restrict Vj, const double* __restrict R,
                double* __restrict out, int stride, int padded) {
  for (int k = 0; k < stride; k += kLanes) {
    Lanes b[9];
    for (int r = 0; r < 3; r++) {
      for (int s = 0; s < 3; s++) {
        Lanes sum = Load(K + (3 * r + s) * stride + k);
        for (int t = 0; t < 3; t++) {
          sum -=
              Vj[3 * r + t] * Load(N + (3 * t + s) * padded + k) + Nj[3 * t + r] * Load(V + (3 * s + t) * padded + k);
        }
        b[3 * r + s] = sum;
      }
    }
    for (int r = 0; r < 3; r++) {
      Lanes c[3];
      for (int s = 0; s < 3; s++) c[s] = R[3 * r] * b[s] + R[3 * r + 1] * b[3 + s] + R[3 * r + 2] * b[6 + s];
      for (int s = 0; s < 3; s++) {
        double* target = out + (3 * r + s) * stride + k;
        Store(Load(target) + (c[0] * R[3 * s] + c[1] * R[3 * s + 1] + c[2] * R[3 * s + 2]), target);
      }
    }
  }
}

// [-] of A Z. Points whose places are rounded to 1e-6 of the region's size lie on a line to 1e-12.
constexpr double kSingular = 1e-8;

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

int Padded(int m) { return BlockStride(m - 1); }

// To the pairs of points, from the layout of Region::blocks.
void AddBlocks(const Region& region, const double* blocks, double* stiffness, double* held) {
  const int32_t* pair = region.pair.data();
  for (int j = 0; j < region.size(); j++) {
    const int stride = BlockStride(j);
    const double* row = blocks + BlockOffset(j);
    for (int k = 0; k <= j; k++) {
      const size_t target = 9 * static_cast<size_t>(*pair++);
      for (int e = 0; e < 9; e++) stiffness[target + e] += row[e * stride + k];
      if (!held) continue;
      for (int e = 0; e < 9; e++) held[target + e] += region.enlargement * row[e * stride + k];
    }
  }
}

}  // namespace

int BlockOffset(int j) {
  // rows come in groups of kLanes with the same stride
  const int group = j / kLanes, rest = j % kLanes;
  return 9 * (kLanes * kLanes * group * (group + 1) / 2 + rest * BlockStride(j));
}

RegionScratch::RegionScratch(int max_points)
    : rhs(4 * PadToLanes(3 * max_points)),
      product(4 * PadToLanes(3 * max_points)),
      z(max_points),
      h(max_points),
      n(9 * Padded(std::max(1, max_points))),
      v(9 * Padded(std::max(1, max_points))),
      blocks(BlockOffset(max_points)) {}

Mat3 RegionRotation(const Region& region, const Vec3* x, const Mat3& guess) {
  Mat3 F{};
  for (int j = 0; j < region.size(); j++) {
    const Vec3& xj = x[region.point[j]];
    const Vec3& g = region.gradient[j];
    for (int r = 0; r < 3; r++) {
      for (int c = 0; c < 3; c++) F[3 * r + c] += xj[r] * g[c];
    }
  }
  return ClosestRotation(F, guess);
}

double RegionEnergy(const Region& region, const Vec3* x, const Mat3& R, RegionScratch* scratch) {
  const int m = region.size();
  Vec3 mean{};
  for (int j = 0; j < m; j++) mean = mean + (1.0 / m) * x[region.point[j]];
  double* y = scratch->rhs.data();
  for (int j = 0; j < m; j++) {
    const Vec3 strain = MulT(R, x[region.point[j]] - mean) - region.rest[j];
    std::copy(strain.begin(), strain.end(), y + 3 * j);
  }
  double energy = 0;
  for (int row = 0; row < 3 * m; row++) {
    const double* stiffness = region.stiffness.data() + static_cast<size_t>(row) * PadToLanes(3 * m);
    for (int column = 0; column < 3 * m; column++) energy += 0.5 * y[row] * stiffness[column] * y[column];
  }
  return energy;
}

void AddRegion(const Region& region, const Vec3* x, const Mat3& R, RegionScratch* scratch, Vec3* force,
               double* stiffness, double* held) {
  const int m = region.size();
  const int n = PadToLanes(3 * m);

  // z = Rᵀ x centred: positions far from the origin would cost digits, translations carry no energy
  Vec3 mean{};
  for (int j = 0; j < m; j++) mean = mean + x[region.point[j]];
  mean = (1.0 / m) * mean;
  Vec3* z = scratch->z.data();
  Mat3 S{};
  for (int j = 0; j < m; j++) {
    z[j] = MulT(R, x[region.point[j]] - mean);
    for (int r = 0; r < 3; r++) {
      for (int c = 0; c < 3; c++) S[3 * r + c] += z[j][r] * region.gradient[j][c];
    }
  }
  S[1] = S[3] = 0.5 * (S[1] + S[3]);
  S[2] = S[6] = 0.5 * (S[2] + S[6]);
  S[5] = S[7] = 0.5 * (S[5] + S[7]);
  const double lambda = TwistExceeds(S, kSoftTwist) ? 0 : std::max(0.0, kSoftTwist - SmallestTwist(S)) / kSoftTwist;

  // A_j = [h_j]×, h_j = ḡ_j + 2 λ z_j / Σ|x̄|²;   A Z = Σ_j (h_j·z_j) I − z_j h_jᵀ
  Vec3* h = scratch->h.data();
  Mat3 AZ{};
  for (int j = 0; j < m; j++) {
    h[j] = region.gradient[j] + (2 * lambda * region.inverse_extent) * z[j];
    const double hz = Dot(h[j], z[j]);
    for (int r = 0; r < 3; r++) {
      AZ[4 * r] += hz;
      for (int c = 0; c < 3; c++) AZ[3 * r + c] -= z[j][r] * h[j][c];
    }
  }
  const Mat3 inverse = PseudoInverse(AZ);  // points on a line can turn about it unseen

  // columns: y, and Z: (Z a)_j = a × z_j
  double* rhs = scratch->rhs.data();
  double* product = scratch->product.data();
  for (int j = 0; j < m; j++) {
    for (int r = 0; r < 3; r++) rhs[3 * j + r] = z[j][r] - region.rest[j][r];
    const Mat3 Zj = Skew(-1.0 * z[j]);
    for (int c = 0; c < 3; c++) {
      for (int r = 0; r < 3; r++) rhs[(1 + c) * n + 3 * j + r] = Zj[3 * r + c];
    }
  }
  MultiplyFour(region.stiffness.data(), rhs, product, 3 * m, n);

  // f_j = −R (w_j + h_j × s), w = K_e y, s = (A Z)⁻ᵀ Zᵀ w
  Vec3 torque{};
  for (int j = 0; j < m; j++) {
    torque = torque + Cross(z[j], {product[3 * j], product[3 * j + 1], product[3 * j + 2]});
  }
  const Vec3 s = MulT(inverse, torque);
  for (int j = 0; j < m; j++) {
    const Vec3 w = {product[3 * j], product[3 * j + 1], product[3 * j + 2]};
    force[region.point[j]] = force[region.point[j]] - Mul(R, w + Cross(h[j], s));
  }
  if (!stiffness) return;

  // N_j = (A Z)⁻¹ [h_j]×,  U = K_e Z,  V_j = U_j − ½ N_jᵀ (Zᵀ U):   Pᵀ K_e P = K_e − V N − (V N)ᵀ
  Mat3 ZU{};
  for (int j = 0; j < m; j++) {
    for (int c = 0; c < 3; c++) {
      const double* u = product + (1 + c) * n + 3 * j;
      const Vec3 column = Cross(z[j], {u[0], u[1], u[2]});
      for (int r = 0; r < 3; r++) ZU[3 * r + c] += column[r];
    }
  }
  const int padded = Padded(m);
  double* N = scratch->n.data();
  double* V = scratch->v.data();
  for (int j = 0; j < m; j++) {
    const Mat3 Nj = Mul(inverse, Skew(h[j]));
    const Mat3 correction = Mul(Transpose(Nj), ZU);
    for (int r = 0; r < 3; r++) {
      for (int c = 0; c < 3; c++) {
        N[(3 * r + c) * padded + j] = Nj[3 * r + c];
        V[(3 * r + c) * padded + j] = product[(1 + c) * n + 3 * j + r] - 0.5 * correction[3 * r + c];
      }
    }
  }
  double* blocks = scratch->blocks.data();
  if (region.starts) std::fill_n(blocks, BlockOffset(m), 0.0);
  for (int j = 0; j < m; j++) {
    double Nj[9], Vj[9];
    for (int e = 0; e < 9; e++) {
      Nj[e] = N[e * padded + j];
      Vj[e] = V[e * padded + j];
    }
    const int at = BlockOffset(j);
    ProjectRow(region.blocks.data() + at, N, V, Nj, Vj, R.data(), blocks + at, BlockStride(j), padded);
  }
  if (region.ends) AddBlocks(region, blocks, stiffness, held);
}

}  // namespace mjframes
