#include "warm_start.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "constants.h"
#include "dents.h"
#include "elimination.h"
#include "impedance.h"
#include "patch_field.h"
#include "simd.h"
#include "stack.h"

namespace mjframes {
namespace {

// Whether an island is solved here: of many more rows than degrees of freedom MuJoCo's own factors are the smaller
// ones.
bool IsTaken(const mjModel* m, const mjData* d, int island) {
  const bool parted = d->nisland > 0;
  if (island < 0) return false;  // it moves nothing
  const int rows = parted ? d->island_nefc[island] : d->nefc;
  const int dofs = static_cast<int>(parted ? d->island_nv[island] : m->nv);
  return rows <= std::min(kMostRows, std::max(kFewRows, 3 * dofs));
}

bool TouchesSoft(const mjModel* m, const mjData* d, int row) {
  if (!IsContact(d, row)) return false;
  const int* geom = d->contact[d->efc_id[row]].geom;
  return std::any_of(geom, geom + 2, [m](int g) { return g >= 0 && SoftInstanceOf(m, g) >= 0; });
}

// Whether all actuators are MuJoCo's: callbacks and plugins are called once a step, by MuJoCo.
bool ActuatesAlone(const mjModel* m) {
  if (mjcb_act_dyn || mjcb_act_gain || mjcb_act_bias) return false;
  return std::all_of(m->actuator_plugin, m->actuator_plugin + m->nactuator, [](int plugin) { return plugin < 0; });
}

// How many numbers of mjData are written by mj_fwdActuation.
size_t ActuationSize(const mjModel* m) { return m->na + m->nout + m->nv; }

// force += what actuators push with. mjData keeps what it says of them: their stage may not come.
void AddActuation(const mjModel* m, mjData* d, double* force) {
  if (m->nactuator == 0 || !ActuatesAlone(m)) return;
  MarkStack(d);
  const std::pair<mjtNum*, size_t> written[] = {
      {d->act_dot, m->na}, {d->actuator_force, m->nout}, {d->qfrc_actuator, m->nv}};
  mjtNum* const kept = mj_stackAllocNum(d, ActuationSize(m));
  mjtNum* end = kept;
  for (const auto& [array, size] : written) end = std::copy_n(array, size, end);
  mj_fwdActuation(m, d);
  mju_addTo(force, d->qfrc_actuator, m->nv);
  end = kept;
  for (const auto& [array, size] : written) {
    std::copy_n(end, size, array);
    end += size;
  }
  FreeStack(d);
}

// The smooth forces, as mj_fwdAcceleration will have them. Bias and actuators are current after this stage only.
void SmoothForce(const mjModel* m, mjData* d, double* force) {
  mju_zero(force, m->nv);
  mj_rne(m, d, 0, force);
  for (int k = 0; k < m->nv; k++) force[k] = d->qfrc_passive[k] - force[k] + d->qfrc_applied[k];
  AddActuation(m, d, force);
  for (int body = 1; body < m->nbody; body++) {
    const mjtNum* applied = d->xfrc_applied + 6 * body;
    if (std::any_of(applied, applied + 6, [](mjtNum f) { return f != 0; })) {
      mj_applyFT(m, d, applied, applied + 3, d->xipos + 3 * body, body, force);
    }
  }
}

// What a row's force may be.
struct Bounds {
  double least, largest;
};

Bounds BoundsOf(const mjData* d, int row) {
  constexpr double kAny = std::numeric_limits<double>::infinity();
  switch (d->efc_type[row]) {
    case mjCNSTR_EQUALITY:
      return {-kAny, kAny};
    case mjCNSTR_FRICTION_DOF:
    case mjCNSTR_FRICTION_TENDON:
      return {-d->efc_frictionloss[row], d->efc_frictionloss[row]};
    default:
      return {0, kAny};
  }
}

// The rows of one island, in whole groups: entries that fill a group up have D = 0.
struct Problem {
  int size;
  const double *D, *jar0;  // (size)
  const Bounds* bounds;

