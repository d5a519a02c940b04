#include "insertion/local_compliance.h"

#include <stdlib.h>

static const double LEAST_LOGARITHM = 0.02; /* keeps contacts apart where the mesh resolves the needle's surface by itself */
static const double EMBEDDING_DEPTH = 4.0;  /* radii below the surface at which a disc's surroundings are those in the depth */
static const double DENSITY = 1050.0;       /* kg/m^3, soft tissue */
static const double BONE_COMPLIANCE = 8e-5; /* m/N under the tip: stiffer than haptic devices render, and with its sliding below 0.1 mm/N */

/* ---- model ---------------------------------------------------------------------------------------------------------- */

static void add_moduli(insertion_model *model, int node, const region_material *material) {
    double nu = material->poisson_ratio, mu = shear_modulus(material->youngs_modulus, nu);
    lateral_axial line = local_line_stiffness(material);
    model->node_lateral[node] += 1.0 / line.lateral;
    model->node_axial[node] += 1.0 / line.axial;
    model->node_disc[node] += (3.0 - 4.0 * nu) / (32.0 * mu * (1.0 - nu));
    model->node_softness[node] += 1.0 / mu;
    model->node_stiffening[node] += material->stiffening;
    model->node_punch[node] += (1.0 - 2.0 * nu) / (4.0 * mu * log(3.0 - 4.0 * nu));
}

/* A surface that is never punctured is bone: at the surface the tip meets the compliance of bone, and in the tissue in front of it
   less and less compliance, so that the tip stops at the bone and not behind it. */
static void harden_bone(insertion_model *model) {
    const mesh *m = model->mesh;
    double yielding = BONE_COMPLIANCE * model->needle->radius;
    for (int i = 0; i < model->membrane_count; i++) {
        if (!isinf(model->membranes[i].puncture_force)) continue;
        for (int e = 0; e < m->tet_count; e++)
            for (int k = 0; k < 16; k++) { /* faces, and their corners */
                int face = k / 4, node = m->tets[e][k % 4];
                if (k % 4 == face || !(m->face_groups[e][face] >> model->membranes[i].group & 1)) continue;
                model->node_lateral[node] = model->node_disc[node] = model->node_punch[node] = yielding;
                model->node_softness[node] = model->node_stiffening[node] = 0.0;
            }
    }
}

trocar_status local_create(insertion_model *model, report *why) {
    const mesh *m = model->mesh;
    size_t n = (size_t)m->node_count;
    int *count = calloc(n, sizeof *count);
    double *sums = calloc(6 * n, sizeof *sums);
    if (!count || !sums) {
        free(count);
        free(sums);
        return fail(why, TROCAR_NO_MEMORY, "no memory for %zu nodes", n);
    }
    model->stiffens = false;
    model->node_lateral = sums;
    model->node_axial = sums + n;
    model->node_disc = sums + 2 * n;
    model->node_punch = sums + 3 * n;
    model->node_softness = sums + 4 * n;
    model->node_stiffening = sums + 5 * n;
    for (int e = 0; e < m->tet_count; e++)
        for (int c = 0; c < 4; c++) {
            count[m->tets[e][c]]++;
            add_moduli(model, m->tets[e][c], &model->materials[m->region[e]]);
        }
    for (size_t i = 0; i < n; i++) model->stiffens = model->stiffens || model->node_stiffening[i] > 0.0;
    for (size_t i = 0; i < 6 * n; i++) sums[i] /= count[i % n];
    free(count);
    harden_bone(model);
    return TROCAR_OK;
}

void local_free(insertion_model *model) {
    free(model->node_lateral);
    model->node_lateral = model->node_axial = model->node_disc = model->node_punch = model->node_softness = model->node_stiffening = NULL;
}

/* ---- at a point ----------------------------------------------------------------------------------------------------- */

/* A nodal field at a point, continuous across elements. */
static double interpolate(const insertion_model *model, int tet, const double weights[4], const double *field) {
    double sum = 0.0;
    for (int i = 0; i < 4; i++) sum += larger_of(weights[i], 0.0) * field[model->mesh->tets[tet][i]];
    return sum;
}

lateral_axial local_line_compliance_at(const insertion_model *model, int tet, vec3 x) {
    double weights[4];
    mesh_barycentric(model->mesh, tet, x, weights);
    return (lateral_axial){interpolate(model, tet, weights, model->node_lateral), interpolate(model, tet, weights, model->node_axial)};
}

lateral_axial local_logarithm(const insertion_model *model, const resolved_field *resolved) {
    double radius = model->needle->radius;
    return (lateral_axial){larger_of(log(resolved->lateral / radius), LEAST_LOGARITHM), larger_of(log(resolved->axial / radius), LEAST_LOGARITHM)};
}

plane_tensor local_logarithm_across(const insertion_model *model, const resolved_field *resolved, vec3 direction) {
    plane_tensor uneven = plane_part(&resolved->uneven, direction);
    double mean = log(resolved->lateral / model->needle->radius);
    return (plane_tensor){mean + uneven.xx, uneven.xy, mean + uneven.yy};
}

plane_tensor local_logarithm_behind_tip(plane_tensor endless, const line_end *end, double ahead) {
    double more = line_end_at(end, ahead);
    return plane_at_least((plane_tensor){endless.xx + more, endless.xy, endless.yy + more}, LEAST_LOGARITHM);
}

/* 1 / mu */
static double softness(const insertion_model *model, int tet, const double weights[4]) {
    return 2.0 * M_PI * interpolate(model, tet, weights, model->node_axial);
}

double local_wave_speed(const insertion_model *model, int tet, vec3 x) {
    double weights[4];
    mesh_barycentric(model->mesh, tet, x, weights);
    return 1.0 / sqrt(DENSITY * softness(model, tet, weights));
}

/* Tissue yields less around a tip in the depth than around one on the surface. The tip counts as being in the depth once it is a few
   radii below the surface, and deeper than the dent that it presses into it. Over the few radii alone, a needle that has dented the
   skin would meet more force as it cuts on, with elastic energy that comes from nowhere. */
local_disc local_disc_at_tip(const insertion_model *model, int tet, vec3 x, double depth, double pressing) {
    double weights[4], radius = model->needle->radius;
    mesh_barycentric(model->mesh, tet, x, weights);
    double disc = interpolate(model, tet, weights, model->node_disc), punch = interpolate(model, tet, weights, model->node_punch);
    double dent = pressing * punch / radius;
    double in = smaller_of(1.0, depth / (EMBEDDING_DEPTH * radius + dent)); /* from the surface to the end of a hole in the depth */
    double whole = punch + in * 2.0 / 3.0 * (disc - punch);
    return (local_disc){.compliance = whole / radius, .angle = 2.0 * M_PI * (1.0 + in), .softness = interpolate(model, tet, weights, model->node_softness),
                        .stiffening = interpolate(model, tet, weights, model->node_stiffening)};
}

double local_at_tip(const insertion_model *model, int tet, vec3 x, double depth, double pressing, double point) {
    local_disc disc = local_disc_at_tip(model, tet, x, depth, pressing);
    return larger_of(disc.compliance - point * disc.softness, 0.0);
}
