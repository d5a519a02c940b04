#include "insertion/between_points.h"

#include "insertion/guides.h"
#include "linalg/between_kernels.h"

/* Places of points from base to tip, and what is known of them before their blocks. */
typedef struct {
    int order[MAX_POINTS];           /* the point in each place */
    bool in_order;                   /* see in_order_of_slots */
    _Alignas(CACHE_LINE) between_rows frames; /* [a][b]: component a of axis b */
    between_rows tissue;             /* m/N, world frame, between one point (rows) and the others, if they are not in order */
} layout;

/* ---- points ---------------------------------------------------------------------------------------------------------- */

/* The points from base to tip: guides come first in the list, wherever they are. */
static void sort_points(const insertion_workspace *w, int order[MAX_POINTS]) {
    for (int i = 0; i < w->points.count; i++) {
        int at = i;
        for (; at > 0 && w->points.list[order[at - 1]].at.first > w->points.list[i].at.first; at--) order[at] = order[at - 1];
        order[at] = i;
    }
}

static void lay_out_frames(const insertion_workspace *w, layout *to) {
    for (int k = 0; k < w->points.count; k++)
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) to->frames[a][b][k] = w->points.list[to->order[k]].at.frame.m[a][b];
}

/* True if points and slots are in order without gaps, with any guides nearer to the base. (The usual case.) */
static bool in_order_of_slots(const insertion_workspace *w, const int order[MAX_POINTS]) {
    bool in_order = true;
    for (int k = 0; k < w->points.count && in_order; k++)
        in_order = order[k] == k && (w->points.list[k].kind != POINT_TISSUE || w->points.list[k].handle - k == w->points.list[w->points.guided].handle - w->points.guided);
    return in_order;
}

static void put_tissue(between_rows to, int l, const mat3 *block, bool transposed) {
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) to[a][b][l] = transposed ? block->m[b][a] : block->m[a][b];
}

/* Between two points, neither of which is at the tip. */
static mat3 between_contacts(const tick_context *tick, int i, int j) {
    const insertion_workspace *w = tick->scratch;
    if (i < w->points.guided || j < w->points.guided) return (mat3){{{0}}};
    return m3_scaled(w->creep.yield, compliance_between(tick->snapshot, w->points.list[i].handle, w->points.list[j].handle));
}

/* Compliance of the tissue between the point in place k and those from there on. */
static void lay_out_tissue(const tick_context *tick, const int *order, int k, between_rows to) {
    const insertion_workspace *w = tick->scratch;
    int i = order[k];
    for (int l = k; l < w->points.count; l++) {
        int j = order[l];
        if (w->points.list[i].kind == POINT_TIP) put_tissue(to, l, &w->tissue.tip_row[j], false);
        else if (w->points.list[j].kind == POINT_TIP) put_tissue(to, l, &w->tissue.tip_row[i], true);
        else {
            mat3 block = between_contacts(tick, i, j);
            put_tissue(to, l, &block, false);
        }
    }
}

/* ---- needle ---------------------------------------------------------------------------------------------------------- */

/* How the joints move under unit forces at each point. */
static void interpolate_columns(insertion_workspace *w, const int *order) {
    between_interpolation columns[MAX_POINTS];
    for (int k = 0; k < w->points.count; k++) columns[k] = (between_interpolation){w->points.list[order[k]].at.first, w->points.list[order[k]].at.weights};
    between_interpolate(w->response.tangent.compliance[0], NEEDLE_LD, w->points.count, columns, w->joints_to_points);
}

/* ---- blocks ---------------------------------------------------------------------------------------------------------- */

/* Stores the block of points i (rows) and j in the upper triangle. */
static void put_block(contact_problem *p, int i, int j, const mat3 *block) {
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            int row = unknown(p->count, i, a), column = unknown(p->count, j, b);
            if (row <= column) p->compliance[row][column] = block->m[a][b];
            else p->compliance[column][row] = block->m[a][b];
        }
}

/* A guide that the needle does not touch is coupled to nothing. */
static void uncouple_guide(insertion_workspace *w, int i) {
    static const mat3 nothing;
    for (int j = 0; j < w->points.count; j++) put_block(&w->problem, i, j, &nothing);
}

/* Stores the blocks of the point in place k with itself and those beyond. */
static void put_blocks(insertion_workspace *w, const int *order, int k, between_rows blocks) {
    for (int l = k; l < w->points.count; l++) {
        mat3 block;
        for (int a = 0; a < 9; a++) block.m[a / 3][a % 3] = blocks[a / 3][a % 3][l];
        put_block(&w->problem, order[k], order[l], &block);
    }
}

/* The tissue of the points from place k on, in order: between contacts as the snapshot has it. */
static void read_tissue(const tick_context *tick, int k, between_points_row *row) {
    static const double none[BETWEEN_PLACES];
    const insertion_workspace *w = tick->scratch;
    const contact_point *point = &w->points.list[k];
    for (int a = 0; a < 9; a++)
        row->tissue[a / 3][a % 3] = point->kind == POINT_TISSUE ? tick->snapshot->between_contacts[point->handle].at[a / 3][a % 3] : none;
    row->shift = point->kind == POINT_TISSUE ? point->handle - k : 0;
    row->lowest = point->kind == POINT_TISSUE ? w->points.guided : 0;
    row->yield = w->creep.yield;
    row->tip_place = w->points.count - w->points.tip;
    if (w->points.tip) row->at_tip = point->kind == POINT_TIP ? w->tissue.tip_row[k] : m3_transposed(&w->tissue.tip_row[k]);
}

/* Blocks of the point in place k with those from there on. */
static void find_blocks(const tick_context *tick, layout *places, between_kernel *kernel, int k, between_rows blocks) {
    const insertion_workspace *w = tick->scratch;
    const needle_point *point = &w->points.list[places->order[k]].at;
    between_points_row row = {.begin = k, .end = w->points.count, .frame = &point->frame, .weights = point->weights, .needle = (const between_components *)&w->joints_to_points[3 * point->first],
                              .yield = 1.0, .tip_place = w->points.count, .mount = tick->base.compliance, .frames = (const between_rows *)&places->frames};
    if (places->in_order) {
        read_tissue(tick, k, &row);
    } else {
        lay_out_tissue(tick, places->order, k, places->tissue);
        for (int a = 0; a < 9; a++) row.tissue[a / 3][a % 3] = places->tissue[a / 3][a % 3];
    }
    kernel(&row, blocks);
}

void assemble_between_points(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    _Alignas(CACHE_LINE) layout places;
    _Alignas(CACHE_LINE) between_rows blocks;
    between_kernel *kernel = between_kernel_here();
    places.order[0] = 0;
    sort_points(w, places.order);
    places.in_order = in_order_of_slots(w, places.order);
    lay_out_frames(w, &places);
    interpolate_columns(w, places.order);
    for (int k = w->points.count - 1; k >= 0; k--) { /* toward the base: see between_store */
        find_blocks(tick, &places, kernel, k, blocks);
        if (places.in_order) between_store(w->problem.count, k, blocks, w->problem.compliance);
        else put_blocks(w, places.order, k, blocks);
    }
    for (int i = 0; i < w->points.guided; i++)
        if (guides_is_open(&w->points, w->edges, i)) uncouple_guide(w, i);
}