  double Force(int i, double jar) const { return std::clamp(-D[i] * jar, bounds[i].least, bounds[i].largest); }
  bool IsFree(int i, double jar) const {
    return D[i] > 0 && -D[i] * jar > bounds[i].least && -D[i] * jar < bounds[i].largest;
  }
};

// The step along p, q = A p, at most 1, at which the cost is least: where its slope Σ_i q_i (g_i + α p_i − f_i) is
// zero.
double LineSearch(const Problem& problem, const double* g, const double* jar, const double* p, const double* q) {
  const auto slope = [&](double step, double* curvature) {
    double sum = 0, second = 0;
    for (int i = 0; i < problem.size; i++) {
      const double at = jar[i] + step * q[i];
      sum += q[i] * (g[i] + step * p[i] - problem.Force(i, at));
      second += q[i] * (p[i] + (problem.IsFree(i, at) ? problem.D[i] * q[i] : 0));
    }
    *curvature = second;
    return sum;
  };
  double low = 0, high = 1, step = 1, curvature;
  const double first = slope(0, &curvature);
  for (int trial = 0; trial < kLineSearchSteps; trial++) {
    const double here = slope(step, &curvature);
    if (std::abs(here) <= kLineSearchSlope * std::abs(first) || (step == 1 && here < 0)) break;
    (here < 0 ? low : high) = step;
    const double next = step - here / curvature;
    step = next > low && next < high ? next : 0.5 * (low + high);
  }
  return step;
}

// half += Y force
void AddForces(const RowGroup& group, const Lanes& force, double* half) {
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    const Lanes some = force;
    for (int k = 0; k < group.size; k++) {
      const Lanes part = some * Load(group.y + kLanes * k);
      half[group.dof[k]] += (part[0] + part[1]) + (part[2] + part[3]);
    }
  });
}

// Constraint rows that hang together, and their degrees of freedom.
struct Island {
  int dofs, first_dof;
  const int* dof;  // null for all
  double scale;    // of MuJoCo's criteria: one over the sum of the inertias

  int Dof(int k) const { return dof ? dof[first_dof + k] : k; }
};

Island IslandOf(const mjModel* m, const mjData* d, int number) {
  Island island = {static_cast<int>(m->nv), 0, nullptr, 0};
  if (d->nisland > 0) island = {d->island_nv[number], d->island_idofadr[number], d->map_idof2dof, 0};
  double inertia = 0;
  for (int k = 0; k < island.dofs; k++) {
    const int dof = island.Dof(k);
    inertia += d->M[m->M_rowadr[dof] + m->M_rownnz[dof] - 1];
  }
  island.scale = 1 / inertia;
  return island;
}

// Σ_e L_e x_e over what is above a degree of freedom.
MJFRAMES_INLINE double SumAbove(const mjModel* m, const mjData* d, int dof, const double* x) {
  const int first = m->M_rowadr[dof], count = m->M_rownnz[dof] - 1;
  const double* L = d->qLD + first;
  const int* column = m->M_colind + first;
  Lanes sums = {};
  int e = 0;
  for (; e + kLanes <= count; e += kLanes) {
    sums += Load(L + e) * Lanes{x[column[e]], x[column[e + 1]], x[column[e + 2]], x[column[e + 3]]};
  }
  double sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
  for (; e < count; e++) sum += L[e] * x[column[e]];
  return sum;
}

// Whether an island's accelerations in d->qacc_warmstart are a solution still, by the criteria of MuJoCo's solver.
// half: D^(−½) L^(−ᵀ) of the smooth forces; left, work: memory (nv).
bool IsSolved(const mjModel* m, const mjData* d, const Island& island, const RowGroup* groups, const int* members,
              int count, const double* half, const double* sqrt_inverse, double* left, double* work) {
  // D^½ L a, less the forces
  double gap = 0, gradient = 0;
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    for (int k = 0; k < island.dofs; k++) {
      const int dof = island.Dof(k);
      const double sum = d->qacc_warmstart[dof] + SumAbove(m, d, dof, d->qacc_warmstart);
      left[dof] = sum / sqrt_inverse[dof] - half[dof];
      work[dof] = 0;
    }
  });
  for (int i = 0; i < count; i++) {
    const RowGroup& group = groups[members[i]];
    Lanes force = {};
    for (int r = 0; r < group.rows; r++) {
      const Bounds bounds = BoundsOf(d, group.row + r);
      force[r] = -std::clamp(-d->efc_D[group.row + r] * d->efc_b[group.row + r], bounds.least, bounds.largest);
    }
    AddForces(group, force, left);
  }
  for (int k = 0; k < island.dofs; k++) gap += left[island.Dof(k)] * left[island.Dof(k)];
  if (!(0.5 * island.scale * gap < m->opt.tolerance)) return false;
  if (m->opt.solver == mjSOL_CG) return true;
  // the forces themselves: Lᵀ D^½ of that
  for (int k = 0; k < island.dofs; k++) {
    const int dof = island.Dof(k), first = m->M_rowadr[dof];
    const double some = left[dof] / sqrt_inverse[dof];
    for (int e = first; e < first + m->M_rownnz[dof] - 1; e++) work[m->M_colind[e]] += d->qLD[e] * some;
    work[dof] += some;
  }
  for (int k = 0; k < island.dofs; k++) gradient += work[island.Dof(k)] * work[island.Dof(k)];
  return island.scale * std::sqrt(gradient) < m->opt.tolerance;
}

