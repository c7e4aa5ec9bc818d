// Kinematics::StoreInertia: Jᵀ B J of all pairs of control points into d->M.
//
//   at movers (n, u ≤ n): S_nᵀ (Σ_jk X_jᵀ B_jk X_k) S_u,   j at and below n, k at and below u
//
// The blocks of the mover pairs are summed over subtrees, first by rows, from the leaves up, then by columns, along
// each path. What the points of one mover and of another add to a third pair above both is in the sums of both.
//
// Where a mover turns by δθ, its points x_j = c + r_j also move by δθ × (δθ × r_j)/2 against the gradients g = −f of
// the elastic energy:
//
//   δ²E = … + δθᵀ K_n δθ,   K_n = Σ_j ½ (r_j g_jᵀ + g_j r_jᵀ) − (r_j·g_j) I
//
// K_n enters the inertia with the magnitudes of its eigenvalues, as hessian.h does: without it large forces turned
// light frames by radians in a step. It damps nothing, unlike K: stressed bodies may spin as a whole. Bodies that have
// points on slides too go without: they return from any shape as they are, and with it some overshot.

#include <algorithm>
#include <cstddef>

#include "hessian.h"
#include "kinematics.h"
#include "simd.h"

namespace mjframes {
namespace {

// Σ += block, seen from the twists of the two movers.
void AddBlock(const Mat3& block, const Vec3& xj, const Vec3& xk, bool transposed, double* sum) {
  const Mat3 right = Mul(block, Skew(-1.0 * xk));  // X_k = [I, −[x_k]×]
  const Mat3 left = Skew(xj);
  const Mat3 quarter[4] = {block, right, Mul(left, block), Mul(left, right)};
  for (int row = 0; row < 6; row++) {
    for (int column = 0; column < 6; column++) {
      const double value = quarter[2 * (row / 3) + column / 3][3 * (row % 3) + column % 3];
      sum[transposed ? 6 * column + row : 6 * row + column] += value;
    }
  }
}

// Translations of all points strain nothing: their columns (and rows) are mass alone, to the last digit. Summed from
// blocks of K they would be its rounding errors, as large as M where h²K/m is 1e16.
void StripTranslation(const Moments& load, bool rows, double* total) {
  const Mat3 moment = Skew(load.moment);
  for (int r = 0; r < 6; r++) {
    for (int c = 0; c < 3; c++) {
      total[6 * r + c] = r < 3 ? (r == c ? load.weight : 0) : moment[3 * (r - 3) + c];
      if (rows) total[6 * c + r] = total[6 * r + c];
    }
  }
}

// Σ B of the mover pairs that slide, 9 a pair, and the mass at each mover into `weight`.
MJFRAMES_INLINE void SumPairs(const std::vector<PointPair>& pairs, const std::vector<ControlPoint>& points,
                              const double* stiffness, double scale, const double* mass, double* __restrict sums,
                              double* __restrict weight) {
  for (size_t i = 0; i < pairs.size(); i++) {
    const PointPair& pair = pairs[i];
    const int nj = points[pair.j].mover, nk = points[pair.k].mover;
    if (nj >= 0) weight[nj] += mass[i];
    if (nk >= 0 && pair.j != pair.k) weight[nk] += mass[i];
    if (pair.sum < 0) continue;
    const double* block = stiffness + 9 * i;
    double* sum = sums + 9 * static_cast<size_t>(pair.sum);
    const bool twice = pair.j != pair.k && nj == nk;
    if (!pair.flip) {
      for (int e = 0; e < 9; e++) sum[e] += scale * block[e];
    }
    if (pair.flip || twice) {
      for (int e = 0; e < 9; e++) sum[e] += scale * block[3 * (e % 3) + e / 3];
    }
    for (int r = 0; r < 3; r++) sum[4 * r] += twice ? 2 * mass[i] : mass[i];
  }
}

// By rows: a mover's own pair becomes the sum over its subtree's square.
MJFRAMES_INLINE void SumSubtrees(const std::vector<Mover>& movers, double* sums, double* weight) {
  for (size_t n = movers.size(); n-- > 1;) {
    const Mover& mover = movers[n];
    if (mover.parent < 0) continue;
    const Mover& parent = movers[mover.parent];
    weight[mover.parent] += weight[n];
    const double* __restrict row = sums + 9 * static_cast<size_t>(mover.pair);
    double* __restrict into = sums + 9 * static_cast<size_t>(parent.pair);
    for (int e = 0; e < 9 * parent.depth; e++) into[e] += row[e];
    const double* cross = row + 9 * parent.depth;
    const double* own = row + 9 * mover.depth;
    into += 9 * parent.depth;
    for (int e = 0; e < 9; e++) into[e] += own[e] + cross[e] + cross[3 * (e % 3) + e / 3];
  }
}

// Row a of the blocks of a path, up to the diagonal, to (or on top of) a row of d->M.
template <bool replaces>
void StoreRow(const double* block, int depth, int a, double rigid, double* M) {
  for (int upper = 0; upper <= depth; upper++, block += 9, M += 3) {
    for (int c = 0; c < (upper < depth ? 3 : a + 1); c++) M[c] = (replaces ? 0 : M[c]) + block[c];
    if (replaces) M[a] += rigid;
  }
}

// By columns: row[depth] becomes the sum from there on.
MJFRAMES_INLINE void SumPath(double* row, int depth) {
  Lanes front = Load(row + 9 * depth), back = Load(row + 9 * depth + 4);
  double last = row[9 * depth + 8];
  for (int upper = depth - 1; upper >= 0; upper--) {
    double* at = row + 9 * upper;
    Store(front += Load(at), at);
    Store(back += Load(at + 4), at + 4);
    at[8] = last += at[8];
  }
}

}  // namespace

void Kinematics::StiffenTurns(const std::vector<Vec3>& force, const mjData* d) {
  if (!stiffens_) return;
  std::fill(turn_.begin(), turn_.end(), Mat3{});
  for (size_t j = 0; j < points_.size(); j++) {
    const int n = points_[j].mover;
    if (n < 0) continue;
    const Vec3 r = x_[j] - PositionToLocal(d, ToVec3(d->xpos + 3 * movers_[n].body));
    const Vec3& f = force[j];
    const double along = Dot(r, f);
    for (int a = 0; a < 3; a++) {
      for (int b = 0; b < 3; b++) turn_[n][3 * a + b] += (a == b ? along : 0) - 0.5 * (r[a] * f[b] + r[b] * f[a]);
    }
  }
  constexpr Lanes kNoForce[3] = {};
  for (size_t first = 0; first < movers_.size(); first += kLanes) {  // as many movers at once
    const size_t count = std::min<size_t>(kLanes, movers_.size() - first);
    Lanes K[9] = {};
    for (size_t i = 0; i < count; i++) {
      for (int e = 0; e < 9; e++) K[e][i] = turn_[first + i][e];
    }
    ProjectBlock(kNoForce, Fill(1), K);
    for (size_t i = 0; i < count; i++) {
      for (int e = 0; e < 9; e++) turn_[first + i][e] = K[e][i];
    }
  }
}

void Kinematics::AddTurns(double stiffness_scale) {
  for (size_t n = 0; n < movers_.size(); n++) {
    double* sum = sum_.data() + 36 * static_cast<size_t>(movers_[n].pair + movers_[n].depth);
    for (int a = 0; a < 3; a++) {
      for (int b = 0; b < 3; b++) sum[6 * (3 + a) + 3 + b] += stiffness_scale * turn_[n][3 * a + b];
    }
  }
}

void Kinematics::StoreInertia(const double* stiffness, double stiffness_scale, const double* mass, const mjModel* m,
                              mjData* d) {
  turning_ ? StoreTurningInertia(stiffness, stiffness_scale, mass, d)
           : StoreSlideInertia(stiffness, stiffness_scale, mass, m, d);
}

void Kinematics::StoreSlideInertia(const double* stiffness, double stiffness_scale, const double* mass,
                                   const mjModel* m, mjData* d) {
  std::fill(sum_.begin(), sum_.end(), 0.0);
  std::fill(weight_.begin(), weight_.end(), 0.0);
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    SumPairs(pairs_, points_, stiffness, stiffness_scale, mass, sum_.data(), weight_.data());
    SumSubtrees(movers_, sum_.data(), weight_.data());
    for (const Mover& mover : movers_) SumPath(sum_.data() + 9 * static_cast<size_t>(mover.pair), mover.depth);
  });
  for (size_t n = 0; n < movers_.size(); n++) {
    const Mover& mover = movers_[n];
    double* row = sum_.data() + 9 * static_cast<size_t>(mover.pair);
    if (free_) {  // see StripTranslation
      for (int e = 0; e < 9; e++) row[e] = e % 4 == 0 ? weight_[n] : 0;
    }
    const double rigid = d->crb[10 * mover.body + 9];  // on the diagonals of its blocks
    const int* entry = entry_.data() + mover.entry;    // of a row of d->M, whose columns of one path are neighbours
    for (int a = 0; a < 3; entry += 3 * mover.depth + a + 1, a++) {
      double* M = d->M + *entry;
      if (replaces_) {
        StoreRow<true>(row + 3 * a, mover.depth, a, rigid, M);
        M[3 * mover.depth + a] += m->dof_armature[mover.dof + a];
      } else {
        StoreRow<false>(row + 3 * a, mover.depth, a, 0, M);
      }
    }
  }
}

