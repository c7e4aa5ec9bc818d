#include "dents.h"

#include <algorithm>
#include <cmath>

#include "constants.h"
#include "impedance.h"
#include "patch_field.h"
#include "stack.h"

namespace mjframes {
namespace {

constexpr double kPi = 3.14159265358979323846;

// A contact that is pressed.
struct Pressed {
  int contact, row;
  int body[2];    // instance of the soft body on each side that makes a dent, −1 where there is none
  double spring;  // k imp / R of MuJoCo's own [N/m]
  double gap;     // δ [m]
  double force;   // f [N]
};

// [G(s) − 2 G(s + ℓ²) + G(s + 2 ℓ²)] at distance r [1/m]
double Kernel(double r, double s, double square) {
  const double q[3] = {s, s + square, s + 2 * square};
  double value[3];
  for (int i = 0; i < 3; i++) {
    const double x = r / std::sqrt(2 * q[i]);
    value[i] = x > kNearPlace ? std::erf(x) / r : std::sqrt(2 / (kPi * q[i]));
  }
  return value[0] - 2 * value[1] + value[2];
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
      const double r = Norm(ToVec3(one.pos) - ToVec3(other.pos));
      const double s = kPressure * (of_one.variance + of_other.variance), square = first.width * second.width;
      if (r * r > kFarDent * (s + 2 * square)) continue;
      const double cosine = (a == b ? 1 : -1) * Dot(ToVec3(one.frame), ToVec3(other.frame));
      sum += first.softness * second.softness * cosine * Kernel(r, s, square);
    }
  }
  return sum;
}

// k of a contact's spring as MuJoCo takes it from solref [1/s²]. The rows have another after this stage, which may come
// again on the same rows.
double Stiffness(const mjModel* m, const mjContact& contact) {
  const double most = std::clamp(contact.solimp[1], mjMINIMP, mjMAXIMP);
  const double time = contact.solref[0], ratio = contact.solref[1];
  if (time <= 0) return -time / (most * most);
  const double least = m->opt.disableflags & mjDSBL_REFSAFE ? 0 : 2 * m->opt.timestep;
  const double period = most * std::max(time, least) * ratio;
  return 1 / std::max(mjMINVAL, period * period);
}

// How many rows push along the normal.
int NormalRows(const mjModel* m, const mjContact& contact) {
  return m->opt.cone == mjCONE_PYRAMIDAL ? RowCount(m, contact) : 1;
}

// The contact as one that is pressed; false where it is not, or makes no dent.
bool Press(const mjModel* m, const mjData* d, const ContactDents& dents, int number, Pressed* pressed) {
  const mjContact& contact = d->contact[number];
  const int row = contact.efc_address;
  if (row < 0 || !(dents.side[0].softness > 0 || dents.side[1].softness > 0)) return false;
  *pressed = {number, row, {-1, -1}, 0, d->efc_margin[row] - d->efc_pos[row], 0};
  if (!(pressed->gap > 0)) return false;
  for (int s = 0; s < 2; s++) {
    if (dents.side[s].softness > 0) pressed->body[s] = SoftInstanceOf(m, contact.geom[s]);
  }
  pressed->spring = Stiffness(m, contact) * d->efc_KBIP[4 * row + 2] * NormalRows(m, contact) / d->efc_R[row];
  return pressed->spring > 0;
}

// f by projected Gauss–Seidel's method, there and back. C: lower triangle (n × n).
void Solve(Pressed* pressed, const double* C, int n) {
  for (int sweep = 0; sweep < 2 * kDentSweeps; sweep++) {
    for (int step = 0; step < n; step++) {
      const int i = sweep % 2 == 0 ? step : n - 1 - step;
      double left = pressed[i].gap;
      for (int j = 0; j < n; j++) left -= (j < i ? C[i * n + j] : C[j * n + i]) * pressed[j].force;
      pressed[i].force = std::max(0.0, pressed[i].force + left / C[i * n + i]);
    }
  }
}

