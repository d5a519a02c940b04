#include "insertion/between_points.h"

#include "base/lanes.h"
#include "insertion/guides.h"

/* Displacement of one point, in its own frame, */
typedef struct {
    double by_joints[3][NEEDLE_LD];          /* m/N, per force at each joint of the needle, */
    double by_points[3][3 * MAX_POINTS + 1]; /* m/N, and per force on the tissue at each point: world frame */
} point_motion;

/* A point's part in the forces on joints and on the tissue there: [component of the force][component in the point's frame]. */
typedef struct {
    lanes joints[3 * NEEDLE_POINT_JOINTS], tissue[3];
} point_force_share;

static lanes frame_row(const mat3 *frame, int i) { return (lanes){frame->m[i][0], frame->m[i][1], frame->m[i][2], 0.0}; }

static point_force_share share_force(const needle_point *p) {
    point_force_share s;
    for (int i = 0; i < 3; i++) {
        s.tissue[i] = frame_row(&p->frame, i);
        for (int k = 0; k < NEEDLE_POINT_JOINTS; k++) s.joints[3 * k + i] = p->weights[k] * s.tissue[i];
    }
    return s;
}

/* For the joints from p's first one on. */
static void move_by_joints(const needle_tangent *tangent, int segments, const needle_point *p, point_motion *motion) {
    const double (*rows)[NEEDLE_LD] = &tangent->compliance[3 * p->first];
    for (int c = lanes_below(3 * p->first); c < 3 * (segments + 1); c += LANES) {
        lanes moved[3];
        for (int i = 0; i < 3; i++) {
            moved[i] = p->weights[0] * lanes_load(&rows[i][c]);
            for (int k = 1; k < NEEDLE_POINT_JOINTS; k++) moved[i] += p->weights[k] * lanes_load(&rows[3 * k + i][c]);
        }
        for (int a = 0; a < 3; a++)
            lanes_store(&motion->by_joints[a][c], p->frame.m[0][a] * moved[0] + p->frame.m[1][a] * moved[1] + p->frame.m[2][a] * moved[2]);
    }
}

/* Compliance of the tissue and of the spring that holds the base between points i and j, world frame, m/N. */
static mat3 tissue_between(const tick_context *tick, int i, int j) {
    const insertion_workspace *w = tick->scratch;
    mat3 block = {{{0}}};
    if (w->points[i].kind == POINT_TIP) block = w->tip_row[j];
    else if (w->points[j].kind == POINT_TIP) block = m3_transposed(&w->tip_row[i]);
    else if (i >= w->guided && j >= w->guided) block = m3_scaled(w->creep.yield, compliance_between(tick->snapshot, w->points[i].handle, w->points[j].handle));
    for (int a = 0; a < 3; a++) block.m[a][a] += tick->base.compliance;
    return block;
}

static void move_by_point(const tick_context *tick, int i, int j, point_motion *motion) {
    const mat3 *frame = &tick->scratch->points[i].at.frame, block = tissue_between(tick, i, j);
    const lanes rows[3] = {frame_row(&block, 0), frame_row(&block, 1), frame_row(&block, 2)};
    for (int a = 0; a < 3; a++)
        lanes_store(&motion->by_points[a][3 * j], frame->m[0][a] * rows[0] + frame->m[1][a] * rows[1] + frame->m[2][a] * rows[2]);
}

/* Row a of the block between two points, in their frames. */
static inline lanes block_row(const point_motion *motion, int a, const point_force_share *share, int first_joint, int point) {
    const double *by_joints = &motion->by_joints[a][3 * first_joint], *by_points = &motion->by_points[a][3 * point];
    lanes even = by_points[0] * share->tissue[0] + by_points[2] * share->tissue[2], odd = by_points[1] * share->tissue[1];
    for (int k = 0; k < 3 * NEEDLE_POINT_JOINTS; k++) {
        if (k % 2) odd += by_joints[k] * share->joints[k];
        else even += by_joints[k] * share->joints[k];
    }
    return even + odd;
}

/* Stores a block in the upper triangle, i <= j. */
static void put_block(contact_problem *p, int i, int j, const lanes row[3]) {
    for (int a = 0; a < 3; a++) {
        double *to = p->compliance[unknown(p->count, i, a)];
        to[unknown(p->count, j, 2)] = row[a][2];
        for (int b = 0; b < 2; b++)
            if (a < 2) to[unknown(p->count, j, b)] = row[a][b];
            else p->compliance[unknown(p->count, j, b)][unknown(p->count, i, a)] = row[a][b];
    }
}

static void put_transposed(contact_problem *p, int i, int j, const lanes row[3]) {
    const lanes column[3] = {{row[0][0], row[1][0], row[2][0]}, {row[0][1], row[1][1], row[2][1]}, {row[0][2], row[1][2], row[2][2]}};
    put_block(p, i, j, column);
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
    const lanes none[3] = {lanes_all(0.0), lanes_all(0.0), lanes_all(0.0)};
    point_force_share shares[MAX_POINTS];
    point_motion motion;
    int order[MAX_POINTS];
    sort_points(w, order);
    for (int i = 0; i < w->point_count; i++) shares[i] = share_force(&w->points[i].at);
    for (int k = 0; k < w->point_count; k++) {
        int i = order[k];
        move_by_joints(&w->tangent, tick->model->needle->given.segments, &w->points[i].at, &motion);
        for (int l = k; l < w->point_count; l++) {
            int j = order[l];
            bool coupled = !guides_is_open(w, i) && !guides_is_open(w, j);
            lanes row[3];
            if (coupled) move_by_point(tick, i, j, &motion);
            for (int a = 0; a < 3; a++) row[a] = coupled ? block_row(&motion, a, &shares[j], w->points[j].at.first, j) : none[a];
            if (i <= j) put_block(p, i, j, row);
            else put_transposed(p, j, i, row);
        }
    }
}
