// The hyperelastic laws by name.

#ifndef MJFRAMES_PLUGIN_LAWS_LAWS_H_
#define MJFRAMES_PLUGIN_LAWS_LAWS_H_

#include <optional>
#include <string_view>

#include "arruda_boyce.h"
#include "green_lagrange.h"
#include "law.h"
#include "mooney_rivlin.h"
#include "neo_hookean.h"

namespace mjframes {

enum class Law { kGreenLagrange, kNeoHookean, kMooneyRivlin, kArrudaBoyce };

inline constexpr int kLawConstants = 3;  // of a material, as the attributes give them

inline std::optional<Law> LawOfName(std::string_view name) {
  if (name == "green_lagrange") return Law::kGreenLagrange;
  if (name == "neo_hookean") return Law::kNeoHookean;
  if (name == "mooney_rivlin") return Law::kMooneyRivlin;
  if (name == "arruda_boyce") return Law::kArrudaBoyce;
  return std::nullopt;
}

// constants: (μ, –, K), (μ, –, K), (c₁₀, c₀₁, K) or (μ, N, K); [Pa], N [-], – unused.
inline LawParameters ParametersOf(Law law, const double* constants) {
  switch (law) {
    case Law::kGreenLagrange:
      return green_lagrange::Parameters(constants[0], constants[2]);
    case Law::kNeoHookean:
      return neo_hookean::Parameters(constants[0], constants[2]);
    case Law::kMooneyRivlin:
      return mooney_rivlin::Parameters(constants[0], constants[1], constants[2]);
    case Law::kArrudaBoyce:
      return arruda_boyce::Parameters(constants[0], constants[1], constants[2]);
  }
  return {};
}

inline Stretch Respond(Law law, const LawParameters& p, double i1) {
  switch (law) {
    case Law::kGreenLagrange:
      return green_lagrange::Respond(p, i1);
    case Law::kNeoHookean:
      return neo_hookean::Respond(p, i1);
    case Law::kMooneyRivlin:
      return mooney_rivlin::Respond(p, i1);
    case Law::kArrudaBoyce:
      return arruda_boyce::Respond(p, i1);
  }
  return {};
}

// ψ(F) [J/m³], 0 at rest.
inline double EnergyDensity(Law law, const LawParameters& p, double i1, double i2, double j) {
  return Respond(law, p, i1).value + p.second * (i2 - 3) + (0.5 * p.volume * (j - 1) - p.linear) * (j - 1);
}

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_LAWS_LAWS_H_
