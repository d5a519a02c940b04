#include "condensed/coarse_space.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tissue/blas.h"
#include "tissue/factor_solve.h"

enum { PART = 64, MODES = 6 }; /* PART: most nodes in a part; MODES: number of rigid motions of a part */

typedef struct { int node; vec3 at; } place;

struct coarse_space {
    int nodes, parts;
    place *places;           /* the free nodes (number: first dof / 3), part by part. Positions are relative to the part's centre, in units of the part's
                                size */
    int *start;              /* parts + 1: index of each part's first node in `places` */
    cholmod_common common;
    cholmod_factor *factor;  /* factor of Z^T K Z */
    cholmod_dense *moments;  /* net force and moment on each part */
    factor_solution motions; /* amplitudes of the rigid motions of all parts */
};

/* ---- parts ------------------------------------------------------------------------------------------------------------ */

/* Compares coordinates. Ties are broken by node number, so that the parts do not depend on the C library's sorting algorithm. */
static int compare(double a, double b, int node_a, int node_b) { return a != b ? (a > b) - (a < b) : (node_a > node_b) - (node_a < node_b); }

static int compare_x(const void *a, const void *b) {
    const place *p = a, *q = b;
    return compare(p->at.x, q->at.x, p->node, q->node);
}

static int compare_y(const void *a, const void *b) {
    const place *p = a, *q = b;
    return compare(p->at.y, q->at.y, p->node, q->node);
}

static int compare_z(const void *a, const void *b) {
    const place *p = a, *q = b;
    return compare(p->at.z, q->at.z, p->node, q->node);
}

/* Bisects a set of nodes across the longest side of its bounding box, recursively, until each part has at most PART nodes. */
static void divide(coarse_space *c, int first, int count) {
    place *p = c->places + first;
    vec3 low = p->at, high = p->at, sum = v3(0.0, 0.0, 0.0);
    for (int i = 0; i < count; i++) {
        low = v3(fmin(low.x, p[i].at.x), fmin(low.y, p[i].at.y), fmin(low.z, p[i].at.z));
        high = v3(fmax(high.x, p[i].at.x), fmax(high.y, p[i].at.y), fmax(high.z, p[i].at.z));
        sum = v3_add(sum, p[i].at);
    }
    vec3 size = v3_sub(high, low);
    if (count > PART) {
        bool x = size.x >= size.y && size.x >= size.z, y = !x && size.y >= size.z;
        qsort(p, (size_t)count, sizeof *p, x ? compare_x : y ? compare_y : compare_z);
        divide(c, first, count / 2);
        divide(c, first + count / 2, count - count / 2);
        return;
    }
    for (int i = 0; i < count; i++) p[i].at = v3_scale(1.0 / v3_norm(size), v3_sub(p[i].at, v3_scale(1.0 / count, sum)));
    c->start[++c->parts] = first + count;
}

/* Computes the rows of Z for a node at this position: three translations, and three rotations w x position. */
static void modes_at(vec3 at, double z[3][MODES]) {
    const double rows[3][MODES] = {{1, 0, 0, 0, at.z, -at.y}, {0, 1, 0, -at.z, 0, at.x}, {0, 0, 1, at.y, -at.x, 0}};
    memcpy(z, rows, sizeof rows);
}

/* ---- Z^T K Z ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    int *part_of;            /* part of each node */
    vec3 *at;                /* position of each node */
    int *slot, *touched;     /* slot: for each part, the index of its block in the table, or -1; touched: the parts that have a block */
    double (*table)[MODES][MODES];
    int count;
} columns_of_part;

/* Adds the contribution of one of the part's nodes, from its columns in the lower triangle of K, to the blocks between this part and every part in which those
   columns have entries. */
static void add_node(const tissue *t, int part, int node, columns_of_part *c) {
    const int *start = t->stiffness->p, *row = t->stiffness->i;
    const double *value = t->stiffness->x;
    double here[3][MODES], there[3][MODES];
    modes_at(c->at[node], here);
    for (int a = 0; a < 3; a++) {
        int last = -1;
        for (int k = start[3 * node + a]; k < start[3 * node + a + 1]; k++) {
            int other = row[k] / 3, b = row[k] % 3, in = c->part_of[other];
            if (other != last) modes_at(c->at[last = other], there);
            if (c->slot[in] < 0) {
                c->slot[in] = c->count;
                c->touched[c->count] = in;
                memset(c->table[c->count++], 0, sizeof *c->table);
            }
            double factor = in == part && row[k] == 3 * node + a ? 0.5 * value[k] : value[k]; /* halve the diagonal: each diagonal block is later added to
                                                                                                 its transpose */
            for (int i = 0; i < MODES; i++)
                for (int j = 0; j < MODES; j++) c->table[c->slot[in]][i][j] += factor * there[b][i] * here[a][j];
        }
    }
}

static bool append_block(coarse_space *s, cholmod_triplet *e, int row, int column, const double block[MODES][MODES]) {
    if (e->nnz + MODES * MODES > e->nzmax && !cholmod_reallocate_triplet(2 * e->nzmax, e, &s->common)) return false;
    for (int i = 0; i < MODES; i++)
        for (int j = 0; j < MODES; j++) {
            if (row == column && i < j) continue;
            ((int *)e->i)[e->nnz] = MODES * row + i;
            ((int *)e->j)[e->nnz] = MODES * column + j;
            ((double *)e->x)[e->nnz++] = block[i][j] + (row == column ? block[j][i] : 0.0);
        }
    return true;
}

