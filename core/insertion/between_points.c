#include "insertion/between_points.h"

#include "base/row_matrix.h"
#include "insertion/guides.h"

/* All that is computed is laid out by components, so that four points pass at once. Points are numbered by their places from base to tip. */
enum { PLACES = BETWEEN_PLACES };

typedef struct {
    int order[MAX_POINTS];           /* the point in each place */
    bool in_order;                   /* see in_order_of_slots */
    double frame[3][3][PLACES];      /* [a][b]: component a of axis b */
    double tissue[3][3][PLACES];     /* m/N, world frame, between one point (rows) and each */
} layout;

/* ---- points ---------------------------------------------------------------------------------------------------------- */

/* The points from base to tip: guides come first in the list, wherever they are. */
static void sort_points(const insertion_workspace *w, int order[MAX_POINTS]) {
    for (int i = 0; i < w->point_count; i++) {
        int at = i;
        for (; at > 0 && w->points[order[at - 1]].at.first > w->points[i].at.first; at--) order[at] = order[at - 1];
        order[at] = i;
    }
}

static void lay_out_frames(const insertion_workspace *w, layout *to) {
    for (int k = 0; k < w->point_count; k++)
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) to->frame[a][b][k] = w->points[to->order[k]].at.frame.m[a][b];
}

/* True if points and slots are in order without gaps, and there are no guides. (The usual case.) */
static bool in_order_of_slots(const insertion_workspace *w, const int order[MAX_POINTS]) {
    bool in_order = w->guided == 0;
    for (int k = 0; k < w->point_count && in_order; k++)
        in_order = order[k] == k && (k >= w->point_count - w->tip || w->points[k].handle == w->points[0].handle + k);
    return in_order;
}

static void put_tissue(layout *to, int l, const mat3 *block, double mount, bool transposed) {
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) to->tissue[a][b][l] = (transposed ? block->m[b][a] : block->m[a][b]) + (a == b ? mount : 0.0);
}

/* Between two points, neither of which is at the tip. */
static mat3 between_contacts(const tick_context *tick, int i, int j) {
    const insertion_workspace *w = tick->scratch;
    if (i < w->guided || j < w->guided) return (mat3){{{0}}};
    return m3_scaled(w->creep.yield, compliance_between(tick->snapshot, w->points[i].handle, w->points[j].handle));
}

/* Compliance of the tissue and the mount between the point in place k and those from there on. */
static void lay_out_tissue(const tick_context *tick, int k, layout *to) {
    const insertion_workspace *w = tick->scratch;
    int i = to->order[k], slot = w->points[i].handle, contacts = w->point_count - w->tip;
    double mount = tick->base.compliance;
    for (int a = 0; a < 9 && to->in_order && k < contacts; a++) {
        const double *from = tick->snapshot->between_contacts[slot].at[a / 3][a % 3] + (slot - k);
        for (int l = k; l < contacts; l += LANES)
            lanes_store(&to->tissue[a / 3][a % 3][l], w->creep.yield * lanes_load(from + l) + lanes_all(a % 4 == 0 ? mount : 0.0));
    }
    for (int l = to->in_order ? (k > contacts ? k : contacts) : k; l < w->point_count; l++) {
        int j = to->order[l];
        if (w->points[i].kind == POINT_TIP) put_tissue(to, l, &w->tip_row[j], mount, false);
        else if (w->points[j].kind == POINT_TIP) put_tissue(to, l, &w->tip_row[i], mount, true);
        else {
            mat3 block = between_contacts(tick, i, j);
            put_tissue(to, l, &block, mount, false);
        }
    }
}

/* ---- needle ---------------------------------------------------------------------------------------------------------- */

/* Displacement of the joints from the base to each point, world frame, under unit forces at the point, in its frame. */
static void interpolate_columns(insertion_workspace *w, const layout *points) {
    int begin = 3 * w->points[points->order[0]].at.first;
    for (int k = 0; k < w->point_count; k++) {
        const needle_point *p = &w->points[points->order[k]].at;
        row_matrix frame = rows_of(&p->frame);
        lanes by[3 * NEEDLE_POINT_JOINTS];
        for (int m = 0; m < NEEDLE_POINT_JOINTS; m++)
            for (int a = 0; a < 3; a++) by[3 * m + a] = p->weights[m] * frame.row[a];
        for (int row = begin; row < 3 * (p->first + NEEDLE_POINT_JOINTS); row++) {
            const double *at = &w->tangent.compliance[row][3 * p->first];
            lanes sum = at[0] * by[0];
            for (int c = 1; c < 3 * NEEDLE_POINT_JOINTS; c++) sum += at[c] * by[c];
            for (int b = 0; b < 3; b++) w->joints_to_points[row][b][k] = sum[b];
        }
    }
}

