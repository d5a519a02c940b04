#include "tissue/neighbourhood.h"

#include <stdlib.h>
#include <string.h>

trocar_status neighbourhood_create(const tissue *t, neighbourhood *n, trocar_error *why) {
    n->tissue = t;
    n->node_count = n->tet_count = 0;
    n->local = malloc((size_t)t->mesh->node_count * sizeof *n->local);
    n->taken = calloc((size_t)t->mesh->tet_count, sizeof *n->taken);
    if (!n->local || !n->taken) return fail(why, TROCAR_NO_MEMORY, "no memory to measure the mesh's resolution");
    for (int i = 0; i < t->mesh->node_count; i++) n->local[i] = -1;
    return TROCAR_OK;
}

void neighbourhood_free(neighbourhood *n) {
    free(n->local);
    free(n->taken);
}

/* ---- elements ------------------------------------------------------------------------------------------------------ */

static vec3 to_frame(const neighbourhood *n, vec3 x) { return m3_apply_transposed(&n->frame, v3_sub(x, n->origin)); }

vec3 neighbourhood_direction(const neighbourhood *n) { return m3_column(&n->frame, 2); }

static void forget(neighbourhood *n) {
    for (int i = 0; i < n->node_count; i++) n->local[n->nodes[i]] = -1;
    for (int i = 0; i < n->tet_count; i++) {
        for (int c = 0; c < 4; c++) n->local[n->tissue->mesh->tets[n->tets[i]][c]] = -1;
        n->taken[n->tets[i]] = false;
    }
    n->node_count = n->tet_count = 0;
}

static bool add_tet(neighbourhood *n, int tet) {
    const int *corners = n->tissue->mesh->tets[tet];
    if (n->tet_count == AROUND_TETS || n->node_count > AROUND_NODES - 4) return false;
    n->taken[tet] = true;
    n->tets[n->tet_count++] = tet;
    for (int c = 0; c < 4; c++) {
        int place = mesh_place(n->tissue->mesh, corners[c]);
        if (n->local[place] < 0) {
            int node = n->local[place] = n->node_count++;
            n->nodes[node] = place;
            n->position[node] = to_frame(n, n->tissue->mesh->nodes[place]);
            n->cut[node] = false;
        }
        n->local[corners[c]] = n->local[place];
    }
    return true;
}

static bool is_near(const neighbourhood *n, int tet, double radius, double half_length) {
    for (int c = 0; c < 4; c++) {
        vec3 p = to_frame(n, n->tissue->mesh->nodes[n->tissue->mesh->tets[tet][c]]);
        if (hypot(p.x, p.y) < radius && fabs(p.z) < half_length) return true;
    }
    return false;
}

/* Collects elements outward from the first one, across faces. Returns false if they do not all fit. */
static bool grow(neighbourhood *n, int tet, double radius, double half_length) {
    forget(n);
    if (!add_tet(n, tet)) return false;
    for (int i = 0; i < n->tet_count; i++)
        for (int f = 0; f < 4; f++) {
            int next = n->tissue->mesh->neighbours[n->tets[i]][f];
            if (next < 0 || n->taken[next] || !is_near(n, next, radius, half_length)) continue;
            if (!add_tet(n, next)) return false;
        }
    return true;
}

static bool is_free(const neighbourhood *n, int tet, int face) {
    const mesh *m = n->tissue->mesh;
    bool held = true;
    for (int k = 1; k < 4; k++) held = held && n->tissue->fixed[m->tets[tet][(face + k) % 4]];
    return m->neighbours[tet][face] < 0 && !held;
}

