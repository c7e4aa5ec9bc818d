// What a picture shows of dents: vertices of a skin, which MuJoCo moves with the frames, moved on by the dents. With
// the forces f_j along the normals n_j of the contacts that are there (dents.h)
//
//   u(x) = −Σ_j c(|x − x_j|) f_j n_j,   n_j out of the flesh
// What a geom would still cover then, no deeper than it touches, comes out of it by the shortest way: a few contacts
// stand for a flat face, which is flush with the flesh below it.
//
// Python calls this function by its name (mjframes/app/dented.py); a step does not need it.

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cstddef>
#include <map>
#include <vector>

#include "constants.h"
#include "contact.h"
#include "geom_distance.h"
#include "linear.h"
#include "patch_field.h"
#include "soft_body.h"

using namespace mjframes;

namespace {

// deepest: distance of the deepest contact with that geom [m].
void BringOut(const GeomQuery& query, double deepest, float* vertex, int count) {
  for (float* p = vertex; p != vertex + 3 * static_cast<ptrdiff_t>(count); p += 3) {
    Vec3 normal;
    const double distance = query.Distance({p[0], p[1], p[2]}, &normal);
    if (!(distance < 0 && distance > kCovered * deepest)) continue;
    for (int a = 0; a < 3; a++) p[a] -= static_cast<float>(distance * normal[a]);
  }
}

}  // namespace

// Moves vertices (count × 3) of the skin of the soft body of this plugin instance [m]. Returns how many contacts dent
// it.
extern "C" __attribute__((visibility("default"))) int MjframesDentSkin(const mjModel* m, const mjData* d, int instance,
                                                                       float* vertex, int count) {
  TouchSearch search(m, d);
  std::vector<ContactDents> all(d->ncon);
  const SoftBody* body = nullptr;
  for (int c = 0; c < d->ncon; c++) {
    const bool touches = d->contact[c].efc_address >= 0 && search.Find(c) && search.touch();
    if (!touches) continue;
    all[c] = TouchDents(search.side(), *search.touch());
    for (int s = 0; s < 2; s++) {
      if (SoftInstanceOf(m, d->contact[c].geom[s]) == instance) body = search.side()[s].body;
    }
  }
  std::vector<int> last(m->nplugin);
  Squeeze(m, d, all.data(), &last);
  int dented = 0;
  std::map<int, double> rigid;  // distance of the deepest contact with each geom
  for (int c = 0; c < d->ncon; c++) {
    const mjContact& contact = d->contact[c];
    const ContactDents& dents = all[c];
    for (int s = 0; s < 2; s++) {
      if (!(dents.side[s].softness > 0) || SoftInstanceOf(m, contact.geom[s]) != instance) continue;
      mjtNum force[6];
      mj_contactForce(m, d, c, force);
      // after mj_step1 alone there are forces of no meaning: none makes a dent deeper than the contact
      const double push = std::min(force[0], -contact.dist / DentOfForce(dents, dents.side[s], 0));
      if (!(push > 0)) continue;
      const Vec3 out = (s == 0 ? 1 : -1) * ToVec3(contact.frame);   // the normal points to the second geom
      const Vec3 centre = dents.centre - 0.5 * contact.dist * out;  // where the surface is without the dent
      dented++;
      if (const int other = contact.geom[1 - s]; SoftInstanceOf(m, other) < 0) {
        rigid[other] = std::min(rigid[other], contact.dist);
      }
      for (int i = 0; i < count; i++) {
        float* p = vertex + 3 * i;
        const Vec3 offset = Vec3{p[0], p[1], p[2]} - centre;
        const double dent = push * DentOfForce(dents, dents.side[s], Norm(offset));
        for (int a = 0; a < 3; a++) p[a] -= static_cast<float>(dent * out[a]);
      }
    }
  }
  for (const auto& [geom, deepest] : rigid) {
    const GeomQuery query(m, d, body->contact().meshes(), geom, 0);
    if (query.valid) BringOut(query, deepest, vertex, count);
  }
  return dented;
}
