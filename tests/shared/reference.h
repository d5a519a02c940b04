/* Textbook finite elements to compare the core with: the stiffness is B^T D B, assembled as a dense matrix and solved by LAPACK. All it shares with the core
   are the mesh's nodes and tetrahedra. */
#ifndef TROCAR_TESTS_REFERENCE_H
#define TROCAR_TESTS_REFERENCE_H

#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "refinement/refinement.h"

/* Elements with their materials. */
typedef struct {
    int node_count, tet_count;
    vec3 *nodes;                     /* m */
    int (*tets)[4];
    int *parent;                     /* the nominal tetrahedron that contains each element */
    const region_material **material;
    bool *fixed;
    double *matrix;                  /* (3 node_count) x (3 node_count), stiffness or its inverse; rows and columns of fixed dofs are zero */
} reference;

/* Computes the shape functions' gradients, whose coefficients are the rows of the inverse of [1 x y z]. Returns the volume, which is positive. */
static inline double reference_gradients(const vec3 x[4], double gradients[4][3]) {
    double a[4][4], inverse[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}}, determinant = 1.0;
    lapack_int pivots[4];
    for (int i = 0; i < 4; i++) memcpy(a[i], (double[4]){1.0, x[i].x, x[i].y, x[i].z}, sizeof a[i]);
    LAPACKE_dgesv(LAPACK_ROW_MAJOR, 4, 4, &a[0][0], 4, pivots, &inverse[0][0], 4);
    for (int i = 0; i < 4; i++) {
        determinant *= a[i][i];
        for (int d = 0; d < 3; d++) gradients[i][d] = inverse[1 + d][i];
    }
    return fabs(determinant) / 6.0;
}

static inline void reference_elasticity(double e, double nu, double d[6][6]) {
    double scale = e / ((1.0 + nu) * (1.0 - 2.0 * nu));
    memset(d, 0, sizeof(double[6][6]));
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) d[i][j] = scale * (i == j ? 1.0 - nu : nu);
        d[3 + i][3 + i] = e / (2.0 * (1.0 + nu));
    }
}

/* Computes V B^T D B, with the strains in the order xx yy zz xy yz zx (engineering shear). */
static inline void reference_element(const vec3 x[4], double e, double nu, double k[12][12]) {
    double g[4][3], b[6][12] = {{0}}, d[6][6], volume = reference_gradients(x, g);
    reference_elasticity(e, nu, d);
    for (int n = 0; n < 4; n++)
        for (int i = 0; i < 3; i++) {
            b[i][3 * n + i] = g[n][i];
            b[3 + i][3 * n + i] = g[n][(i + 1) % 3];
            b[3 + i][3 * n + (i + 1) % 3] = g[n][i];
        }
    for (int p = 0; p < 12; p++)
        for (int q = 0; q < 12; q++) {
            k[p][q] = 0.0;
            for (int s = 0; s < 6; s++)
                for (int t = 0; t < 6; t++) k[p][q] += volume * b[s][p] * d[s][t] * b[t][q];
        }
}

static const double REFERENCE_ON_FACE = 1e-10; /* a point with a smaller weight counts as lying on the face */

static inline void reference_weights(const vec3 corners[4], vec3 x, double weights[4]) {
    double g[4][3];
    reference_gradients(corners, g);
    for (int i = 0; i < 4; i++) {
        vec3 from = v3_sub(x, corners[i]);
        weights[i] = 1.0 + g[i][0] * from.x + g[i][1] * from.y + g[i][2] * from.z;
    }
}

static inline double reference_least_weight(const reference *r, int tet, vec3 x) {
    double weights[4], least = 1.0;
    vec3 corners[4];
    for (int i = 0; i < 4; i++) corners[i] = r->nodes[r->tets[tet][i]];
    reference_weights(corners, x, weights);
    for (int i = 0; i < 4; i++) least = fmin(least, weights[i]);
    return least;
}