// The groups of an island, and A = Yᵀ Y of those that were asked for.
struct IslandGroups {
  const mjModel* m;
  const RowGroup* group;
  const int* member;
  int count;
  double* A;     // (kLanes count)²
  char* known;   // which of its blocks     (count × count)
  int* begin;    // of each group, the first one with which it shares a tree (count)
  double* work;  // (nv)

  const RowGroup& operator[](int i) const { return group[member[i]]; }

  // work = Y g
  void Spread(const Island& island, const double* g) const {
    for (int k = 0; k < island.dofs; k++) work[island.Dof(k)] = 0;
    for (int i = 0; i < count; i++) AddForces((*this)[i], Load(g + kLanes * i), work);
  }

  // out = offset + Yᵀ vector
  void Gather(const double* vector, const double* offset, double* out) const {
    for (int i = 0; i < count; i++) {
      Dispatch([&]<typename V>() MJFRAMES_KERNEL {
        const RowGroup& one = (*this)[i];
        Lanes sum = Load(offset + kLanes * i);
        for (int k = 0; k < one.size; k++) sum += vector[one.dof[k]] * Load(one.y + kLanes * k);
        Store(sum, out + kLanes * i);
      });
    }
  }

  // visit(tree) for each that group i depends on.
  template <typename Visit>
  void ForTrees(int i, const Visit& visit) const {
    const RowGroup& one = (*this)[i];
    for (const int *dof = one.dof, *end = dof + one.size; dof < end;) {
      const int tree = m->dof_treeid[*dof];
      visit(tree);
      dof = std::lower_bound(dof, end, m->tree_dofadr[tree] + m->tree_dofnum[tree]);
    }
  }

  // Finds where groups begin. first: of each tree, −1 before and after (ntree).
  void FindBegins(int* first) const {
    for (int i = 0; i < count; i++) {
      begin[i] = i;
      ForTrees(i, [&](int tree) {
        if (first[tree] < 0) first[tree] = i;
        begin[i] = std::min(begin[i], first[tree]);
      });
    }
    for (int i = 0; i < count; i++) {
      ForTrees(i, [first](int tree) { first[tree] = -1; });
    }
  }

  // Makes A right where both entries are among these, ascending, and the second's group is from where the first's
  // begins up to that.
  void Multiply(const int* entry, int entries) const {
    for (int e = 0, last = -1; e < entries; e++) {
      const int one = entry[e] / kLanes;
      if (one == last) continue;
      last = one;
      for (int f = 0, before = -1; f <= e; f++) {
        const int other = entry[f] / kLanes;
        if (other == before || other < begin[one]) continue;
        before = other;
        char& is_known = known[one * count + other];
        if (is_known) continue;
        is_known = 1;
        Lanes block[kLanes];
        MultiplyGroups(m, (*this)[one], (*this)[other], block);
        double* into = A + kLanes * (static_cast<size_t>(one) * kLanes * count + other);
        for (int r = 0; r < kLanes; r++) Store(block[r], into + static_cast<size_t>(kLanes) * count * r);
      }
    }
  }
};

