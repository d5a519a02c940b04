/* An irregular cube of test tissue: Kuhn's six tetrahedra per cell, inner nodes displaced at random, a soft region below a stiff one, fixed nodes at z = 0. */
#ifndef TROCAR_TESTS_CUBE_H
#define TROCAR_TESTS_CUBE_H

#include <stdlib.h>
#include <string.h>

#include "inverse/inverse.h"
#include "refinement/refinement.h"

enum { CUBE_CELLS = 4, CUBE_SIDE = CUBE_CELLS + 1, CUBE_NODES = CUBE_SIDE * CUBE_SIDE * CUBE_SIDE };
static const double CUBE_EDGE = 0.1; /* m */

typedef struct {
    mesh mesh;
    region_material materials[2]; /* of the lower and the upper half */
    bool fixed[CUBE_NODES];
    tissue tissue;
    inverse *inverse;
} cube;

static inline double cube_random(double low, double high) { return low + (high - low) * rand() / RAND_MAX; }
static inline vec3 cube_random_vector(double size) {
    return v3(cube_random(-size, size), cube_random(-size, size), cube_random(-size, size));
}

static inline bool cube_inside(int i) { return i > 0 && i < CUBE_CELLS; }

/* `irregular`: largest displacement of inner nodes, as a fraction of the cell size. With 0.1, every tetrahedron is still well shaped. */
static inline void cube_nodes(mesh *m, double irregular) {
    double cell = CUBE_EDGE / CUBE_CELLS;
    m->node_count = CUBE_NODES;
    m->nodes = malloc(CUBE_NODES * sizeof *m->nodes);
    for (int n = 0; n < CUBE_NODES; n++) {
        int i = n % CUBE_SIDE, j = n / CUBE_SIDE % CUBE_SIDE, k = n / CUBE_SIDE / CUBE_SIDE;
        m->nodes[n] = v3(cell * i, cell * j, cell * k);
        if (cube_inside(i) && cube_inside(j) && cube_inside(k))
            m->nodes[n] = v3_add(m->nodes[n], cube_random_vector(irregular * cell));
    }
}

/* Kuhn's six tetrahedra of a cell follow the paths along its edges from one corner to the opposite one, one path for each order of the axes. */
static inline void cube_tets(mesh *m) {
    static const int orders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    m->tet_count = 6 * CUBE_CELLS * CUBE_CELLS * CUBE_CELLS;
    m->tets = malloc(m->tet_count * sizeof *m->tets);
    m->region = malloc(m->tet_count * sizeof *m->region);
    for (int t = 0; t < m->tet_count; t++) {
        int cell = t / 6, at[3] = {cell % CUBE_CELLS, cell / CUBE_CELLS % CUBE_CELLS, cell / CUBE_CELLS / CUBE_CELLS};
        m->region[t] = 2 * at[2] < CUBE_CELLS ? 0 : 1;
        for (int corner = 0; corner < 4; corner++) {
            m->tets[t][corner] = at[0] + CUBE_SIDE * (at[1] + CUBE_SIDE * at[2]);
            if (corner < 3) at[orders[t % 6][corner]]++;
        }
    }
}

/* Creates only the mesh, the materials and the fixed nodes. */
static inline trocar_status cube_shape(cube *c, double irregular, trocar_error *why) {
    memset(c, 0, sizeof *c);
    cube_nodes(&c->mesh, irregular);
    cube_tets(&c->mesh);
    c->mesh.group_count = 2;
    c->mesh.groups[0] = (mesh_group){.name = "soft", .dimension = 3};
    c->mesh.groups[1] = (mesh_group){.name = "stiff", .dimension = 3};
    c->materials[0] = (region_material){.youngs_modulus = 15e3, .poisson_ratio = 0.45};
    c->materials[1] = (region_material){.youngs_modulus = 60e3, .poisson_ratio = 0.3};
    for (int n = 0; n < CUBE_NODES; n++) c->fixed[n] = n < CUBE_SIDE * CUBE_SIDE;
    return mesh_finish(&c->mesh, 0, NULL, NULL, "cube", why);
}

/* Creates the mesh, the materials, the fixed nodes, the stiffness and the inverse. `c` must not be moved in memory, because its parts point to each other. */
static inline trocar_status cube_create(cube *c, double irregular, trocar_error *why) {
    trocar_status status = cube_shape(c, irregular, why);
    if (status == TROCAR_OK) status = tissue_create(&c->mesh, c->materials, c->fixed, STRAIN_BY_ELEMENT, &c->tissue, why);
    if (status == TROCAR_OK) status = inverse_create_dense(&c->tissue, (inverse_progress){0}, &c->inverse, why);
    return status;
}

static inline void cube_free(cube *c) {
    inverse_free(c->inverse);
    if (c->tissue.mesh) tissue_free(&c->tissue);
    mesh_free(&c->mesh);
}

/* Sets K to zero, so that it cannot be factorised. */
static inline void cube_loosen(tissue *t) {
    size_t entries = (size_t)((const int *)t->stiffness->p)[t->stiffness->ncol];
    memset(t->stiffness->x, 0, entries * sizeof(double));
}

/* Returns a random point in this tetrahedron whose barycentric weights are all at least `margin`. */
static inline vec3 cube_point(const cube *c, int tet, double margin) {
    double w[4], sum = 0.0;
    for (int i = 0; i < 4; i++) sum += w[i] = cube_random(0.0, 1.0);
    for (int i = 0; i < 4; i++) w[i] = margin + (1.0 - 4.0 * margin) * w[i] / sum;
    return mesh_point(&c->mesh, tet, w);
}

/* Adds nodes at random points, `each` per element, to `elements` elements, one element after another. */
static inline void cube_refine(const cube *c, refinement *r, int each, int elements) {
    for (int i = 0; i < each * elements; i++) {
        int tet = (37 * (i % elements) + 11) % c->mesh.tet_count;
        refinement_add(&c->mesh, r, tet, cube_point(c, tet, 0.0), r->count + 1);
    }
}

#endif