/* Assembles the lower triangle of Z^T K Z; CHOLMOD adds triplets above the diagonal to those below it. */
static cholmod_sparse *coarse_matrix(coarse_space *s, const tissue *t) {
    size_t nodes = (size_t)s->nodes, parts = (size_t)s->parts, size = MODES * parts;
    columns_of_part c = {malloc(nodes * sizeof(int)), malloc(nodes * sizeof(vec3)), malloc(parts * sizeof(int)), malloc(parts * sizeof(int)),
                         malloc(parts * sizeof *c.table), 0};
    cholmod_triplet *e = cholmod_allocate_triplet(size, size, 16 * MODES * size, -1, CHOLMOD_REAL, &s->common);
    cholmod_sparse *matrix = NULL;
    bool done = c.part_of && c.at && c.slot && c.touched && c.table && e;
    for (int p = 0; p < s->parts && done; p++) {
        c.slot[p] = -1;
        for (int i = s->start[p]; i < s->start[p + 1]; i++) {
            c.part_of[s->places[i].node] = p;
            c.at[s->places[i].node] = s->places[i].at;
        }
    }
    for (int p = 0; p < s->parts && done; p++) {
        c.count = 0;
        for (int i = s->start[p]; i < s->start[p + 1]; i++) add_node(t, p, s->places[i].node, &c);
        for (int k = 0; k < c.count; k++) {
            done = done && append_block(s, e, c.touched[k], p, (const double(*)[MODES])c.table[k]);
            c.slot[c.touched[k]] = -1;
        }
    }
    if (done) matrix = cholmod_triplet_to_sparse(e, 0, &s->common);
    cholmod_free_triplet(&e, &s->common);
    free(c.part_of);
    free(c.at);
    free(c.slot);
    free(c.touched);
    free(c.table);
    return matrix;
}

/* ---- coarse space ----------------------------------------------------------------------------------------------------- */

static bool factor(coarse_space *c, const tissue *t) {
    cholmod_sparse *matrix = coarse_matrix(c, t);
    c->factor = matrix ? cholmod_analyze(matrix, &c->common) : NULL;
    int levels = openmp_use_one_thread();
    bool done = c->factor && cholmod_factorize(matrix, c->factor, &c->common) && c->common.status == CHOLMOD_OK;
    openmp_restore(levels);
    cholmod_free_sparse(&matrix, &c->common);
    c->moments = done ? cholmod_zeros(MODES * (size_t)c->parts, 1, CHOLMOD_REAL, &c->common) : NULL;
    return c->moments != NULL;
}

coarse_space *coarse_space_create(const tissue *t) {
    int nodes = t->dof_count / 3;
    coarse_space *c = nodes <= PART ? NULL : calloc(1, sizeof *c);
    if (!c) return NULL;
    cholmod_start(&c->common);
    c->common.print = 0;
    c->common.supernodal = CHOLMOD_SUPERNODAL; /* the simplicial factorisation neither reports an indefinite matrix nor reuses its workspace */
    c->nodes = nodes;
    c->places = malloc((size_t)nodes * sizeof *c->places);
    c->start = calloc((size_t)(nodes / (PART / 2) + 2), sizeof *c->start);
    if (c->places && c->start) {
        for (int i = 0; i < t->mesh->node_count; i++)
            if (t->dof[i] >= 0) c->places[t->dof[i] / 3] = (place){t->dof[i] / 3, t->mesh->nodes[i]};
        divide(c, 0, nodes);
        if (factor(c, t)) return c;
    }
    coarse_space_free(c);
    return NULL;
}

void coarse_space_free(coarse_space *c) {
    if (!c) return;
    cholmod_free_factor(&c->factor, &c->common);
    cholmod_free_dense(&c->moments, &c->common);
    factor_solution_free(&c->motions, &c->common);
    cholmod_finish(&c->common);
    free(c->places);
    free(c->start);
    free(c);
}

bool coarse_space_solve(coarse_space *c, const double *force, double *motion) {
    double *moments = c->moments->x;
    memset(moments, 0, MODES * (size_t)c->parts * sizeof *moments);
    for (int p = 0; p < c->parts; p++)
        for (int i = c->start[p]; i < c->start[p + 1]; i++) {
            double z[3][MODES];
            modes_at(c->places[i].at, z);
            for (int a = 0; a < 3; a++)
                for (int k = 0; k < MODES; k++) moments[MODES * p + k] += z[a][k] * force[3 * c->places[i].node + a];
        }
    if (!factor_solve(c->factor, c->moments, &c->motions, &c->common)) return false;
    const double *rigid = c->motions.x->x;
    for (int p = 0; p < c->parts; p++)
        for (int i = c->start[p]; i < c->start[p + 1]; i++) {
            double z[3][MODES];
            modes_at(c->places[i].at, z);
            for (int a = 0; a < 3; a++) {
                double sum = 0.0;
                for (int k = 0; k < MODES; k++) sum += z[a][k] * rigid[MODES * p + k];
                motion[3 * c->places[i].node + a] = sum;
            }
        }
    return true;
}