// g for the rows that are free now, `count` of them, where the others stay as they are in g. False where that fails.
bool SolveFree(const Problem& problem, const Island& island, const IslandGroups& groups, const int* free, int count,
               double* matrix, double* memory, int* begin, double* right, double* g) {
  const Envelope envelope = {count, matrix, memory, begin};
  groups.Multiply(free, count);
  for (int a = 0; a < count; a++) {
    const double* row = groups.A + static_cast<size_t>(free[a]) * kLanes * groups.count;
    double* into = envelope.Row(a);
    const int group = groups.begin[free[a] / kLanes];
    const int there = group == 0 ? 0 : static_cast<int>(std::lower_bound(free, free + a, kLanes * group) - free);
    begin[a] = there / kWideLanes * kWideLanes;
    std::fill(into + begin[a], into + there, 0.0);
    for (int b = there; b <= a; b++) into[b] = row[free[b]];
    into[a] += 1 / problem.D[free[a]];
    g[free[a]] = 0;
  }
  const double* start = problem.jar0;
  if (std::any_of(g, g + problem.size, [](double force) { return force != 0; })) {  // friction losses
    groups.Spread(island, g);
    groups.Gather(groups.work, problem.jar0, right);
    start = right;
  }
  for (int a = 0; a < count; a++) right[a] = -start[free[a]];
  if (!envelope.Solve(right)) return false;
  for (int a = 0; a < count; a++) g[free[a]] = right[a];
  return true;
}

// Adds the forces of an island's rows, those of `members` of the groups, to `half`. False where they were not found.
// first_of_tree: −1 before and after (ntree). work: memory (nv).
bool SolveIsland(const mjModel* m, mjData* d, const Island& island, const RowGroup* group, const int* members,
                 int count, double* half, int* first_of_tree, double* work) {
  const int n = kLanes * count;
  const size_t square = static_cast<size_t>(n) * n;
  if (!HasRoom(d, square + Envelope::Entries(n) + Envelope::Memory(n) + 17 * static_cast<size_t>(n))) return false;
  MarkStack(d);
  double *A = mj_stackAllocNum(d, square), *matrix = mj_stackAllocNum(d, Envelope::Entries(n));
  double* memory = mj_stackAllocNum(d, Envelope::Memory(n));
  double *D = mj_stackAllocNum(d, n), *jar0 = mj_stackAllocNum(d, n), *jar = mj_stackAllocNum(d, n);
  double *g = mj_stackAllocNum(d, n), *next = mj_stackAllocNum(d, n), *change = mj_stackAllocNum(d, n);
  double *p = mj_stackAllocNum(d, n), *q = mj_stackAllocNum(d, n), *right = mj_stackAllocNum(d, n);
  auto* bounds = static_cast<Bounds*>(mj_stackAllocByte(d, n * sizeof(Bounds), alignof(Bounds)));
  int *free = mj_stackAllocInt(d, n), *before = mj_stackAllocInt(d, n), *begin = mj_stackAllocInt(d, n);
  char* known = static_cast<char*>(mj_stackAllocByte(d, static_cast<size_t>(count) * count, 1));
  std::fill_n(known, static_cast<size_t>(count) * count, 0);
  const IslandGroups groups = {m, group, members, count, A, known, mj_stackAllocInt(d, count), work};
  groups.FindBegins(first_of_tree);
  for (int i = 0; i < n; i++) {
    const int r = i % kLanes, row = groups[i / kLanes].row + r;
    const bool there = r < groups[i / kLanes].rows;
    D[i] = there ? d->efc_D[row] : 0;
    right[i] = there ? -d->efc_aref[row] : 0;
    bounds[i] = there ? BoundsOf(d, row) : Bounds{0, 0};
    jar[i] = there ? d->efc_b[row] : 0;
    g[i] = 0;
  }
  groups.Gather(half, right, jar0);
  const Problem problem = {n, D, jar0, bounds};
  bool solved = false;
  for (int iteration = 0, size = 0, last = -1; iteration < kMostIterations; iteration++) {
    size = 0;
    bool jumps = false;  // from one bound to the other
    for (int i = 0; i < n; i++) {
      next[i] = problem.Force(i, jar[i]);
      p[i] = g[i] - next[i];
      if (problem.IsFree(i, jar[i])) {
        free[size++] = i;
      } else {
        jumps = jumps || p[i] != 0;
      }
    }
    solved = !jumps && size == last && std::equal(free, free + size, before);
    if (!solved && iteration > 0 && m->opt.solver == mjSOL_CG) {  // by its criterion
      groups.Spread(island, p);
      double gap = 0;
      for (int k = 0; k < island.dofs; k++) gap += work[island.Dof(k)] * work[island.Dof(k)];
      solved = 0.5 * island.scale * gap < m->opt.tolerance;
    }
    if (solved || !SolveFree(problem, island, groups, free, size, matrix, memory, begin, right, next)) break;
    groups.Spread(island, next);
    groups.Gather(work, jar0, change);
    double step = 1;
    if (iteration > 0) {
      mju_sub(p, next, g, n);
      mju_sub(q, change, jar, n);
      step = LineSearch(problem, g, jar, p, q);
    }
    last = -1;
    if (step == 1) {  // to the bit what these free rows give, wherever it started
      std::swap(g, next);
      std::swap(jar, change);
      last = size;
      std::copy_n(free, size, before);
    } else {
      mju_addToScl(g, p, step, n);
      mju_addToScl(jar, q, step, n);
    }
  }
  for (int i = 0; i < count; i++) AddForces(groups[i], Load(g + kLanes * i), half);
  FreeStack(d);
  return solved;
}

