#include "dents.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "constants.h"
#include "firmness.h"
#include "impedance.h"
#include "patch_field.h"
#include "stack.h"

namespace mjframes {
namespace {

// A contact that is pressed.
struct Pressed {
  int contact, row, rows;  // those that push along the normal, from this one on
  int group;               // the first of those that it meets in C
  int body[2];             // instance of the soft body on each side that makes a dent, −1 where there is none
  double k;                // of the contact's own spring [1/s²]
  double spring;           // k imp / R of it [N/m]
  double gap;              // δ [m]
  double lift;             // of what rolls over it [m/s²]
  double rate;             // of what the normal row measures [m/s]
  double outward;          // of its firmness [m/s]
};

// erf(x) / x, and its slope, at places kErfStep apart; beyond the last, erf is 1. Written once, at load.
struct ErfTable {
  double value[kErfPlaces + 1], slope[kErfPlaces + 1];

  ErfTable() {
    for (int i = 0; i <= kErfPlaces; i++) {
      const double x = i * kErfStep, gauss = 2 * std::numbers::inv_sqrtpi * std::exp(-x * x);
      value[i] = i > 0 ? std::erf(x) / x : gauss;
      slope[i] = i > 0 ? (gauss - value[i]) / x : 0;
    }
  }

  // By the cubic with these values and slopes, within 2e-8 of it.
  double At(double x) const {
    const double place = x / kErfStep;
    const int i = static_cast<int>(std::min(place, double{kErfPlaces}));
    if (i == kErfPlaces) return 1 / x;
    const double u = place - i, rise = value[i + 1] - value[i];
    const double first = kErfStep * slope[i] - rise, last = rise - kErfStep * slope[i + 1];
    return value[i] + u * (rise + (1 - u) * ((1 - u) * first + u * last));
  }
};

const ErfTable g_erf;

// G(q) [1/m]
double Spread(double r, double q) {
  const double unit = 1 / std::sqrt(2 * q);
  return unit * g_erf.At(unit * r);
}

// [G(s) − 2 G(s + ℓ²) + G(s + 2 ℓ²)] at distance r [1/m]
double Kernel(double r, double s, double square) {
  return Spread(r, s) - 2 * Spread(r, s + square) + Spread(r, s + 2 * square);
}

// c of two contacts [m/N].
double Compliance(const mjData* d, const ContactDents* dents, const Pressed& p, const Pressed& q) {
  const mjContact &one = d->contact[p.contact], &other = d->contact[q.contact];
  const ContactDents &of_one = dents[p.contact], &of_other = dents[q.contact];
  double sum = 0;
  for (int a = 0; a < 2; a++) {
    for (int b = 0; b < 2 && p.body[a] >= 0; b++) {
      if (p.body[a] != q.body[b]) continue;
      const Dent &first = of_one.side[a], &second = of_other.side[b];
      const double r = Norm(of_one.centre - of_other.centre);
      const double s = kPressure * (of_one.variance + of_other.variance), square = first.width * second.width;
      if (r * r > kFarDent * (s + 2 * square)) continue;
      const double cosine = (a == b ? 1 : -1) * Dot(ToVec3(one.frame), ToVec3(other.frame));
      sum += first.softness * second.softness * cosine * Kernel(r, s, square);
    }
  }
  return sum;
}

// Which way is out of side s of a contact.
Vec3 Outward(const mjContact& contact, int s) { return (s == 0 ? 1 : -1) * ToVec3(contact.frame); }

// How contacts press the flesh around side s of a contact, which is one of them.
struct Around {
  double opposite;  // how deep on the other side [m]
  double covered;   // what share of the body's section on this side [-]; 0 where that is not known
};

// last: which side of a contact was its soft body's last one.
Around PressedAround(const mjData* d, const ContactDents* dents, int number, int s, int last) {
  const Vec3 out = Outward(d->contact[number], s);
  const Dent& dent = dents[number].side[s];
  const double square = dent.width * dent.width;
  double depth = 0, area = 0;
  for (int some = last; some >= 0; some = dents[some / 2].before[some % 2]) {
    const int c = some / 2;
    const double dist = d->contact[c].dist, opposed = -Dot(out, Outward(d->contact[c], some % 2));
    if (!(opposed > 0)) {
      if (dist < 0) area -= opposed * kEvenPressure * dents[c].variance;
      continue;
    }
    const Vec3 offset = dents[c].centre - dents[number].centre;
    const double along = Dot(offset, out), apart = Dot(offset, offset) - along * along;
    if (!(apart < square)) continue;
    depth = std::max(depth, -opposed * (1 - apart / square) * dist);
  }
  return {depth, dent.section > 0 ? std::min(1.0, area / dent.section) : 0};
}

// The contact as one that is pressed; false where it is not, or makes no dent.
bool Press(const mjModel* m, mjData* d, const ContactDents& dents, int number, Pressed* pressed) {
  const mjContact& contact = d->contact[number];
  const int row = contact.efc_address;
  if (row < 0 || !(dents.flesh > 0)) return false;
  const auto [rows, k, spring, outward] = MakeFirm(m, d, contact, dents.flesh);
  const double gap = d->efc_margin[row] - d->efc_pos[row];
  *pressed = {number, row, rows, 0, {-1, -1}, k, spring, gap, dents.lift, 0, outward};
  for (int r = 0; r < rows; r++) pressed->rate += d->efc_vel[row + r] / rows;
  for (int s = 0; s < 2; s++) {
    if (dents.side[s].softness > 0) pressed->body[s] = SoftInstanceOf(m, contact.geom[s]);
  }
  return pressed->gap > 0 && spring > 0;
}

// f by projected Gauss–Seidel's method, there and back.
void Solve(const Pressed* pressed, const double* C, int n, double* f) {
  std::fill_n(f, n, 0.0);
  for (int sweep = 0; sweep < 2 * kDentSweeps; sweep++) {
    for (int step = 0; step < n; step++) {
      const int i = sweep % 2 == 0 ? step : n - 1 - step;
      f[i] = std::max(0.0, f[i] + (pressed[i].gap - mju_dot(C + i * n, f, n)) / C[i * n + i]);
    }
  }
}

// Lets rows whose friction does not go with their R along the normal give way as fast as dents may. A pyramid would
// creep where they do: R of its edges is that of friction, too. C becomes its factor; work: memory (2n).
void Soften(mjData* d, const Pressed* pressed, double* C, int n, double* work) {
  if (std::all_of(pressed, pressed + n, [](const Pressed& one) { return one.rows > 1; })) return;
  if (mju_cholFactor(C, n, std::numeric_limits<double>::min()) < n) return;
  double *unit = work, *column = work + n;
  for (int i = 0; i < n; i++) {
    if (pressed[i].rows > 1) continue;
    std::fill_n(unit, n, 0.0);
    unit[i] = 1;
    mju_cholSolve(column, C, unit, n);
    mjContact& contact = d->contact[pressed[i].contact];
    const int row = pressed[i].row;
    const double firmest = mju_L1(column, n);  // Σ_j |C⁻¹_ij|: the diagonal matrix of these is above C⁻¹
    SetResistance(d, row, std::max(d->efc_R[row], pressed[i].k * d->efc_KBIP[4 * row + 2] / firmest));
    if (contact.dim > 1) contact.mu = contact.friction[0] * std::sqrt(d->efc_R[row + 1] / d->efc_R[row]);
  }
}

// Gives the rows the spring that answers the gap with f; where that is 0, one that starts at the flesh, `left` away.
// Edges of a pyramid keep their R, and their damping b, which friction shares: with it a spring so much softer would
// come to rest late. What b is above the spring's critical damping is taken off along the normal, where R is as a mass,
// as far as it is no faster than that spring would make it: what hits is stopped as before. What comes out as fast as
// it would of MuJoCo's own contact is pushed less, at twice that rate no more: C changes with the state, so a dent
// might give back more than it took.
void SetSpring(mjData* d, const Pressed& pressed, double f, double left) {
  const double imp = d->efc_KBIP[4 * pressed.row + 2], b = d->efc_KBIP[4 * pressed.row + 1];
  double pull = f > 0 ? f * d->efc_R[pressed.row] / (pressed.rows * imp) : -pressed.k * left;
  if (f > 0) {
    const double rate = std::sqrt(imp * pull / pressed.gap), most = rate * pressed.gap;
    if (pressed.rows > 1) pull += std::max(0.0, b - 2 * rate) * std::clamp(pressed.rate, -most, most) / imp;
    pull *= std::clamp(2 - pressed.rate / pressed.outward, 0.0, 1.0);
  }
  pull += pressed.lift / imp;
  for (int r = 0; r < pressed.rows; r++) d->efc_KBIP[4 * (pressed.row + r)] = pull / pressed.gap;
}

// Sorts contacts that are pressed into groups that share soft bodies, each in the order of its contacts; returns the
// size of the largest. last: memory, of each plugin instance.
int Group(Pressed* pressed, int n, int* last, int instances) {
  const auto root = [pressed](int i) {
    while (pressed[i].group != i) i = pressed[i].group;
    return i;
  };
  std::fill_n(last, instances, -1);
  for (int i = 0; i < n; i++) {
    pressed[i].group = i;
    for (const int body : pressed[i].body) {
      if (body < 0) continue;
      if (last[body] >= 0) {
        const int one = root(last[body]), other = root(i);
        pressed[std::max(one, other)].group = std::min(one, other);
      }
      last[body] = i;
    }
  }
  for (int i = 0; i < n; i++) pressed[i].group = root(i);  // that of an earlier one is its root already
  std::sort(pressed, pressed + n, [](const Pressed& a, const Pressed& b) {
    return a.group != b.group ? a.group < b.group : a.contact < b.contact;
  });
  int most = 0;
  for (int begin = 0, end = 0; begin < n; begin = end) {
    while (end < n && pressed[end].group == pressed[begin].group) end++;
    most = std::max(most, end - begin);
  }
  return most;
}

// The springs of one group. memory: (n² + 4n).
void SetGroup(mjData* d, const ContactDents* dents, const Pressed* pressed, int n, double* memory) {
  double *C = memory, *f = C + static_cast<size_t>(n) * n, *left = f + n, *work = left + n;
  for (int i = 0; i < n; i++) {
    for (int j = 0; j <= i; j++) C[i * n + j] = C[j * n + i] = Compliance(d, dents, pressed[i], pressed[j]);
    C[i * n + i] += 1 / pressed[i].spring;
  }
  Solve(pressed, C, n, f);
  for (int i = 0; i < n; i++) left[i] = std::max(0.0, mju_dot(C + i * n, f, n) - pressed[i].gap);
  if (n <= kMostSoftened) Soften(d, pressed, C, n, work);
  for (int i = 0; i < n; i++) SetSpring(d, pressed[i], f[i], left[i]);
}

}  // namespace

double DentOfForce(const ContactDents& dents, const Dent& flesh, double distance) {
  const double s = kPressure * dents.variance, square = flesh.width * flesh.width;
  if (distance * distance > kFarDent * (s + 2 * square)) return 0;
  return flesh.softness * flesh.softness * Kernel(distance, s, square);
}

void Squeeze(const mjModel* m, const mjData* d, ContactDents* dents, std::vector<int>* last) {
  std::fill(last->begin(), last->end(), -1);
  for (int c = 0; c < d->ncon; c++) {
    dents[c].flesh = 0;
    for (int s = 0; s < 2; s++) {
      dents[c].before[s] = -1;
      if (!(dents[c].side[s].width > 0)) continue;
      int& of_body = (*last)[SoftInstanceOf(m, d->contact[c].geom[s])];
      dents[c].before[s] = of_body;
      of_body = 2 * c + s;
    }
  }
  for (int c = 0; c < d->ncon; c++) {
    for (int s = 0; s < 2; s++) {
      Dent& dent = dents[c].side[s];
      if (!(dent.softness > 0)) continue;
      dents[c].flesh += dent.softness * dent.softness * Spread(0, 2 * kPressure * dents[c].variance);
      if (!(d->contact[c].dist < 0)) continue;
      const int of_body = (*last)[SoftInstanceOf(m, d->contact[c].geom[s])];
      const auto [opposite, covered] = PressedAround(d, dents, c, s, of_body);
      dent.softness *= std::sqrt(1 - covered * covered);
      const double depth = opposite - d->contact[c].dist, left = std::max(0.0, 1 - depth / dent.thickness);
      dent.softness *= left * std::sqrt(3 / (1 + left + left * left));
    }
  }
}

bool SetDents(const mjModel* m, mjData* d, const ContactDents* dents) {
  if (!HasRoom(d, d->ncon * sizeof(Pressed) / sizeof(mjtNum) + m->nplugin + 1)) return false;
  mj_mulJacVec(m, d, d->efc_vel, d->qvel);  // MuJoCo does so after this stage
  MarkStack(d);
  auto* pressed = static_cast<Pressed*>(mj_stackAllocByte(d, d->ncon * sizeof(Pressed), alignof(Pressed)));
  int n = 0;
  for (int c = 0; c < d->ncon; c++) n += Press(m, d, dents[c], c, pressed + n);
  const int most = Group(pressed, n, mj_stackAllocInt(d, m->nplugin), m->nplugin);
  const bool has_room = HasRoom(d, static_cast<size_t>(most + 4) * most);
  if (has_room && n > 0) {
    double* memory = mj_stackAllocNum(d, static_cast<size_t>(most + 4) * most);
    for (int begin = 0, end = 0; begin < n; begin = end) {
      while (end < n && pressed[end].group == pressed[begin].group) end++;
      SetGroup(d, dents, pressed + begin, end - begin, memory);
    }
  }
  FreeStack(d);
  return has_room;
}

}  // namespace mjframes
