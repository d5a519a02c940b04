#include "insertion/between_points.h"

#include "base/lanes.h"
#include "insertion/guides.h"

/* A 3 x 3 matrix by rows, of which the last column means nothing. */
typedef struct {
    lanes row[3];
} row_matrix;

static inline row_matrix rows_of(const mat3 *m) {
    const double *x = &m->m[0][0];
    return (row_matrix){{lanes_load(x), lanes_load(x + 3), {x[6], x[7], x[8], 0.0}}};
}

static row_matrix columns_of(const mat3 *m) {
    mat3 t = m3_transposed(m);
    return rows_of(&t);
}

/* frame^T block other */
static inline row_matrix turned(const mat3 *frame, row_matrix block, const row_matrix *other) {
    row_matrix result;
    for (int a = 0; a < 3; a++) {
        lanes half = frame->m[0][a] * block.row[0] + frame->m[1][a] * block.row[1] + frame->m[2][a] * block.row[2];
        result.row[a] = half[0] * other->row[0] + half[1] * other->row[1] + half[2] * other->row[2];
    }
    return result;
}

/* Displacement of a point of the needle under forces at the joints from its first one on, world frame, m/N. */
static void interpolate_rows(const needle_tangent *tangent, int segments, const needle_point *p, double by_joints[3][NEEDLE_LD + LANES]) {
    const double (*rows)[NEEDLE_LD] = &tangent->compliance[3 * p->first];
    for (int c = lanes_below(3 * p->first); c < 3 * (segments + 1); c += LANES)
        for (int i = 0; i < 3; i++) {
            lanes sum = p->weights[0] * lanes_load(&rows[i][c]);
            for (int k = 1; k < NEEDLE_POINT_JOINTS; k++) sum += p->weights[k] * lanes_load(&rows[3 * k + i][c]);
            lanes_store(&by_joints[i][c], sum);
        }
}

/* Compliance of the tissue between points i and j, world frame, m/N. */
static inline row_matrix tissue_between(const tick_context *tick, int i, int j) {
    const insertion_workspace *w = tick->scratch;
    if (w->points[i].kind == POINT_TIP) return rows_of(&w->tip_row[j]);
    if (w->points[j].kind == POINT_TIP) return columns_of(&w->tip_row[i]);
    if (i < w->guided || j < w->guided) return (row_matrix){{{0}}};
    int from = w->points[i].handle, to = w->points[j].handle;
    const mat3 *pair = &tick->snapshot->between_contacts[contact_pair(from, to)]; /* as compliance_between, without copies */
    row_matrix block = from <= to ? rows_of(pair) : columns_of(pair);
    for (int a = 0; a < 3; a++) block.row[a] *= w->creep.yield;
    return block;
}

/* Stores a block in the upper triangle, i <= j. */
static void put_block(contact_problem *p, int i, int j, const row_matrix *block) {
    for (int a = 0; a < 3; a++) {
        double *to = p->compliance[unknown(p->count, i, a)];
        to[unknown(p->count, j, 2)] = block->row[a][2];
        for (int b = 0; b < 2; b++)
            if (a < 2) to[unknown(p->count, j, b)] = block->row[a][b];
            else p->compliance[unknown(p->count, j, b)][unknown(p->count, i, a)] = block->row[a][b];
    }
}

static void put_transposed(contact_problem *p, int i, int j, const row_matrix *block) {
    row_matrix columns;
    for (int a = 0; a < 3; a++) columns.row[a] = (lanes){block->row[0][a], block->row[1][a], block->row[2][a]};
    put_block(p, i, j, &columns);
}

/* The points from base to tip: guides come first in the list, wherever they are. */
static void sort_points(const insertion_workspace *w, int order[MAX_POINTS]) {
    for (int i = 0; i < w->point_count; i++) {
        int at = i;
        for (; at > 0 && w->points[order[at - 1]].at.first > w->points[i].at.first; at--) order[at] = order[at - 1];
        order[at] = i;
    }
}

void assemble_between_points(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    contact_problem *p = &w->problem;
    row_matrix frames[MAX_POINTS];
    double by_joints[3][NEEDLE_LD + LANES];
    int order[MAX_POINTS];
    const mat3 spring = {{{tick->base.compliance, 0, 0}, {0, tick->base.compliance, 0}, {0, 0, tick->base.compliance}}}; /* holds the base */
    const row_matrix held = rows_of(&spring);
    sort_points(w, order);
    for (int i = 0; i < w->point_count; i++) frames[i] = rows_of(&w->points[i].at.frame);
    for (int k = 0; k < w->point_count; k++) {
        int i = order[k];
        interpolate_rows(&w->tangent, tick->model->needle->given.segments, &w->points[i].at, by_joints);
        for (int l = k; l < w->point_count; l++) {
            int j = order[l];
            const needle_point *other = &w->points[j].at;
            row_matrix block = {{{0}}};
            if (!guides_is_open(w, i) && !guides_is_open(w, j)) {
                block = tissue_between(tick, i, j);
                for (int a = 0; a < 3; a++) {
                    block.row[a] += held.row[a];
                    for (int m = 0; m < NEEDLE_POINT_JOINTS; m++) block.row[a] += other->weights[m] * lanes_load(&by_joints[a][3 * (other->first + m)]);
                }
                block = turned(&w->points[i].at.frame, block, &frames[j]);
            }
            if (i <= j) put_block(p, i, j, &block);
            else put_transposed(p, j, i, &block);
        }
    }
}
