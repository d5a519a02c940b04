#include "replay/region_motion.h"

#include <stdbool.h>
#include <stdlib.h>

static vec3 mean(int count, const vec3 *points) {
    vec3 sum = v3(0, 0, 0);
    for (int i = 0; i < count; i++) sum = v3_add(sum, points[i]);
    return v3_scale(1.0 / count, sum);
}

static void add_outer_product(mat3 *sum, vec3 a, vec3 b) {
    const double left[3] = {a.x, a.y, a.z}, right[3] = {b.x, b.y, b.z};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) sum->m[i][j] += left[i] * right[j];
}

/* Computes the orthogonal polar factor of a matrix with positive determinant, by iterating X <- (X + X^-T) / 2. */
static mat3 polar_factor(mat3 x) {
    double scale = cbrt(m3_determinant(&x));
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) x.m[i][j] /= scale;
    double change = 1.0;
    for (int pass = 0; pass < 100 && change > 1e-14; pass++) {
        mat3 inverse = m3_inverse(&x), next = m3_transposed(&inverse);
        change = 0.0;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double half = 0.5 * (next.m[i][j] - x.m[i][j]);
                x.m[i][j] += half;
                change = fmax(change, fabs(half));
            }
    }
    return x;
}

static vec3 rotation_vector(const mat3 *r) {
    vec3 axis = v3(r->m[2][1] - r->m[1][2], r->m[0][2] - r->m[2][0], r->m[1][0] - r->m[0][1]);
    double sine = 0.5 * v3_norm(axis), cosine = 0.5 * (r->m[0][0] + r->m[1][1] + r->m[2][2] - 1.0);
    return v3_scale(sine > 1e-12 ? 0.5 * atan2(sine, cosine) / sine : 0.5, axis);
}

rigid_motion rigid_motion_fit(int count, const vec3 *from, const vec3 *displacement) {
    rigid_motion motion = {.shift = mean(count, displacement)};
    vec3 centre = mean(count, from);
    mat3 covariance = {{{0}}};
    double spread = 0.0;
    for (int i = 0; i < count; i++) {
        vec3 arm = v3_sub(from[i], centre);
        add_outer_product(&covariance, v3_add(arm, v3_sub(displacement[i], motion.shift)), arm);
        spread += v3_dot(arm, arm);
    }
    if (!(m3_determinant(&covariance) > 1e-9 * spread * spread * spread)) return motion;
    mat3 rotation = polar_factor(covariance);
    motion.turn = rotation_vector(&rotation);
    return motion;
}

/* Lists the nodes of all tetrahedra in the region and its parts. */
static trocar_status find_nodes(const trocar_model *model, int region, region_motion *motion, trocar_error *why) {
    int node_count = trocar_model_node_count(model), tet_count = trocar_model_tet_count(model);
    bool *inside = calloc((size_t)node_count, sizeof *inside);
    motion->nodes = malloc((size_t)node_count * sizeof *motion->nodes);
    if (inside && motion->nodes) {
        for (int t = 0; t < tet_count; t++) {
            int own = trocar_model_tet_regions(model)[t];
            for (int i = 0; i < 4 && (own == region || trocar_model_part_of(model, own) == region); i++) inside[trocar_model_tets(model)[4 * t + i]] = true;
        }
        for (int n = 0; n < node_count; n++)
            if (inside[n]) motion->nodes[motion->count++] = n;
    }
    free(inside);
    return motion->count > 0 ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory to find a region's nodes");
}

trocar_status region_motion_create(const trocar_model *model, const char *region, region_motion *motion, trocar_error *why) {
    *motion = (region_motion){0};
    int found = trocar_model_find_region(model, region, 3);
    if (found < 0) return fail(why, TROCAR_BAD_INPUT, "the mesh has no region \"%s\"", region);
    trocar_status status = find_nodes(model, found, motion, why);
    size_t count = (size_t)motion->count;
    motion->from = malloc(count * sizeof *motion->from);
    motion->displacement = malloc(count * sizeof *motion->displacement);
    if (status == TROCAR_OK && !(motion->from && motion->displacement))
        status = fail(why, TROCAR_NO_MEMORY, "no memory to follow %zu nodes", count);
    if (status != TROCAR_OK) {
        region_motion_free(motion);
        return status;
    }
    for (int i = 0; i < motion->count; i++) {
        const double *at = trocar_model_nodes(model) + 3 * motion->nodes[i];
        motion->from[i] = v3(at[0], at[1], at[2]);
    }
    return TROCAR_OK;
}

void region_motion_free(region_motion *motion) {
    free(motion->nodes);
    free(motion->from);
    free(motion->displacement);
    *motion = (region_motion){0};
}

rigid_motion region_motion_of(region_motion *motion, const double *displacements) {
    for (int i = 0; i < motion->count; i++) {
        const double *u = displacements + 3 * motion->nodes[i];
        motion->displacement[i] = v3(u[0], u[1], u[2]);
    }
    return rigid_motion_fit(motion->count, motion->from, motion->displacement);
}
