// The laws and a region on quadrature points as C functions, for ctypes.

#include <vector>

#include "hessian.h"
#include "quadrature.h"
#include "svd.h"

using namespace mjframes;

namespace {

constexpr double kTetrahedron[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};

}  // namespace

#define EXPORT extern "C" __attribute__((visibility("default")))

// A region of its own for each of n deformation gradients F: energies, P and projected ∂P/∂F (n × 9 × 9).
EXPORT int respond(const char* name, const double* constants, int n, const double* F, double* energy, double* cauchy,
                   double* P, double* hessian) {
  const auto law = LawOfName(name);
  if (!law) return -1;
  const LawParameters material = ParametersOf(*law, constants);
  // x(p) = x₀ + F p on a tetrahedron: force j > 0 is −P's column j − 1
  double gradient[4][3] = {{-1, -1, -1}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  const double volume = 1;
  std::vector<int32_t> pair(10);
  for (int i = 0; i < 10; i++) pair[i] = i;
  const std::vector<QuadratureRegion> regions(
      1, QuadratureRegion(*law, {0, 1, 2, 3}, gradient[0], &volume, &material, 1, pair, {0}));
  QuadratureScratch scratch(regions);
  for (int i = 0; i < n; i++, F += 9) {
    Vec3 x[4], force[4] = {};
    for (int j = 0; j < 4; j++) {
      for (int r = 0; r < 3; r++) {
        x[j][r] = 5 + r;
        for (int a = 0; a < 3; a++) x[j][r] += F[3 * r + a] * kTetrahedron[j][a];
      }
    }
    AddQuadrature(regions, x, &scratch, force, nullptr);
    for (int r = 0; r < 3; r++) {
      for (int a = 0; a < 3; a++) P[9 * i + 3 * r + a] = -force[a + 1][r];
    }
    const LawParameters materials[kLanes] = {material, material, material, material};
    Lanes side[9], H[81];
    for (int e = 0; e < 9; e++) side[e] = Fill(F[e]);
    ProjectedHessian(side, SlopesOf(*law, materials, InvariantsOf(side)), H);
    for (int e = 0; e < 81; e++) hessian[81 * i + e] = H[e][0];
    PointState state;
    QuadratureStates(regions[0], x, &scratch, &state);
    energy[i] = state.energy;
    for (int e = 0; e < 9; e++) cauchy[9 * i + e] = state.cauchy[e];
  }
  return 0;
}

// One region: energy, force (points × 3) and, unless null, pair_stiffness (pairs × 9), added to what is there.
EXPORT double region(const char* name, const double* constants, const int32_t* constants_of, int m,
                     const int32_t* point, int q, const double* gradient, const double* volume, const int32_t* pair,
                     const double* x, double* force, double* pair_stiffness) {
  const auto law = LawOfName(name);
  if (!law) return -1;
  std::vector<LawParameters> material;
  for (int i = 0; i < q; i++) material.push_back(ParametersOf(*law, constants + kLawConstants * constants_of[i]));
  const std::vector<QuadratureRegion> regions(
      1, QuadratureRegion(*law, {point, point + m}, gradient, volume, material.data(), q,
                          {pair, pair + m * (m + 1) / 2}, std::vector<int32_t>(q, 0)));
  QuadratureScratch scratch(regions);
  const Vec3* positions = reinterpret_cast<const Vec3*>(x);
  AddQuadrature(regions, positions, &scratch, reinterpret_cast<Vec3*>(force), pair_stiffness);
  return QuadratureEnergy(regions, 0, positions, &scratch);
}

// F = U diag(σ) Vᵀ of n matrices, n a multiple of four.
EXPORT void signed_svd(int n, const double* F, double* U, double* sigma, double* V) {
  for (int i = 0; i < n; i += kLanes) {
    Lanes f[9], u[9], s[3], v[9];
    for (int lane = 0; lane < kLanes; lane++) {
      for (int e = 0; e < 9; e++) f[e][lane] = F[9 * (i + lane) + e];
    }
    SignedSvd(f, u, s, v);
    for (int lane = 0; lane < kLanes; lane++) {
      for (int e = 0; e < 9; e++) {
        U[9 * (i + lane) + e] = u[e][lane];
        V[9 * (i + lane) + e] = v[e][lane];
      }
      for (int e = 0; e < 3; e++) sigma[3 * (i + lane) + e] = s[e][lane];
    }
  }
}
