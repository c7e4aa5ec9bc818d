#include "firmness.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "constants.h"
#include "impedance.h"

namespace mjframes {
namespace {

// MuJoCo's k, as it takes it from solref [1/s²]: the rows have it no more when this stage comes again.
double Stiffness(const mjModel* m, const mjContact& contact) {
  const double most = std::clamp(contact.solimp[1], mjMINIMP, mjMAXIMP);
  const double time = contact.solref[0], ratio = contact.solref[1];
  if (time <= 0) return -time / (most * most);
  const double least = m->opt.disableflags & mjDSBL_REFSAFE ? 0 : 2 * m->opt.timestep;
  const double period = most * std::max(time, least) * ratio;
  return 1 / std::max(mjMINVAL, period * period);
}

}  // namespace

Firmness MakeFirm(const mjModel* m, mjData* d, const mjContact& contact, double flesh) {
  const int row = contact.efc_address, rows = m->opt.cone == mjCONE_PYRAMIDAL ? RowCount(m, contact) : 1;
  const double k = Stiffness(m, contact), ratio = contact.solref[1];
  const double imp = d->efc_KBIP[4 * row + 2], inertia = rows / d->efc_R[row], own = k * imp * inertia;
  if (contact.solref[0] <= 0 || ratio < 1) return {rows, k, own, std::numeric_limits<double>::infinity()};
  const double outward = kSlowReturn + kReturn * std::sqrt(k) * (d->efc_margin[row] - d->efc_pos[row]);
  const double h = m->opt.timestep, moved = inertia * (1 - imp) / imp, rate = (1 / std::sqrt(1 - imp) - 1) / h;
  const double asked = kFirmer / flesh * std::min(1.0, kUsualPeriod * kUsualPeriod * k);
  const double K = std::min(asked, rate * rate * moved);
  // MuJoCo's b where K is its own: the stage before may have set another
  const double implicit = K > own ? (h * K + 2 * std::sqrt(K * moved)) / inertia : 0;
  const double b = std::max(2 * ratio * std::sqrt(k), implicit);
  for (int r = row; r < row + RowCount(m, contact); r++) d->efc_KBIP[4 * r + 1] = b;
  if (K <= own) return {rows, k, own, outward};
  return {rows, K / (inertia * imp), K, outward};
}

}  // namespace mjframes
