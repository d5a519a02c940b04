#include "insertion/model/local_compliance.h"

#include <stdlib.h>

static const double LEAST_LOGARITHM = 0.02; /* dimensionless: smallest ln(resolved radius / needle radius). Keeps contacts independent where the mesh itself
                                               resolves the needle's surface. Chosen by judgement */
static const double DENSITY = 1050.0; /* kg/m^3: density of soft tissue. It sets the speed of shear waves, which limits how fast tissue springs back. Cited:
                                         ICRU Report 46 (1992), skeletal muscle 1050, average soft tissue 1030 */
static const double GUESSED_LATERAL = 0.42; /* edge lengths: radius that a mesh resolves across the needle; used until it has been measured. Measured: median of
                                               4500 random positions and directions in the meshes of figure8.yaml, implant.yaml and trus.yaml; 9 in 10 are
                                               within a factor of 1.6 */
static const double GUESSED_AXIAL = 0.49; /* edge lengths: radius that a mesh resolves along the needle; used until it has been measured. Measured like
                                             GUESSED_LATERAL */
static const double GUESSED_POINT = 0.14; /* 1 / edge length: compliance of the mesh to a point force, times the shear modulus; used until it has been measured.
                                             Measured like GUESSED_LATERAL */

/* ---- model ---------------------------------------------------------------------------------------------------------- */

static void add_moduli(insertion_model *model, int node, const region_material *material) {
    double nu = material->poisson_ratio, mu = shear_modulus(material->youngs_modulus, nu);
    model->local.disc[node] += (3.0 - 4.0 * nu) / (32.0 * mu * (1.0 - nu));
    model->local.softness[node] += 1.0 / mu;
    model->local.stiffening[node] += material->stiffening;
    model->local.punch[node] += (1.0 - 2.0 * nu) / (4.0 * mu * log(3.0 - 4.0 * nu));
}

/* To a tip that comes from the tissue, a surface that cannot be punctured is bone if it is fixed or has nothing behind it. Between two tissues, or to a tip
   that comes from outside, it is as soft as the tissue. */
static void mark_bone(insertion_model *model) {
    const mesh *m = model->mesh;
    for (int i = 0; i < model->membrane_count; i++) {
        if (!isinf(model->membranes[i].puncture_force)) continue;
        for (int e = 0; e < m->tet_count; e++)
            for (int k = 0; k < 16; k++) { /* four faces, and four corners for each */
                int face = k / 4, node = m->tets[e][k % 4];
                if (k % 4 == face || !(m->face_groups[e][face] >> model->membranes[i].group & 1)) continue;
                if (m->neighbours[e][face] < 0 || model->tissue->fixed[node]) model->local.bone[node] = 1.0;
            }
    }
}

trocar_status local_create(insertion_model *model, trocar_error *why) {
    const mesh *m = model->mesh;
    size_t n = (size_t)m->node_count;
    int *count = calloc(n, sizeof *count);
    double *sums = calloc(5 * n, sizeof *sums);
    if (!count || !sums) {
        free(count);
        free(sums);
        return fail(why, TROCAR_NO_MEMORY, "no memory for %zu nodes", n);
    }
    model->stiffens = false;
    model->local = model->next = (nodal_compliances){.disc = sums, .punch = sums + n, .softness = sums + 2 * n, .stiffening = sums + 3 * n, .bone = sums + 4 * n};
    model->weight = 0.0;
    for (int e = 0; e < m->tet_count; e++)
        for (int c = 0; c < 4; c++) {
            int place = mesh_place(m, m->tets[e][c]); /* nodes at the same place share the mean over both sides, so that it is continuous where tissue slides */
            count[place]++;
            add_moduli(model, place, &model->materials[m->region[e]]);
        }
    for (size_t i = 0; i < n; i++) {
        size_t place = (size_t)mesh_place(m, (int)i);
        for (size_t k = 0; k < 4 && place != i; k++) sums[k * n + i] = sums[k * n + place];
        count[i] = count[place];
    }
    for (size_t i = 0; i < n; i++) model->stiffens = model->stiffens || model->local.stiffening[i] > 0.0;
    for (size_t i = 0; i < 4 * n; i++) sums[i] /= count[i % n];
    free(count);
    mark_bone(model);
    return TROCAR_OK;
}

void local_free(insertion_model *model) {
    free(model->local.disc);
    model->local = model->next = (nodal_compliances){0};
}

/* ---- not measured -------------------------------------------------------------------------------------------------------- */

resolved_field local_resolution_guess(const insertion_model *model, int tet) {
    double size = mesh_edge_length(model->mesh, tet);
    return (resolved_field){.lateral = GUESSED_LATERAL * size, .axial = GUESSED_AXIAL * size, .point = GUESSED_POINT / size};
}

/* ---- at a point ----------------------------------------------------------------------------------------------------- */

/* Interpolates a nodal field at a point. The result is continuous across elements. */
static double interpolate(const insertion_model *model, int tet, const double weights[4], const double *now, const double *next) {
    double sum = 0.0;
    for (int i = 0; i < 4; i++) {
        int node = model->mesh->tets[tet][i];
        sum += larger_of(weights[i], 0.0) * (now[node] + model->weight * (next[node] - now[node]));
    }
    return sum;
}

static double between(double from, double to, double part) { return from + part * (to - from); }

/* Returns the weight of bone, from 0 (tissue) to 1 (bone), for a tip at this depth. Stiffness rises gradually in front of bone, so that the tip stops at the
   bone and not behind it. */
static double bone_at(const insertion_model *model, int tet, const double weights[4], double depth) {
    return smaller_of(1.0, depth / (EMBEDDING_DEPTH * model->needle->radius)) * interpolate(model, tet, weights, model->local.bone, model->next.bone);
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

double local_wave_speed(const insertion_model *model, int tet, vec3 x) {
    double weights[4];
    mesh_barycentric(model->mesh, tet, x, weights);
    return 1.0 / sqrt(DENSITY * interpolate(model, tet, weights, model->local.softness, model->next.softness));
}

/* Tissue around a tip deep inside is stiffer than around a tip on the surface. A tip counts as deep once it is a few radii below the surface and also deeper
   than its dent. If only the radii counted, a needle that has dented the skin would meet more force as it cuts, which would create elastic energy from
   nothing. */
local_disc local_disc_at_tip(const insertion_model *model, int tet, vec3 x, double depth, double push) {
    double weights[4], radius = model->needle->radius;
    mesh_barycentric(model->mesh, tet, x, weights);
    double disc = interpolate(model, tet, weights, model->local.disc, model->next.disc), punch = interpolate(model, tet, weights, model->local.punch, model->next.punch);
    double dent = push * punch / radius;
    double in = smaller_of(1.0, depth / (EMBEDDING_DEPTH * radius + dent)); /* from 0 at the surface to 1 where the tip counts as deep */
    double whole = between(punch, disc, in * 2.0 / 3.0) / radius, bone = bone_at(model, tet, weights, depth);
    return (local_disc){.compliance = between(whole, model->settings.bone_compliance, bone), .angle = 2.0 * M_PI * (1.0 + in),
                        .softness = (1.0 - bone) * interpolate(model, tet, weights, model->local.softness, model->next.softness),
                        .stiffening = (1.0 - bone) * interpolate(model, tet, weights, model->local.stiffening, model->next.stiffening)};
}

double local_at_tip(const insertion_model *model, int tet, vec3 x, double depth, double push, double point) {
    local_disc disc = local_disc_at_tip(model, tet, x, depth, push);
    return larger_of(disc.compliance - point * disc.softness, 0.0);
}