// a = L⁻¹ D^(−½) half of an island's degrees of freedom into d->qacc_warmstart, unless it is not finite.
void WriteStart(const mjModel* m, mjData* d, const Island& island, const double* half, const double* sqrt_inverse) {
  for (int k = 0; k < island.dofs; k++) {
    if (!std::isfinite(half[island.Dof(k)])) return;
  }
  Dispatch([&]<typename V>() MJFRAMES_KERNEL {
    for (int k = 0; k < island.dofs; k++) {
      const int dof = island.Dof(k);
      d->qacc_warmstart[dof] = sqrt_inverse[dof] * half[dof] - SumAbove(m, d, dof, d->qacc_warmstart);
    }
  });
}

// Sorts groups by their islands: those of island i are members[first[i]] up to members[first[i + 1]], in their order.
// first: memory (islands + 2).
void SortByIsland(const mjData* d, const RowGroup* groups, int count, int islands, int* first, int* members) {
  const auto island_of = [&](int i) { return d->nisland > 0 ? d->efc_island[groups[i].row] : 0; };
  std::fill_n(first, islands + 2, 0);
  for (int i = 0; i < count; i++) first[island_of(i) + 2]++;
  for (int i = 0; i < islands; i++) first[i + 2] += first[i + 1];
  for (int i = 0; i < count; i++) members[first[island_of(i) + 1]++] = i;
}

// How many numbers WriteStarts takes of the stack, for so many groups.
size_t StartsSize(const mjModel* m, const mjData* d, int count) {
  return 4 * m->nv + count + d->nisland + 3 + m->ntree + ActuationSize(m);
}

// From the groups of all rows of the islands that are taken.
void WriteStarts(const mjModel* m, mjData* d, const RowGroup* groups, int count, const double* sqrt_inverse) {
  const int nv = m->nv, islands = std::max(1, d->nisland);
  double *smooth = mj_stackAllocNum(d, nv), *half = mj_stackAllocNum(d, nv);
  double *left = mj_stackAllocNum(d, nv), *work = mj_stackAllocNum(d, nv);
  int *members = mj_stackAllocInt(d, count), *first = mj_stackAllocInt(d, islands + 2);
  int* first_of_tree = mj_stackAllocInt(d, m->ntree);
  SortByIsland(d, groups, count, islands, first, members);
  std::fill_n(first_of_tree, m->ntree, -1);
  SmoothForce(m, d, smooth);
  mj_referenceConstraint(m, d);
  mj_mulJacVec(m, d, d->efc_b, d->qacc_warmstart);
  mju_subFrom(d->efc_b, d->efc_aref, d->nefc);
  mj_solveM2(m, d, half, smooth, sqrt_inverse, 1);
  for (int number = 0; number < islands; number++) {
    const int *member = members + first[number], size = first[number + 1] - first[number];
    if (size == 0) continue;
    const Island island = IslandOf(m, d, number);
    if (IsSolved(m, d, island, groups, member, size, half, sqrt_inverse, left, work)) continue;
    if (SolveIsland(m, d, island, groups, member, size, half, first_of_tree, work)) {
      WriteStart(m, d, island, half, sqrt_inverse);
    }
  }
}