// Row sums of the mass at and below each mover, and their moments.
void Kinematics::SumMass(const double* mass) {
  std::fill(load_.begin(), load_.end(), Moments{});
  const auto add = [this](int j, double m) {
    Moments& load = load_[points_[j].mover];
    load.weight += m;
    load.moment = load.moment + m * lever_[j];
  };
  for (size_t i = 0; i < pairs_.size(); i++) {
    add(pairs_[i].j, mass[i]);
    if (pairs_[i].j != pairs_[i].k) add(pairs_[i].k, mass[i]);
  }
  for (size_t n = movers_.size(); n-- > 1;) {
    Moments& into = load_[movers_[n].parent];
    into.weight += load_[n].weight;
    into.moment = into.moment + load_[n].moment;
  }
}

void Kinematics::StoreTurningInertia(const double* stiffness, double stiffness_scale, const double* mass, mjData* d) {
  constexpr int kSize = 36;
  std::fill(sum_.begin(), sum_.end(), 0.0);
  for (size_t i = 0; i < pairs_.size(); i++) {
    const PointPair& pair = pairs_[i];
    if (pair.sum < 0) continue;
    Mat3 block;
    for (int e = 0; e < 9; e++) block[e] = stiffness_scale * stiffness[9 * i + e];
    for (int r = 0; r < 3; r++) block[4 * r] += mass[i];
    double* sum = sum_.data() + kSize * static_cast<size_t>(pair.sum);
    AddBlock(block, lever_[pair.j], lever_[pair.k], pair.flip, sum);
    if (pair.j != pair.k && points_[pair.j].mover == points_[pair.k].mover) {
      AddBlock(block, lever_[pair.j], lever_[pair.k], true, sum);
    }
  }
  if (stiffens_) AddTurns(stiffness_scale);
  if (free_) SumMass(mass);
  // rows: over subtrees, from the leaves up; a mover's own pair becomes the sum over its subtree's square
  for (size_t n = movers_.size(); n-- > 1;) {
    const Mover& mover = movers_[n];
    if (mover.parent < 0) continue;
    const Mover& parent = movers_[mover.parent];
    const double* row = sum_.data() + kSize * static_cast<size_t>(mover.pair);
    double* into = sum_.data() + kSize * static_cast<size_t>(parent.pair);
    for (int e = 0; e < kSize * parent.depth; e++) into[e] += row[e];
    const double* cross = row + kSize * parent.depth;
    const double* own = row + kSize * mover.depth;
    double* parent_own = into + kSize * parent.depth;
    for (int e = 0; e < kSize; e++) parent_own[e] += own[e] + cross[e] + cross[6 * (e % 6) + e / 6];
  }
  // columns: along each path, from the mover up to the outermost one
  for (const Mover& mover : movers_) {
    double total[kSize] = {};
    const double* row = sum_.data() + kSize * static_cast<size_t>(mover.pair);
    int columns = 0;  // of the path above and of this mover
    for (int n = static_cast<int>(&mover - movers_.data()); n >= 0; n = movers_[n].parent) columns += movers_[n].dofs;
    const int above = columns - mover.dofs;
    int n = static_cast<int>(&mover - movers_.data()), first = above;
    for (int depth = mover.depth; depth >= 0; depth--, n = movers_[n].parent) {
      const Mover& upper = movers_[n];
      for (int e = 0; e < kSize; e++) total[e] += row[kSize * depth + e];
      if (free_ && depth == 0) StripTranslation(load_[&mover - movers_.data()], depth == mover.depth, total);
      const int* entry = entry_.data() + mover.entry + first;
      for (int a = 0; a < mover.dofs; a++) {
        const int count = depth == mover.depth ? a + 1 : upper.dofs;
        const double* Sa = twist_.data() + 6 * (mover.twist + a);
        double left[6] = {};
        for (int r = 0; r < 6; r++) {
          for (int c = 0; c < 6; c++) left[c] += Sa[r] * total[6 * r + c];
        }
        for (int b = 0; b < count; b++) {
          const double* Sb = twist_.data() + 6 * (upper.twist + b);
          double value = 0;
          for (int c = 0; c < 6; c++) value += left[c] * Sb[c];
          d->M[entry[b]] += value;
        }
        entry += above + a + 1;  // the next row of this mover
      }
      if (upper.parent >= 0) first -= movers_[upper.parent].dofs;
    }
  }
}

}  // namespace mjframes
