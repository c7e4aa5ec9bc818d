#include "turn.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "constants.h"
#include "hessian.h"
#include "rotation.h"

namespace mjframes {
namespace {

// E, its slope in D (row by row) and, for turns D exp([a]×), its slope and curvature in a at a = 0.
struct Landscape {
  double energy;
  Vec3 slope;
  Mat3 curvature;
};

// 1 + Δ
Mat3 PlusOne(Mat3 delta) {
  for (int e = 0; e < 9; e += 4) delta[e] += 1;
  return delta;
}

// Columns D [e_c]×, entry 3r + a of column c at 9 c + 3 r + a.
void Turning(const Mat3& D, double* column) {
  for (int c = 0; c < 3; c++) {
    const int u = (c + 1) % 3, v = (c + 2) % 3;
    for (int r = 0; r < 3; r++) {  // [e_c]× has 1 at (v, u) and −1 at (u, v)
      column[9 * c + 3 * r + c] = 0;
      column[9 * c + 3 * r + u] = D[3 * r + v];
      column[9 * c + 3 * r + v] = -D[3 * r + u];
    }
  }
}

void AddCells(const Turn& turn, int group, const Mat3& delta, const double* column, bool curved, Mat3* slope,
              Landscape* of) {
  const TurnCells& cells = turn.cells[group];
  Lanes F[9], P[9];
  for (int e = 0; e < 9; e++) {
    F[e] = cells.F[e];
    for (int n = 0; n < 9; n++) F[e] += cells.slope[9 * e + n] * delta[n];
  }
  const Invariants<Lanes> is = InvariantsOf(F);
  for (int lane = 0; lane < kLanes; lane++) {
    of->energy +=
        cells.volume[lane] * EnergyDensity(turn.law, cells.material[lane], is.i1[lane], is.i2[lane], is.j[lane]);
  }
  if (!curved) return;
  const Slopes<Lanes> slopes = SlopesOf(turn.law, cells.material, is);
  FirstPiola(F, is, slopes, P);
  Lanes H[81], turned[27], product[27];
  ProjectedHessian(F, slopes, H);
  for (int n = 0; n < 9; n++) {
    Lanes sum = {};
    for (int e = 0; e < 9; e++) sum += cells.slope[9 * e + n] * P[e];
    for (int lane = 0; lane < kLanes; lane++) (*slope)[n] += cells.volume[lane] * sum[lane];
  }
  for (int e = 0; e < 9; e++) {
    for (int c = 0; c < 3; c++) {
      turned[3 * e + c] = Lanes{};
      for (int n = 0; n < 9; n++) turned[3 * e + c] += cells.slope[9 * e + n] * column[9 * c + n];
    }
  }
  for (int e = 0; e < 9; e++) {
    for (int c = 0; c < 3; c++) {
      product[3 * e + c] = Lanes{};
      for (int n = 0; n < 9; n++) product[3 * e + c] += H[9 * e + n] * turned[3 * n + c];
    }
  }
  for (int c = 0; c < 3; c++) {
    for (int d = 0; d < 3; d++) {
      Lanes sum = {};
      for (int e = 0; e < 9; e++) sum += turned[3 * e + c] * product[3 * e + d];
      for (int lane = 0; lane < kLanes; lane++) of->curvature[3 * c + d] += cells.volume[lane] * sum[lane];
    }
  }
}

Landscape LandscapeAt(const Turn& turn, const Mat3& delta, bool curved) {
  Landscape of = {};
  const Mat3 D = PlusOne(delta);
  double column[27];
  Mat3 slope;
  Turning(D, column);
  for (int n = 0; n < 9; n++) {
    double change = 0;
    for (int k = 0; k < 9; k++) change += turn.curvature[9 * n + k] * delta[k];
    of.energy += delta[n] * (0.5 * change + turn.slope[n]);
    slope[n] = change + turn.slope[n];
  }
  for (int c = 0; c < 3 && curved; c++) {
    double product[9];
    for (int n = 0; n < 9; n++) {
      product[n] = 0;
      for (int k = 0; k < 9; k++) product[n] += turn.curvature[9 * n + k] * column[9 * c + k];
    }
    for (int d = 0; d < 3; d++) {
      for (int n = 0; n < 9; n++) of.curvature[3 * d + c] += column[9 * d + n] * product[n];
    }
  }
  for (int p = 0; p < turn.frames; p++) {
    Opposition opposed;
    const Mat3 S = Mul(Transpose(D), turn.frame[p]);
    if (!Opposes(S, turn.firmness, &opposed)) continue;
    of.energy += opposed.energy;
    if (!curved) continue;
    const Mat3 by_D = Mul(turn.frame[p], opposed.slope);
    for (int e = 0; e < 9; e++) slope[e] += by_D[e];
    double change[27];  // of S: −[e_c]× S
    for (int c = 0; c < 3; c++) {
      const int u = (c + 1) % 3, v = (c + 2) % 3;
      for (int b = 0; b < 3; b++) {
        change[9 * c + 3 * c + b] = 0;
        change[9 * c + 3 * u + b] = S[3 * v + b];
        change[9 * c + 3 * v + b] = -S[3 * u + b];
      }
    }
    for (int c = 0; c < 3; c++) {
      for (int n = 0; n < 9; n++) {
        double product = 0;
        for (int k = 0; k < 9; k++) product += opposed.curvature[9 * n + k] * change[9 * c + k];
        for (int d = 0; d < 3; d++) of.curvature[3 * d + c] += change[9 * d + n] * product;
      }
    }
  }
  for (int g = 0; g < turn.groups; g++) AddCells(turn, g, delta, column, curved, &slope, &of);
  if (!curved) return of;
  const Mat3 M = Mul(Transpose(D), slope);
  of.slope = {M[7] - M[5], M[2] - M[6], M[3] - M[1]};
  const double trace = M[0] + M[4] + M[8];
  for (int e = 0; e < 9; e++) of.curvature[e] += 0.5 * (M[e] + M[3 * (e % 3) + e / 3]) - (e % 4 == 0 ? trace : 0);
  return of;
}

// Δ of a further turn by a, as Cayley's map.
Mat3 Turned(const Mat3& delta, const Vec3& a) {
  const Vec3 q = 0.5 * a;
  Mat3 turn, sum;
  CayleyTurn(q.data(), turn.data());
  const Mat3 more = Mul(PlusOne(delta), turn);
  for (int e = 0; e < 9; e++) sum[e] = delta[e] + more[e];
  return sum;
}

// Newton's correction, along which E falls whatever its curvature.
Vec3 Correction(const Landscape& at) {
  double value[3], vector[9], quaternion[4];
  mju_eig3(value, vector, quaternion, at.curvature.data());
  const double floor = kMinTwist * std::max({std::abs(value[0]), std::abs(value[1]), std::abs(value[2])});
  Vec3 a{};
  if (!(floor > 0)) return a;
  for (int n = 0; n < 3; n++) {
    const Vec3 axis = {vector[n], vector[3 + n], vector[6 + n]};
    a = a - (Dot(axis, at.slope) / std::max(std::abs(value[n]), floor)) * axis;
  }
  const double length = Norm(a);
  return length > kTrustRadius ? (kTrustRadius / length) * a : a;
}

// Goes down from Δ; returns E.
double Descend(const Turn& turn, Mat3* delta) {
  double energy = 0;
  for (int step = 0; step < kTurnSteps; step++) {
    const Landscape at = LandscapeAt(turn, *delta, true);
    energy = at.energy;
    Vec3 a = Correction(at);
    const double expected = -Dot(a, at.slope), length = Norm(a);
    if (!(length > 0)) return energy;
    Mat3 next = Turned(*delta, a);
    if (length > kTurnSure) {
      for (int halving = 0; halving < kTurnHalvings; halving++) {
        if (LandscapeAt(turn, next, false).energy <= energy - kTurnSlope * expected) break;
        a = 0.5 * a;
        next = Turned(*delta, a);
      }
    }
    *delta = next;
    if (length < kRotated) break;
  }
  return energy;
}

}  // namespace

bool Opposes(const Mat3& S, double firmness, Opposition* of) {
  const Mat3 sym = {S[0], 0.5 * (S[1] + S[3]), 0.5 * (S[2] + S[6]), 0.5 * (S[1] + S[3]),
                    S[4], 0.5 * (S[5] + S[7]), 0.5 * (S[2] + S[6]), 0.5 * (S[5] + S[7]),
                    S[8]};
  double value[3], vector[9], quaternion[4], below[3];
  double minors[3] = {sym[0] - kOpposed, 0, 0};
  minors[1] = minors[0] * (sym[4] - kOpposed) - sym[1] * sym[1];
  minors[2] = Det({minors[0], sym[1], sym[2], sym[3], sym[4] - kOpposed, sym[5], sym[6], sym[7], sym[8] - kOpposed});
  if (minors[0] > 0 && minors[1] > 0 && minors[2] > 0) return false;
  mju_eig3(value, vector, quaternion, sym.data());
  if (!(value[2] < kOpposed)) return false;
  of->energy = 0;
  of->slope = {};
  std::fill_n(of->curvature, 81, 0.0);
  for (int n = 0; n < 3; n++) {
    below[n] = std::min(0.0, value[n] - kOpposed);
    of->energy += 0.5 * firmness * below[n] * below[n];
    for (int e = 0; e < 9; e++) {
      of->slope[e] += firmness * below[n] * vector[3 * (e / 3) + n] * vector[3 * (e % 3) + n];
    }
  }
  for (int n = 0; n < 3; n++) {
    for (int k = 0; k <= n; k++) {
      const double apart = value[k] - value[n];
      const double secant = apart > kSameValue ? (below[k] - below[n]) / apart : (below[n] < 0 ? 1.0 : 0.0);
      if (!(secant > 0)) continue;
      double mode[9];
      for (int e = 0; e < 9; e++) {
        mode[e] = 0.5 * (vector[3 * (e / 3) + n] * vector[3 * (e % 3) + k] +
                         vector[3 * (e / 3) + k] * vector[3 * (e % 3) + n]);
      }
      const double factor = firmness * secant * (n == k ? 1 : 2);
      for (int e = 0; e < 81; e++) of->curvature[e] += factor * mode[e / 9] * mode[e % 9];
    }
  }
  return true;
}

Mat3 LeastTurn(const Turn& turn, bool everywhere) {
  Mat3 best{};
  double least = Descend(turn, &best);
  const Mat3 near = PlusOne(best);
  for (int p = 0; p < turn.frames && everywhere; p++) {
    if (SmallestEigenvalue(Mul(Transpose(near), turn.frame[p])) < kFolded) break;
    everywhere = p + 1 < turn.frames;
  }
  if (!everywhere) return best;
  const auto from = [&](Mat3 delta) {
    const double energy = Descend(turn, &delta);
    if (!(energy < least)) return;
    least = energy;
    best = delta;
  };
  for (int axis = 0; axis < 3; axis++) {  // half a turn about each axis
    Mat3 half{};
    for (int e = 0; e < 9; e += 4) half[e] = e == 4 * axis ? 0 : -2;
    from(half);
  }
  for (int p = 0; p < turn.frames; p++) {  // as frames are turned that oppose the region
    Opposition opposed;
    if (!Opposes(Mul(Transpose(near), turn.frame[p]), turn.firmness, &opposed)) continue;
    Mat3 toward = ClosestRotation(turn.frame[p], kIdentity);
    for (int e = 0; e < 9; e += 4) toward[e] -= 1;
    from(toward);
  }
  return best;
}

}  // namespace mjframes
