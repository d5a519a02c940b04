#include "tissue/region_forces.h"

#include <stdlib.h>
#include <string.h>

#include "base/lame.h"

/* Adds the forces due to the part of the energy that is integrated element by element. */
static void add_element(const tissue *t, int tet, const vec3 *u, vec3 *force) {
    vec3 corners[4];
    double k[12][12], youngs_modulus, poisson_ratio;
    mesh_corners(t->mesh, tet, corners);
    element_moduli(t, tet, &youngs_modulus, &poisson_ratio);
    tet_stiffness(corners, youngs_modulus, poisson_ratio, k);
    for (int a = 0; a < 12; a++)
        for (int b = 0; b < 12; b++) (&force[t->mesh->tets[tet][a / 3]].x)[a % 3] += k[a][b] * (&u[t->mesh->tets[tet][b / 3]].x)[b % 3];
}

/* Volume and change in volume, m^3. */
typedef struct {
    double volume, change;
} dilation;

static double part_of_volume(const tissue *t, int tet, vec3 gradients[4], int means[4], int *count) {
    vec3 corners[4];
    mesh_corners(t->mesh, tet, corners);
    *count = tissue_means_of(t, tet, means);
    return tet_gradients(corners, gradients) / *count;
}

/* Adds the forces due to the volumetric energy, which is lambda V (mean of div u)^2 / 2 for each mean. */
static void add_means(const tissue *t, int region, const vec3 *u, dilation *sums, vec3 *force) {
    const mesh *m = t->mesh;
    double lambda = lame_lambda(t->materials[region].youngs_modulus, t->materials[region].poisson_ratio);
    vec3 g[4];
    int means[4], count;
    for (int e = 0; e < m->tet_count; e++) {
        if (m->region[e] != region) continue;
        double volume = part_of_volume(t, e, g, means, &count), divergence = 0.0;
        for (int c = 0; c < 4; c++) divergence += v3_dot(g[c], u[m->tets[e][c]]);
        for (int a = 0; a < count; a++) sums[means[a]].volume += volume, sums[means[a]].change += volume * divergence;
    }
    for (int e = 0; e < m->tet_count; e++) {
        if (m->region[e] != region) continue;
        double volume = part_of_volume(t, e, g, means, &count);
        for (int a = 0; a < count; a++)
            for (int c = 0; c < 4; c++) {
                vec3 *at = &force[m->tets[e][c]];
                *at = v3_axpy(lambda * volume * sums[means[a]].change / sums[means[a]].volume, g[c], *at);
            }
    }
}

trocar_status region_forces(const tissue *t, int region, const vec3 *u, vec3 *force, trocar_error *why) {
    const mesh *m = t->mesh;
    memset(force, 0, (size_t)m->node_count * sizeof *force);
    for (int e = 0; e < m->tet_count; e++)
        if (m->region[e] == region) add_element(t, e, u, force);
    if (t->volumetric == STRAIN_BY_ELEMENT) return TROCAR_OK;
    dilation *sums = calloc((size_t)tissue_mean_count(t), sizeof *sums);
    if (!sums) return fail(why, TROCAR_NO_MEMORY, "no memory for the forces of a region");
    add_means(t, region, u, sums, force);
    free(sums);
    return TROCAR_OK;
}
