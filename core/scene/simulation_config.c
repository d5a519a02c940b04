#include "scene/simulation_config.h"

#include <math.h>

region_material region_defaults(void) {
    return (region_material){.youngs_modulus = 30e3, .poisson_ratio = 0.45, .cutting_force = 0.4, .cutting_viscosity = 1.0, .spreading_force = 0.0,
                             .friction_static = 12.0, .friction_kinetic = 7.0, .friction_viscous = 100.0};
}

membrane_material membrane_defaults(void) { return (membrane_material){.stiffness = 0.0, .poisson_ratio = 0.45}; }

sliding_material sliding_defaults(void) { return (sliding_material){.normal = 1e9}; }
calcification calcification_defaults(void) { return (calcification){.centre = v3(NAN, NAN, NAN), .cutting_factor = 5.0}; }

void simulation_defaults(simulation_config *config) {
    *config = (simulation_config){
        .mesh_unit = 1.0,
        .needle = {.length = 0.2, .outer_diameter = 1.27e-3, .inner_diameter = 0.84e-3, .youngs_modulus = 200e9,
                   .poisson_ratio = 0.3, .bow = 1e-5, .bevel_slope = 0.0, .segments = 40},
        .needle_count = 1,
        .seeds = {.length = 4.5e-3, .diameter = 0.8e-3, .spacing = 10e-3},
        .probe = {.shape = {.radius = 10e-3, .tip_radius = 10e-3, .length = 0.15}, .max_force = 35.0, .start = {v3(NAN, NAN, NAN), {1, 0, 0, 0}}},
        .insertion = {.contact_spacing = 2e-3, .weakening_distance = 1e-3, .prefetch_distance = 15e-3, .longest_step = 1e-3,
                      .most_steps = 4, .track_reach = 1.0, .track_angle = 0.09, .max_passes = 8, .tolerance = 1e-8,
                      .bone_compliance = 8e-5, .surface_friction = 0.5, .gradient_span = 5e-3},
        .inverse = INVERSE_AUTO,
        .volumetric = STRAIN_BY_PATCH,
    };
}

int simulation_moduli(simulation_config *config, double *moduli[MAX_MODULI]) {
    int count = 0;
    for (int i = 0; i < config->region_count; i++) {
        moduli[count++] = &config->regions[i].material.youngs_modulus;
        moduli[count++] = &config->regions[i].material.stiffening;
    }
    for (int i = 0; i < config->membrane_count; i++) moduli[count++] = &config->membranes[i].material.stiffness;
    return count;
}