/* Lists the free faces, and marks the nodes of all other boundary faces. */
static void mark_cut(neighbourhood *n) {
    const mesh *m = n->tissue->mesh;
    n->free_count = 0;
    for (int i = 0; i < n->tet_count; i++)
        for (int f = 0; f < 4; f++) {
            int next = m->neighbours[n->tets[i]][f];
            if (next >= 0 && n->taken[next]) continue;
            if (is_free(n, n->tets[i], f)) {
                n->free[n->free_count++] = (tet_face){n->tets[i], f};
                continue;
            }
            for (int k = 1; k < 4; k++) n->cut[n->local[m->tets[n->tets[i]][(f + k) % 4]]] = true;
        }
}

/* Sorts the pieces of the line's path by where they start. Each piece is in one element; a piece on a face or an edge is in only one of the adjacent
   elements. */
static int by_start(const void *a, const void *b) {
    double x = ((const chord *)a)->from, y = ((const chord *)b)->from;
    return (x > y) - (x < y);
}

static const double ON_FACE = 1e-9; /* dimensionless: a line counts as lying on a face if the barycentric weight is at most this. Rounding tolerance */

static void trace_line(neighbourhood *n) {
    const mesh *m = n->tissue->mesh;
    vec3 along = neighbourhood_direction(n);
    int count = 0;
    for (int i = 0; i < n->tet_count; i++) {
        double here[4], there[4], from = -INFINITY, to = INFINITY, unit = m->node_size[m->tets[n->tets[i]][0]];
        mesh_barycentric(m, n->tets[i], n->origin, here);
        mesh_barycentric(m, n->tets[i], v3_axpy(unit, along, n->origin), there);
        for (int c = 0; c < 4; c++) {
            double slope = (there[c] - here[c]) / unit, value = here[c] + ON_FACE;
            if (fabs(slope) * unit < ON_FACE) {
                if (value < 0.0) to = -INFINITY;
            } else if (slope > 0.0) {
                from = fmax(from, -value / slope);
            } else {
                to = fmin(to, -value / slope);
            }
        }
        if (to > from) n->chords[count++] = (chord){n->tets[i], from, to};
    }
    qsort(n->chords, (size_t)count, sizeof *n->chords, by_start);
    double covered = -INFINITY;
    n->chord_count = 0;
    for (int i = 0; i < count; i++) {
        chord piece = n->chords[i];
        piece.from = fmax(piece.from, covered);
        if (piece.to <= piece.from) continue;
        covered = piece.to;
        n->chords[n->chord_count++] = piece;
    }
}

/* ---- stiffness ----------------------------------------------------------------------------------------------------- */

static double gradients_of(const neighbourhood *n, int tet, vec3 gradients[4]) {
    vec3 corners[4];
    for (int c = 0; c < 4; c++) corners[c] = n->position[n->local[n->tissue->mesh->tets[tet][c]]];
    return tet_gradients(corners, gradients);
}

static void add_block(neighbourhood *n, int a, int b, const mat3 *block) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) n->stiffness[(3 * a + i) * AROUND_DOFS + 3 * b + j] += block->m[i][j];
}

static void add_elements(neighbourhood *n, double poisson_ratio) {
    for (int i = 0; i < n->tet_count; i++) {
        vec3 g[4];
        double volume = gradients_of(n, n->tets[i], g);
        for (int a = 0; a < 4; a++)
            for (int b = 0; b < 4; b++) {
                mat3 block = stiffness_block(g[a], g[b], volume, 2.0 * (1.0 + poisson_ratio), poisson_ratio);
                add_block(n, n->local[n->tissue->mesh->tets[n->tets[i]][a]], n->local[n->tissue->mesh->tets[n->tets[i]][b]], &block);
            }
    }
}

/* A group of elements over which a volumetric strain is averaged. Each contributes part of its volume. */
typedef struct {
    int region, node, strain_patch; /* the elements of `region` that have the local node `node` as a corner, or those of `strain_patch`; -1 if not used */
} strain_group;

