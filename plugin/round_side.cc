#include "round_side.h"

#include <algorithm>
#include <cmath>

#include "constants.h"
#include "linear.h"
#include "quadric.h"
#include "round_touch.h"
#include "vertices.h"

namespace mjframes {
namespace {

struct Sample {
  Vec3 place;
  double distance;  // of the geom [m]
  bool round, own;  // whether its cluster is round, and of the patch
};

// The vertices of the body around a place, as far as (1 + kRoundStray) ρ.
struct Samples {
  // False where there are too many.
  bool Gather(const GeomQuery& query, const Placed& soft, const Vec3& place, double rho) {
    const std::vector<Patch>& patches = soft.deformed.contact().patches;
    const double reach = (1 + kRoundStray) * rho;
    middle = place;
    count = 0;
    for (int k = 0; k < static_cast<int>(patches.size()); k++) {
      const AlignedBox& box = soft.state->VertexBox(k);
      Vec3 off;
      for (int i = 0; i < 3; i++) off[i] = std::max(0.0, std::abs(place[i] - box.centre[i]) - box.half[i]);
      if (Dot(off, off) > reach * reach) continue;
      const double* vertices = soft.state->Vertices(k);
      int s = 0;
      for (size_t c = 0; c < patches[k].cluster.size(); c++) {
        const bool round = patches[k].volume.round[c];
        for (const int end = s + patches[k].cluster[c]; s < end; s++) {
          const Vec3 p = Vertex(vertices, patches[k].vertices, s), offset = p - place;
          if (!(Dot(offset, offset) < reach * reach)) continue;
          if (count == kRoundSamples) return false;
          all[count++] = {p, query.Distance(p, nullptr), round, round && k == soft.number};
        }
      }
    }
    return true;
  }

  // Whether all within ρ of a place are there.
  bool Cover(const Vec3& place, double rho) const { return Norm(place - middle) < kRoundStray * rho; }

  // Whether the nearest round one to a place is the patch's, or nearly so.
  bool AreOwn(const Vec3& place, double rho) const {
    double nearest[2] = {mjMAXVAL, mjMAXVAL};
    for (const Sample* one = all; one != all + count; one++) {
      if (one->round) nearest[one->own] = std::min(nearest[one->own], Norm(one->place - place));
    }
    return nearest[1] < nearest[0] + kRoundTie * rho;
  }

  // visit(sample, its offset [ρ], its weight) for all within ρ of a place.
  template <class Visit>
  void Around(const Vec3& place, double rho, const Visit& visit) const {
    for (const Sample* one = all; one != all + count; one++) {
      const Vec3 offset = (1 / rho) * (one->place - place);
      const double left = 1 - Dot(offset, offset);
      if (left > 0) visit(*one, offset, left * left);
    }
  }

  // How much of what is around a place is round: 1 on its border, 0 some way beyond.
  double Roundness(const Vec3& place, double rho) const {
    double total = 0, round = 0;
    Around(place, rho, [&](const Sample& one, const Vec3&, double weight) {
      total += weight;
      if (one.round) round += weight;
    });
    return total > 0 ? std::min(1.0, 2 * round / total) : 0;
  }

