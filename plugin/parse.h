// Reading and validation of what a plugin instance says of its soft body.

#ifndef MJFRAMES_PLUGIN_PARSE_H_
#define MJFRAMES_PLUGIN_PARSE_H_

#include <mujoco/mujoco.h>

#include <memory>

#include "attributes.h"
#include "soft_model.h"

namespace mjframes {

// What they mean is in README.md.
inline constexpr const char* kSoftAttributes[] = {
    "version",
    "law",
    "mode",
    "alpha",
    "beta",
    "carrier_size",
    "carrier_point",
    "point_offset",
    "point_rest",
    "point_mass",
    "point_branch",
    "region_size",
    "region_point",
    "region_gradient",
    "region_stiffness",
    "region_stiffens",
    "materials",
    "region_own",
    "region_share",
    "law_constants",
    "law_factor",
    "quadrature_count",
    "quadrature_volume",
    "quadrature_material",
    "quadrature_gradient",
    "cell_count",
    "cell_volume",
    "cell_material",
    "cell_slope",
    "region_mass",
    "region_enlargement",
    "contact_reach",
    "patch_size",
    "patch_clusters",
    "patch_cluster_size",
    "patch_point",
    "patch_weight",
    "patch_offset",
    "patch_dent",
    "patch_factor",
    "lattice_spacing",
    "lattice_axes",
    "lattice_origin",
    "lattice_shape",
    "lattice_node",
    "lattice_distance",
    "lattice_patch",
    "lattice_set",
    "set_size",
    "set_point",
    "lattice_weight",
    "lattice_vertex",
    "lattice_normal",
    "asset",
};

// The model of instance `instance`, the same for all who ask while anyone keeps it. What is wrong is told to `reader`,
// and then there is none.
std::shared_ptr<const SoftModel> FindModel(const mjModel* m, int instance, Reader* reader);

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_PARSE_H_