/* ---- blocks ---------------------------------------------------------------------------------------------------------- */

/* Blocks between the point in place k and the four from place l on, in the frames of both. */
static inline void find_blocks(const insertion_workspace *w, const layout *points, int k, int l, lanes block[3][3]) {
    const needle_point *p = &w->points[points->order[k]].at;
    lanes world[3][3]; /* rows in the world frame */
    for (int a = 0; a < 3; a++) {
        const double (*rows)[PLACES] = w->joints_to_points[3 * p->first + a];
        lanes x = lanes_load(&points->tissue[a][0][l]), y = lanes_load(&points->tissue[a][1][l]), z = lanes_load(&points->tissue[a][2][l]);
        for (int b = 0; b < 3; b++) {
            lanes sum = x * lanes_load(&points->frame[0][b][l]) + y * lanes_load(&points->frame[1][b][l]) + z * lanes_load(&points->frame[2][b][l]);
            for (int m = 0; m < NEEDLE_POINT_JOINTS; m++) sum += p->weights[m] * lanes_load(&rows[9 * m + b][l]);
            world[a][b] = sum;
        }
    }
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) block[a][b] = p->frame.m[0][a] * world[0][b] + p->frame.m[1][a] * world[1][b] + p->frame.m[2][a] * world[2][b];
}

/* Stores one block in the upper triangle. */
static void put_block(contact_problem *p, int i, int j, lanes block[3][3], int lane) {
    bool swapped = i > j;
    int low = swapped ? j : i, high = swapped ? i : j;
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            int row = unknown(p->count, low, a), column = unknown(p->count, high, b);
            double number = swapped ? block[b][a][lane] : block[a][b][lane];
            if (row <= column) p->compliance[row][column] = number;
            else p->compliance[column][row] = number;
        }
}

/* Stores four blocks beside one another, of points in the order of their places. */
static void put_four(contact_problem *p, int i, int j, lanes block[3][3]) {
    int axial = 2 * p->count;
    for (int a = 0; a < 2; a++) {
        double *row = p->compliance[2 * i + a];
        lanes x = block[a][0], y = block[a][1];
        lanes_store(row + 2 * j, (lanes){x[0], y[0], x[1], y[1]});
        lanes_store(row + 2 * j + LANES, (lanes){x[2], y[2], x[3], y[3]});
        lanes_store(row + axial + j, block[a][2]);
    }
    lanes_store(p->compliance[axial + i] + axial + j, block[2][2]);
    for (int k = 0; k < LANES; k++)
        for (int b = 0; b < 2; b++) p->compliance[2 * (j + k) + b][axial + i] = block[2][b][k];
}

/* The blocks from place l on, of which those before place `first` are known or mean nothing. */
static void put_blocks(const tick_context *tick, const layout *points, int k, int l, int first, lanes block[3][3]) {
    insertion_workspace *w = tick->scratch;
    if (points->in_order && l >= k && l + LANES <= w->point_count) {
        put_four(&w->problem, k, l, block);
        return;
    }
    lanes nothing[3][3] = {{{0}}};
    for (int at = first; at < l + LANES && at < w->point_count; at++) {
        int i = points->order[k], j = points->order[at];
        bool open = guides_is_open(w, i) || guides_is_open(w, j);
        put_block(&w->problem, i, j, open ? nothing : block, at - l);
    }
}

void assemble_between_points(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    layout points;
    int count = w->point_count;
    points.order[0] = 0;
    sort_points(w, points.order);
    points.in_order = in_order_of_slots(w, points.order);
    lay_out_frames(w, &points);
    interpolate_columns(w, &points);
    for (int k = 0; k < count; k++) {
        lay_out_tissue(tick, k, &points);
        for (int first = k; first < count; first += LANES) {
            int l = first + LANES <= count || count < LANES ? first : count - LANES; /* the last four overlap */
            lanes block[3][3];
            find_blocks(w, &points, k, l, block);
            put_blocks(tick, &points, k, l, first, block);
        }
    }
}