  Vec3 middle{};
  Sample all[kRoundSamples];
  int count = 0;
};

// Of their distances, in units of ρ.
Quadric FitAround(const Samples& samples, const Vec3& place, const Tangents& tangent, double rho) {
  Quadric quadric;
  samples.Around(place, rho, [&](const Sample& one, const Vec3& offset, double weight) {
    quadric.Add(Dot(offset, tangent.x), Dot(offset, tangent.y), one.distance / rho, weight);
  });
  return quadric;
}

// How far material of that slope is a ball that rolls: 1, and 0 where it is squeezed so flat that a point of it may
// turn much faster than it rolls.
double Rolls(const Mat3& slope) {
  double square = 0;
  for (const double entry : slope) square += entry * entry;
  const double even = Det(slope) / std::max(mjMINVAL, std::pow(square / 3, 1.5));  // 1 for a turn, at any size
  return std::clamp((even - kFlatSlope) / (kRoundSlope - kFlatSlope), 0.0, 1.0);
}

}  // namespace

double RoundReach(const ContactModel& contact) { return kRoundReach * contact.round_spacing; }

RoundPlace RoundSide(const GeomQuery& query, const Placed& soft, const Vec3& start, const Vec3& xi, Touch* out) {
  *out = {0, {}, {}, -1, 0, 0, 0, 0, xi};
  const ContactModel& contact = soft.deformed.contact();
  const double rho = RoundReach(contact);
  Vec3 place = start;
  Samples samples;
  double curvature = 0, rough = 0;
  for (int i = 0; i < kRoundSteps; i++) {
    if ((i == 0 || !samples.Cover(place, rho)) && !samples.Gather(query, soft, place, rho)) return {place};
    const double distance = query.Distance(place, &out->normal);
    const Tangents tangent(out->normal);
    Quadric fit = FitAround(samples, place, tangent, rho);
    if (!fit.Fit()) return {place};
    // along an axis without curvature it stays
    const double angle = fit.Angle();
    const Vec3 axis[2] = {std::cos(angle) * tangent.x + std::sin(angle) * tangent.y,
                          std::cos(angle) * tangent.y - std::sin(angle) * tangent.x};
    const double slope[2] = {std::cos(angle) * fit.c[1] + std::sin(angle) * fit.c[2],
                             std::cos(angle) * fit.c[2] - std::sin(angle) * fit.c[1]};
    Vec3 step{};
    for (int a = 0; a < 2; a++) {
      const double bent = fit.Curvature(a);
      step = step - (slope[a] / (std::max(bent, 0.0) + kRoundEven)) * axis[a];
      out->radius[a] = static_cast<float>(bent > kRoundEven ? rho / bent : 0);
    }
    for (int c = 0; c < 3; c++) out->axis[c] = static_cast<float>(axis[0][c]);
    step = (1 / std::max(1.0, 2 * Norm(step))) * step;
    out->distance = rho * fit.At(Dot(step, tangent.x), Dot(step, tangent.y));
    rough = fit.Roughness();
    curvature = std::max(0.0, 0.5 * (fit.Curvature(0) + fit.Curvature(1)) / rho);
    place = place + rho * step + (out->distance - distance) * out->normal;
    if (Norm(step) < kRoundStays) break;
  }
  RoundPlace found{place};
  found.own = samples.AreOwn(place, rho);
  out->normal = query.Normal(place);
  out->position = place - 0.5 * out->distance * out->normal;
  const double widest = kWidest * contact.round_spacing;
  const double radius = std::sqrt(std::max(0.0, -out->distance) / std::max(curvature, mjMINVAL));
  const double uneven = std::clamp((rough - kSmooth) / (kUneven - kSmooth), 0.0, 1.0);
  found.wide = std::max({std::clamp(radius / widest - 1, 0.0, 1.0), 1 - samples.Roundness(place, rho), uneven});
  SpreadPressure(curvature, widest, out);
  return found;
}

double RollingLift(const Kinematics& kinematics, const ContactModel& contact, int patch, const mjData* d,
                   double timestep, const Touch& touch, int body) {
  if (!(touch.radius[0] > 0 || touch.radius[1] > 0)) return 0;
  const PatchVolume& volume = contact.patches[patch].volume;
  const Mat3 slope = volume.SlopeOf(kinematics.x().data()), slope_rate = volume.SlopeOf(kinematics.v().data());
  const double rolls = Rolls(slope);
  if (rolls == 0) return 0;
  const Vec3 normal = kinematics.ToLocal(d, touch.normal);
  // −∂N/∂t of the material
  const Vec3 turned = Mul(kinematics.Axes(d), MulT(Inverse(slope), MulT(slope_rate, normal)));
  const Vec3 turn = turned + Cross(ToVec3(d->cvel + 6 * static_cast<ptrdiff_t>(body)), touch.normal);
  const Vec3 axis = {touch.axis[0], touch.axis[1], touch.axis[2]};
  const double rate[2] = {Dot(axis, turn), Dot(Cross(touch.normal, axis), turn)};
  const double fastest = RoundReach(contact) / timestep;
  double lift = 0;
  for (int a = 0; a < 2; a++) {
    const double speed = touch.radius[a] * std::abs(rate[a]);
    const double known = std::min(1.0, fastest / std::max(mjMINVAL, speed));
    lift += known * known * speed * std::abs(rate[a]);
  }
  return rolls * lift;
}

}  // namespace mjframes
