#include "turn.h"

#include <algorithm>
#include <cmath>

#include "constants.h"
#include "hessian.h"
#include "rotation.h"

namespace mjframes {
namespace {

// E and, for turns D exp([a]×), its slope and curvature in a at a = 0.
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

void AddCells(const Turn& turn, int group, const Mat3& delta, const double* column, Mat3* slope, Landscape* of) {
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

void AddPressed(const TurnPressed& pressed, const Mat3& delta, const double* column, Mat3* slope, Landscape* of) {
  Lanes strain[kStrains], F[9];
  for (int s = 0; s < kStrains; s++) {
    double sum = pressed.strain[s];
    for (int n = 0; n < 9; n++) sum += pressed.slope[9 * s + n] * delta[n];
    strain[s] = Fill(sum);
  }
  FromStrains(strain, F);
  if (EigenvaluesExceed(F, Fill(1 - kPressedBegin))[0]) return;
  const Pressed<Lanes> at = PressedAt(Fill(pressed.firmness), strain);
  of->energy += at.energy[0];
  double turned[3 * kStrains] = {}, product[3 * kStrains] = {};
  for (int s = 0; s < kStrains; s++) {
    for (int n = 0; n < 9; n++) {
      (*slope)[n] += pressed.slope[9 * s + n] * at.stress[s][0];
      for (int c = 0; c < 3; c++) turned[3 * s + c] += pressed.slope[9 * s + n] * column[9 * c + n];
    }
  }
  for (int s = 0; s < kStrains; s++) {
    for (int t = 0; t < kStrains; t++) {
      for (int c = 0; c < 3; c++) product[3 * s + c] += at.hessian[kStrains * s + t][0] * turned[3 * t + c];
    }
    for (int e = 0; e < 9; e++) of->curvature[e] += turned[3 * s + e / 3] * product[3 * s + e % 3];
  }
}

Landscape LandscapeAt(const Turn& turn, const Mat3& delta) {
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
  for (int c = 0; c < 3; c++) {
    double product[9];
    for (int n = 0; n < 9; n++) {
      product[n] = 0;
      for (int k = 0; k < 9; k++) product[n] += turn.curvature[9 * n + k] * column[9 * c + k];
    }
    for (int d = 0; d < 3; d++) {
      for (int n = 0; n < 9; n++) of.curvature[3 * d + c] += column[9 * d + n] * product[n];
    }
  }
  for (int g = 0; g < turn.groups; g++) AddCells(turn, g, delta, column, &slope, &of);
  AddPressed(turn.pressed, delta, column, &slope, &of);
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
  Mat3 axes;
  const Vec3 value = Eigenvectors(at.curvature, &axes);
  const double floor = kMinTwist * std::max({std::abs(value[0]), std::abs(value[1]), std::abs(value[2])});
  if (!(floor > 0)) return {};
  Vec3 along = MulT(axes, at.slope);
  for (int n = 0; n < 3; n++) along[n] /= -std::max(std::abs(value[n]), floor);
  const Vec3 a = Mul(axes, along);
  const double length = Norm(a);
  return length > kTrustRadius ? (kTrustRadius / length) * a : a;
}

// Goes down from Δ; returns E.
double Descend(const Turn& turn, Mat3* delta) {
  Landscape at = LandscapeAt(turn, *delta);
  for (int step = 0; step < kTurnSteps; step++) {
    Vec3 a = Correction(at);
    const double expected = -Dot(a, at.slope), length = Norm(a);
    if (!(length > 0)) break;
    Mat3 next = Turned(*delta, a);
    Landscape there = LandscapeAt(turn, next);
    for (int halving = 0; halving < kTurnHalvings && length > kTurnSure; halving++) {
      if (there.energy <= at.energy - kTurnSlope * expected) break;
      a = 0.5 * a;
      next = Turned(*delta, a);
      there = LandscapeAt(turn, next);
    }
    *delta = next;
    at = there;
    if (length < kRotated) break;
  }
  return at.energy;
}

}  // namespace

Mat3 LeastTurn(const Turn& turn) {
  Mat3 best{};
  double least = Descend(turn, &best);
  const Mat3 turned = Mul(Transpose(PlusOne(best)), turn.S);
  if (turn.solid && EigenvaluesExceed(turned.data(), kFolded)) return best;
  for (int start = 1; start < 12; start++) {  // the turns of a tetrahedron
    const int shift = start / 4, flipped = start % 4;
    Mat3 delta{};
    for (int r = 0; r < 3; r++) {
      delta[3 * r + (r + shift) % 3] = flipped == 0 || r + 1 == flipped ? 1 : -1;
      delta[4 * r] -= 1;
    }
    const double energy = Descend(turn, &delta);
    if (!(energy < least)) continue;
    least = energy;
    best = delta;
  }
  return best;
}

}  // namespace mjframes
