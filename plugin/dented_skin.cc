// What a picture shows of dents: vertices of a skin, which MuJoCo moves with the frames, moved on by the dents. With
// the forces f_j along the normals n_j of the contacts that are there (dents.h)
//
//   u(x) = −Σ_j c(|x − x_j|) f_j n_j,   n_j out of the flesh
//
// Python calls this function by its name (mjframes/app/dented.py); a step does not need it.

#include <mujoco/mujoco.h>

#include <algorithm>
#include <vector>

#include "contact.h"
#include "linear.h"
#include "patch_field.h"

using namespace mjframes;

// Moves vertices (count × 3) of the skin of the soft body of this plugin instance [m]. Returns how many contacts dent
// it.
extern "C" __attribute__((visibility("default"))) int MjframesDentSkin(const mjModel* m, const mjData* d, int instance,
                                                                       float* vertex, int count) {
  TouchSearch search(m, d);
  std::vector<ContactDents> all(d->ncon);
  for (int c = 0; c < d->ncon; c++) {
    const bool touches = d->contact[c].efc_address >= 0 && search.Find(c) && search.touch();
    if (touches) all[c] = TouchDents(search.side(), *search.touch());
  }
  std::vector<int> last(m->nplugin);
  Squeeze(m, d, all.data(), &last);
  int dented = 0;
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
      for (int i = 0; i < count; i++) {
        float* p = vertex + 3 * i;
        const Vec3 offset = Vec3{p[0], p[1], p[2]} - centre;
        const double dent = push * DentOfForce(dents, dents.side[s], Norm(offset));
        for (int a = 0; a < 3; a++) p[a] -= static_cast<float>(dent * out[a]);
      }
    }
  }
  return dented;
}
