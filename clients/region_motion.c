#include "region_motion.h"

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

/* Orthogonal factor of a matrix of positive determinant: X <- (X + X^-T) / 2. */
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

trocar_status region_motion_create(const simulation *s, const char *region, region_motion *motion, report *why) {
    *motion = (region_motion){0};
    int group = mesh_find_group(&s->mesh, region, 3);
    if (group < 0) return fail(why, TROCAR_BAD_INPUT, "%s: has no region \"%s\"", s->config.mesh_path, region);
    motion->region = &s->mesh.groups[group];
    size_t count = (size_t)motion->region->node_count;
    motion->from = malloc(count * sizeof *motion->from);
    motion->displacement = malloc(count * sizeof *motion->displacement);
    motion->nominal = malloc((size_t)s->mesh.node_count * sizeof *motion->nominal);
    if (!motion->from || !motion->displacement || !motion->nominal) {
        region_motion_free(motion);
        return fail(why, TROCAR_NO_MEMORY, "no memory to follow %zu nodes", count);
    }
    for (size_t i = 0; i < count; i++) motion->from[i] = s->mesh.nodes[motion->region->nodes[i]];
    return TROCAR_OK;
}

void region_motion_free(region_motion *motion) {
    free(motion->from);
    free(motion->displacement);
    free(motion->nominal);
    *motion = (region_motion){0};
}

rigid_motion region_motion_now(simulation *s, const insertion_state *state, region_motion *motion) {
    vec3 added[MAX_CONTACTS + 1];
    simulation_displacement(s, state, motion->nominal, added);
    for (int i = 0; i < motion->region->node_count; i++) motion->displacement[i] = motion->nominal[motion->region->nodes[i]];
    return rigid_motion_fit(motion->region->node_count, motion->from, motion->displacement);
}