// Has MuJoCo find the accelerations of all degrees of freedom, as it will after this stage; a: those of the smooth
// forces before, NaN where it cannot. d->qacc_warmstart stays: with these in it a step would depend on what was looked
// at before.
void SolveByMujoco(const mjModel* m, mjData* d, const double* smooth, double* a) {
  const size_t nv = m->nv, rows = d->nefc;
  if (m->opt.solver == mjSOL_PGS || d->efm_active || !HasRoom(d, (nv + rows) * (nv + kSolverArrays))) {
    std::fill_n(a, nv, std::numeric_limits<double>::quiet_NaN());
    return;
  }
  mju_copy(d->qfrc_smooth, smooth, m->nv);
  mju_copy(d->qacc_smooth, a, m->nv);
  mj_referenceConstraint(m, d);
  mj_fwdConstraint(m, d);
  mju_copy(a, d->qacc, m->nv);
}

}  // namespace

bool IsInverse(const mjData* d) { return d->nisland == 0 && d->pbase != 0; }

bool Starts(const mjModel* m, const mjData* d) {
  if (IsInverse(d)) return false;
  if (m->opt.solver == mjSOL_PGS || (m->opt.disableflags & mjDSBL_WARMSTART)) return false;
  if (d->efm_active) return false;
  return std::none_of(d->efc_type, d->efc_type + d->nefc, [](int type) { return type == mjCNSTR_CONTACT_ELLIPTIC; });
}

void Foresee(const mjModel* m, mjData* d, bool starts, double* a) {
  MarkStack(d);
  double* smooth = mj_stackAllocNum(d, m->nv);
  SmoothForce(m, d, smooth);
  mj_solveM(m, d, a, smooth, 1);
  bool known = d->nefc == 0 || starts;
  for (int island = 0; known && d->nefc > 0 && island < std::max(1, d->nisland); island++) {
    known = IsTaken(m, d, island);
  }
  if (!known) SolveByMujoco(m, d, smooth, a);
  for (int k = 0; known && d->nefc > 0 && k < m->nv; k++) {
    if (d->nisland == 0 || d->dof_island[k] >= 0) a[k] = d->qacc_warmstart[k];
  }
  FreeStack(d);
}

ConstraintRows::ConstraintRows(const mjModel* m, std::vector<char> marked)
    : inertia_(m, std::move(marked)), dof_(m->nv), y_(kLanes * m->nv) {}

bool ConstraintRows::Finish(const mjModel* m, mjData* d, const ContactDents* dents, const double* lies, bool starts) {
  if (d->nefc == 0) return true;
  inertia_.Start(m, d);
  MarkStack(d);
  starts = starts && HasRoom(d, d->nefc * sizeof(RowGroup) / sizeof(mjtNum));
  RowGroup* groups = nullptr;
  if (starts) groups = static_cast<RowGroup*>(mj_stackAllocByte(d, d->nefc * sizeof(RowGroup), alignof(RowGroup)));
  int count = 0;
  for (int first = 0, together = 0; first < d->nefc; first += together) {
    together = RowsTogether(m, d, first);
    for (int row = first; row < first + together; row += kLanes) {
      RowGroup group = inertia_.Find(m, d, row, std::min(kLanes, first + together - row));
      const bool sets = row == first && (group.marked || TouchesSoft(m, d, row));
      starts = starts && HasRoom(d, (kLanes + 1) * group.size);
      const bool keeps = starts && IsTaken(m, d, d->nisland > 0 ? d->efc_island[row] : 0);
      if (!keeps && !sets) continue;
      group.dof = keeps ? mj_stackAllocInt(d, group.size) : dof_.data();
      group.y = keeps ? mj_stackAllocNum(d, kLanes * group.size) : y_.data();
      inertia_.Solve(m, d, &group);
      if (sets) SetResistances(m, d, lies, group);
      if (keeps) groups[count++] = group;
    }
  }
  const bool dented = !dents || SetDents(m, d, dents);
  if (starts && count > 0 && HasRoom(d, StartsSize(m, d, count)))
    WriteStarts(m, d, groups, count, inertia_.sqrt_inverse().data());
  FreeStack(d);
  return dented;
}

}  // namespace mjframes