static bool shares_strain(const neighbourhood *n, int tet, const strain_group *group) {
    const tissue *t = n->tissue;
    if (group->strain_patch >= 0) return t->patch[tet] == group->strain_patch;
    if (t->mesh->region[tet] != group->region) return false;
    for (int c = 0; c < 4; c++)
        if (n->local[t->mesh->tets[tet][c]] == group->node) return true;
    return false;
}

static void add_mean_strain(neighbourhood *n, const strain_group *group, double lambda) {
    int count = 0, touched[AROUND_NODES];
    vec3 mean[AROUND_NODES];
    bool listed[AROUND_NODES];
    double sum = 0.0;
    memset(mean, 0, (size_t)n->node_count * sizeof *mean);
    memset(listed, 0, (size_t)n->node_count * sizeof *listed);
    for (int i = 0; i < n->tet_count; i++) {
        if (!shares_strain(n, n->tets[i], group)) continue;
        vec3 g[4];
        double volume = gradients_of(n, n->tets[i], g) * (group->node >= 0 ? 0.25 : 1.0);
        sum += volume;
        for (int c = 0; c < 4; c++) {
            int node = n->local[n->tissue->mesh->tets[n->tets[i]][c]];
            if (!listed[node]) touched[count++] = node, listed[node] = true;
            mean[node] = v3_axpy(volume, g[c], mean[node]);
        }
    }
    for (int a = 0; a < count; a++)
        for (int b = 0; b < count; b++) {
            vec3 p = v3_scale(lambda / sum, mean[touched[a]]), q = mean[touched[b]];
            mat3 block = {{{p.x * q.x, p.x * q.y, p.x * q.z}, {p.y * q.x, p.y * q.y, p.y * q.z}, {p.z * q.x, p.z * q.y, p.z * q.z}}};
            add_block(n, touched[a], touched[b], &block);
        }
}

static bool first_of(const neighbourhood *n, int i, const int *label) {
    for (int j = 0; j < i; j++)
        if (label[n->tets[j]] == label[n->tets[i]]) return false;
    return true;
}

static void assemble(neighbourhood *n) {
    const tissue *t = n->tissue;
    double nu = n->poisson_ratio, lambda = 2.0 * nu / (1.0 - 2.0 * nu);
    for (int i = 0; i < 3 * n->node_count; i++) memset(n->stiffness + (size_t)i * AROUND_DOFS, 0, 3 * (size_t)n->node_count * sizeof(double));
    bool whole = t->volumetric == STRAIN_BY_ELEMENT, by_patch = t->volumetric == STRAIN_BY_PATCH;
    add_elements(n, whole ? nu : 0.0);
    for (int i = 0; i < n->tet_count && !whole && nu > 0.0; i++) {
        if (!first_of(n, i, by_patch ? t->patch : t->mesh->region)) continue;
        if (by_patch) add_mean_strain(n, &(strain_group){-1, -1, t->patch[n->tets[i]]}, lambda);
        for (int node = 0; node < n->node_count && !by_patch; node++)
            add_mean_strain(n, &(strain_group){t->mesh->region[n->tets[i]], node, -1}, lambda);
    }
}

/* ---- all of it ----------------------------------------------------------------------------------------------------- */

void neighbourhood_take(neighbourhood *n, int tet, vec3 x, vec3 direction, patch_reach reach) {
    const mesh *m = n->tissue->mesh;
    double weights[4];
    n->origin = x;
    n->frame = frame_along(direction);
    n->poisson_ratio = n->tissue->materials[m->region[tet]].poisson_ratio;
    n->size = 0.0;
    mesh_barycentric(m, tet, x, weights);
    for (int c = 0; c < 4; c++) n->size += fmax(weights[c], 0.0) * m->node_size[m->tets[tet][c]];
    double radius = reach.radius * n->size, half_length = fmax(reach.half_length * n->size, reach.least);
    while (!grow(n, tet, radius, half_length)) radius *= 0.9, half_length *= 0.9;
    mark_cut(n);
    trace_line(n);
    assemble(n);
}