/* Splits the element at the node into one child for each face that does not contain it. */
static inline void reference_split_one(reference *r, int tet, int node) {
    int corners[4], next = tet;
    double weights[4];
    vec3 x[4];
    memcpy(corners, r->tets[tet], sizeof corners);
    for (int i = 0; i < 4; i++) x[i] = r->nodes[corners[i]];
    reference_weights(x, r->nodes[node], weights);
    for (int i = 0; i < 4; i++) {
        if (fabs(weights[i]) < REFERENCE_ON_FACE) continue;
        memcpy(r->tets[next], corners, sizeof corners);
        r->tets[next][i] = node;
        r->parent[next] = r->parent[tet];
        r->material[next] = r->material[tet];
        next = r->tet_count++;
    }
    r->tet_count--;
}

/* Splits the elements that contain x (two if x is on a face). Finds them by linear search. */
static inline void reference_split(reference *r, vec3 x) {
    int node = r->node_count++, tets = r->tet_count;
    r->nodes[node] = x;
    r->fixed[node] = false;
    for (int t = 0; t < tets; t++)
        if (reference_least_weight(r, t, x) > -REFERENCE_ON_FACE) reference_split_one(r, t, node);
}

/* Moves a mesh node. Afterwards, no element uses the entry for the added node. */
static inline void reference_move(reference *r, int node, vec3 x) {
    r->nodes[node] = r->nodes[r->node_count] = x;
    r->fixed[r->node_count++] = true;
}

static inline double *reference_entry(const reference *r, int node, int a, int other, int b) {
    return r->matrix + (size_t)(3 * node + a) * (size_t)(3 * r->node_count) + (size_t)(3 * other + b);
}

/* Assembles the stiffness. With `deviatoric`, lambda is zero, as for a material with the same mu and nu = 0. */
static inline void reference_assemble(reference *r, bool deviatoric) {
    r->matrix = calloc((size_t)(9 * r->node_count * r->node_count), sizeof(double));
    for (int t = 0; t < r->tet_count; t++) {
        vec3 corners[4];
        double k[12][12];
        for (int i = 0; i < 4; i++) corners[i] = r->nodes[r->tets[t][i]];
        double e = r->material[t]->youngs_modulus, nu = r->material[t]->poisson_ratio;
        reference_element(corners, deviatoric ? e / (1.0 + nu) : e, deviatoric ? 0.0 : nu, k);
        for (int p = 0; p < 12; p++)
            for (int q = 0; q < 12; q++)
                *reference_entry(r, r->tets[t][p / 3], p % 3, r->tets[t][q / 3], q % 3) += k[p][q];
    }
}

/* Zeroes the rows and columns of fixed dofs and sets their diagonal entries to `diagonal` (1 before the inversion, 0 afterwards). */
static inline void reference_isolate(reference *r, double diagonal) {
    for (int n = 0; n < r->node_count; n++) {
        if (!r->fixed[n]) continue;
        for (int o = 0; o < r->node_count; o++)
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++) *reference_entry(r, n, a, o, b) = *reference_entry(r, o, b, n, a) = 0.0;
        for (int a = 0; a < 3; a++) *reference_entry(r, n, a, n, a) = diagonal;
    }
}

static inline void reference_invert(reference *r) {
    int n = 3 * r->node_count;
    reference_isolate(r, 1.0);
    LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', n, r->matrix, n);
    LAPACKE_dpotri(LAPACK_COL_MAJOR, 'L', n, r->matrix, n);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < i; j++) r->matrix[(size_t)i * n + j] = r->matrix[(size_t)j * n + i];
    reference_isolate(r, 0.0);
}

/* Adds the fraction `share` of an element's volume integral of div u, as coefficients of u. Returns the same fraction of its volume. */
static inline double reference_add_divergence(const vec3 *nodes, const int tet[4], double share, double *b) {
    double g[4][3];
    vec3 x[4];
    for (int i = 0; i < 4; i++) x[i] = nodes[tet[i]];
    share *= reference_gradients(x, g);
    for (int i = 0; i < 12; i++) b[3 * tet[i / 3] + i % 3] += share * g[i / 3][i % 3];
    return share;
}

/* Adds the stiffness lambda V b b^T of a mean strain whose integral over `volume` is `b`, then sets b to zero. */
static inline void reference_add_mean(reference *r, const region_material *material, double *b, double volume) {
    double lambda = material->youngs_modulus * material->poisson_ratio / ((1.0 + material->poisson_ratio) * (1.0 - 2.0 * material->poisson_ratio));
    for (int p = 0; p < 3 * r->node_count && volume > 0.0; p++)
        for (int q = 0; q < 3 * r->node_count && b[p] != 0.0; q++) *reference_entry(r, p / 3, p % 3, q / 3, q % 3) += lambda / volume * b[p] * b[q];
    memset(b, 0, (size_t)(3 * r->node_count) * sizeof *b);
}