// Gives the rows the spring that answers the gap with f; where that is 0, one that starts at the flesh, `left` away.
void SetSpring(const mjModel* m, mjData* d, const Pressed& pressed, double left) {
  const mjContact& contact = d->contact[pressed.contact];
  const int rows = NormalRows(m, contact);
  double k = -Stiffness(m, contact) * left;
  if (pressed.force > 0) k = pressed.force * d->efc_R[pressed.row] / (rows * d->efc_KBIP[4 * pressed.row + 2]);
  k /= pressed.gap;
  for (int r = 0; r < rows; r++) d->efc_KBIP[4 * (pressed.row + r)] = k;
}

// B = C⁻¹, full, of C + its lower triangle only; by Gauss–Jordan elimination. False where C has no inverse.
bool Invert(const double* C, double* B, int n) {
  for (int i = 0; i < n; i++) {
    for (int j = 0; j < n; j++) B[i * n + j] = j < i ? C[i * n + j] : C[j * n + i];
  }
  for (int k = 0; k < n; k++) {
    const double pivot = B[k * n + k];
    if (!(pivot > 0)) return false;
    for (int i = 0; i < n; i++) {
      if (i == k) continue;
      const double factor = B[i * n + k] / pivot;
      for (int j = 0; j < n; j++) B[i * n + j] -= factor * B[k * n + j];
      B[i * n + k] = -factor;
    }
    for (int j = 0; j < n; j++) B[k * n + j] /= pivot;
    B[k * n + k] = 1 / pivot;
  }
  return true;
}

// Lets rows whose friction does not go with their R along the normal give way as fast as dents may. A pyramid's creep
// where they do: R of its edges is that of friction, too.
void Soften(const mjModel* m, mjData* d, const Pressed* pressed, const double* B, int n) {
  for (int i = 0; i < n; i++) {
    mjContact& contact = d->contact[pressed[i].contact];
    if (NormalRows(m, contact) > 1) continue;
    const int row = pressed[i].row;
    double firmest = 0;  // Σ_j |B_ij|: the diagonal of these is above B
    for (int j = 0; j < n; j++) firmest += std::abs(B[i * n + j]);
    SetResistance(d, row, std::max(d->efc_R[row], Stiffness(m, contact) * d->efc_KBIP[4 * row + 2] / firmest));
    if (contact.dim > 1) contact.mu = contact.friction[0] * std::sqrt(d->efc_R[row + 1] / d->efc_R[row]);
  }
}

}  // namespace

void SetDents(const mjModel* m, mjData* d, const ContactDents* dents) {
  if (!HasRoom(d, d->ncon * sizeof(Pressed) / sizeof(mjtNum) + 1)) return;
  MarkStack(d);
  auto* pressed = static_cast<Pressed*>(mj_stackAllocByte(d, d->ncon * sizeof(Pressed), alignof(Pressed)));
  int n = 0;
  for (int c = 0; c < d->ncon; c++) n += Press(m, d, dents[c], c, pressed + n);
  if (n > 0 && HasRoom(d, static_cast<size_t>(n) * n)) {
    double* C = mj_stackAllocNum(d, static_cast<size_t>(n) * n);
    for (int i = 0; i < n; i++) {
      for (int j = 0; j <= i; j++) C[i * n + j] = Compliance(d, dents, pressed[i], pressed[j]);
      C[i * n + i] += 1 / pressed[i].spring;
    }
    Solve(pressed, C, n);
    if (n <= kMostSoftened && HasRoom(d, static_cast<size_t>(n) * n)) {
      double* B = mj_stackAllocNum(d, static_cast<size_t>(n) * n);
      if (Invert(C, B, n)) Soften(m, d, pressed, B, n);
    }
    for (int i = 0; i < n; i++) {
      double left = -pressed[i].gap;
      for (int j = 0; j < n; j++) left += (j < i ? C[i * n + j] : C[j * n + i]) * pressed[j].force;
      SetSpring(m, d, pressed[i], std::max(0.0, left));
    }
  }
  FreeStack(d);
}

}  // namespace mjframes