/* Adds the stiffness of the strain averaged around each node, over the elements of one region of the nominal mesh. */
static inline void reference_average_nodes(reference *r, const tissue *t) {
    const mesh *m = t->mesh;
    double *b = calloc((size_t)(3 * r->node_count), sizeof *b);
    for (int node = 0; node < m->node_count; node++)
        for (int region = 0; region < m->group_count; region++) {
            double volume = 0.0;
            for (int e = 0; e < m->tet_count; e++) {
                const int *v = m->tets[e];
                if (m->region[e] == region && (v[0] == node || v[1] == node || v[2] == node || v[3] == node))
                    volume += reference_add_divergence(m->nodes, v, 0.25, b);
            }
            reference_add_mean(r, &t->materials[region], b, volume);
        }
    free(b);
}

/* Adds the stiffness of the strain averaged over each patch of these elements. Each element is part of a nominal element, its parent. */
static inline void reference_average_patches(reference *r, const tissue *t, const vec3 *nodes, int count, int (*tets)[4], const int *parent) {
    double *b = calloc((size_t)(3 * r->node_count), sizeof *b);
    for (int patch = 0; patch < t->patch_count; patch++) {
        double volume = 0.0;
        int region = -1;
        for (int e = 0; e < count; e++) {
            if (t->patch[parent[e]] != patch) continue;
            volume += reference_add_divergence(nodes, tets[e], 1.0, b);
            region = t->mesh->region[parent[e]];
        }
        reference_add_mean(r, &t->materials[region], b, volume);
    }
    free(b);
}

/* Splits this tissue's nominal mesh at these contact nodes, one after another. */
static inline void reference_refine(const tissue *t, const refinement *added, reference *r) {
    size_t nodes = (size_t)(t->mesh->node_count + added->count), tets = (size_t)(t->mesh->tet_count + 4 * added->count + 1);
    *r = (reference){.node_count = t->mesh->node_count, .tet_count = t->mesh->tet_count};
    r->nodes = malloc(nodes * sizeof *r->nodes);
    r->tets = malloc(tets * sizeof *r->tets);
    r->parent = malloc(tets * sizeof *r->parent);
    r->material = malloc(tets * sizeof *r->material);
    r->fixed = malloc(nodes * sizeof *r->fixed);
    memcpy(r->nodes, t->mesh->nodes, (size_t)r->node_count * sizeof *r->nodes);
    memcpy(r->tets, t->mesh->tets, (size_t)r->tet_count * sizeof *r->tets);
    memcpy(r->fixed, t->fixed, (size_t)r->node_count * sizeof *r->fixed);
    for (int e = 0; e < r->tet_count; e++) {
        r->parent[e] = e;
        r->material[e] = &t->materials[t->mesh->region[e]];
    }
    for (int i = 0; i < added->count; i++) {
        const added_node *node = &added->nodes[added->order[i]];
        if (node->moved >= 0) reference_move(r, node->moved, node->position);
        else reference_split(r, node->position);
    }
}

/* Refines the mesh and assembles its stiffness. Mean strains are averaged over the nominal mesh. */
static inline void reference_build(const tissue *t, const refinement *added, reference *r) {
    reference_refine(t, added, r);
    reference_assemble(r, t->volumetric != STRAIN_BY_ELEMENT);
    if (t->volumetric == STRAIN_BY_NODE) reference_average_nodes(r, t);
    if (t->volumetric == STRAIN_BY_PATCH) /* before any split, each element is its own parent */
        reference_average_patches(r, t, t->mesh->nodes, t->mesh->tet_count, t->mesh->tets, r->parent);
}

/* Same as reference_build, but inverts the stiffness. */
static inline void reference_create(const tissue *t, const refinement *added, reference *r) {
    reference_build(t, added, r);
    reference_invert(r);
}

static inline void reference_free(reference *r) {
    free(r->nodes);
    free(r->tets);
    free(r->parent);
    free(r->material);
    free(r->fixed);
    free(r->matrix);
}

#endif
