#include "insertion/contact/between_points.h"

#include "insertion/guide/guides.h"
#include "linalg/between_kernels.h"

/* The order of the points from base to tip, and what the blocks between them are computed from. */
typedef struct {
    int order[MAX_POINTS];           /* order[k]: index in the list of the point that is k-th from the base */
    bool in_order;                   /* see in_order_of_slots */
    _Alignas(CACHE_LINE) between_rows frames; /* [a][b]: component a of axis b of each point's frame */
    between_rows tissue;             /* m/N, world frame: compliance between one point (rows) and the others; used only if the points are not in slot order */
} layout;

/* ---- points ---------------------------------------------------------------------------------------------------------- */

/* Sorts the points from base to tip. In the list, guides come first even if there are tissue contacts nearer to the base. */
static void sort_points(const contact_points *points, int order[MAX_POINTS]) {
    for (int i = 0; i < points->count; i++) {
        int at = i;
        for (; at > 0 && points->list[order[at - 1]].at.first > points->list[i].at.first; at--) order[at] = order[at - 1];
        order[at] = i;
    }
}

static void lay_out_frames(const contact_points *points, layout *to) {
    for (int k = 0; k < points->count; k++)
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) to->frames[a][b][k] = points->list[to->order[k]].at.frame.m[a][b];
}

/* True if all guides come before the tissue contacts and these occupy consecutive slots in the same order as the points. This is the usual case. */
static bool in_order_of_slots(const contact_points *points, const int order[MAX_POINTS]) {
    bool in_order = true;
    for (int k = 0; k < points->count && in_order; k++)
        in_order = order[k] == k && (points->list[k].kind != POINT_TISSUE || points->list[k].handle - k == points->list[points->guided].handle - points->guided);
    return in_order;
}

static void put_tissue(between_rows to, int l, const mat3 *block, bool transposed) {
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) to[a][b][l] = transposed ? block->m[b][a] : block->m[a][b];
}

/* Returns the tissue's compliance between two points, neither of which may be the tip. */
static mat3 between_contacts(const tick_input *tick, const contact_points *points, const creep_step *creep, int i, int j) {
    if (i < points->guided || j < points->guided) return (mat3){{{0}}};
    return m3_scaled(creep->yield, compliance_between(tick->snapshot, points->list[i].handle, points->list[j].handle));
}

/* Writes the tissue's compliance between the k-th point from the base and itself and all points nearer to the tip. */
static void lay_out_tissue(const tick_input *tick, const contact_points *points, const tissue_step *tissue, const creep_step *creep, const int *order, int k,
                           between_rows to) {
    int i = order[k];
    for (int l = k; l < points->count; l++) {
        int j = order[l];
        if (points->list[i].kind == POINT_TIP) put_tissue(to, l, &tissue->tip_row[j], false);
        else if (points->list[j].kind == POINT_TIP) put_tissue(to, l, &tissue->tip_row[i], true);
        else {
            mat3 block = between_contacts(tick, points, creep, i, j);
            put_tissue(to, l, &block, false);
        }
    }
}

/* ---- needle ---------------------------------------------------------------------------------------------------------- */

/* Interpolates, from the joints' compliance, how unit forces at each point displace the joints. */
static void interpolate_columns(const contact_points *points, const needle_response *response, between_components *joints_to_points, const int *order) {
    between_interpolation columns[MAX_POINTS];
    for (int k = 0; k < points->count; k++) columns[k] = (between_interpolation){points->list[order[k]].at.first, points->list[order[k]].at.weights};
    between_interpolate(response->tangent.compliance[0], NEEDLE_LD, points->count, columns, joints_to_points);
}

/* ---- blocks ---------------------------------------------------------------------------------------------------------- */

/* Stores the block of points i (rows) and j (columns) in the upper triangle. */
static void put_block(contact_problem *p, int i, int j, const mat3 *block) {
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            int row = unknown(p->count, i, a), column = unknown(p->count, j, b);
            if (row <= column) p->compliance[row][column] = block->m[a][b];
            else p->compliance[column][row] = block->m[a][b];
        }
}

/* Decouples a guide point where the needle does not touch the edge of its hole. */
static void uncouple_guide(const contact_points *points, contact_problem *problem, int i) {
    static const mat3 nothing;
    for (int j = 0; j < points->count; j++) put_block(problem, i, j, &nothing);
}

/* Stores the blocks that couple the k-th point from the base to itself and to the points nearer to the tip. */
static void put_blocks(const contact_points *points, contact_problem *problem, const int *order, int k, between_rows blocks) {
    for (int l = k; l < points->count; l++) {
        mat3 block;
        for (int a = 0; a < 9; a++) block.m[a / 3][a % 3] = blocks[a / 3][a % 3][l];
        put_block(problem, order[k], order[l], &block);
    }
}

/* Sets `row` to the tissue's compliance between point k and points k, k + 1, ... Works only for points in slot order, because it refers to the snapshot's rows
   instead of copying them. */
static void read_tissue(const tick_input *tick, const contact_points *points, const tissue_step *tissue, const creep_step *creep, int k, between_points_row *row) {
    static const double none[BETWEEN_PLACES];
    const contact_point *point = &points->list[k];
    for (int a = 0; a < 9; a++)
        row->tissue[a / 3][a % 3] = point->kind == POINT_TISSUE ? tick->snapshot->between_contacts[point->handle].at[a / 3][a % 3] : none;
    row->shift = point->kind == POINT_TISSUE ? point->handle - k : 0;
    row->lowest = point->kind == POINT_TISSUE ? points->guided : 0;
    row->yield = creep->yield;
    row->tip_place = points->count - points->tip;
    if (points->tip) row->at_tip = point->kind == POINT_TIP ? tissue->tip_row[k] : m3_transposed(&tissue->tip_row[k]);
}

/* Computes the blocks that couple the k-th point from the base to itself and to the points nearer to the tip. */
static void find_blocks(const tick_input *tick, const contact_points *points, const tissue_step *tissue, const creep_step *creep, between_components *joints_to_points,
                        layout *places, between_kernel *kernel, int k, between_rows blocks) {
    const needle_point *point = &points->list[places->order[k]].at;
    between_points_row row = {.begin = k, .end = points->count, .frame = &point->frame, .weights = point->weights, .needle = (const between_components *)&joints_to_points[3 * point->first],
                              .yield = 1.0, .tip_place = points->count, .mount = tick->base.compliance, .frames = (const between_rows *)&places->frames};
    if (places->in_order) {
        read_tissue(tick, points, tissue, creep, k, &row);
    } else {
        lay_out_tissue(tick, points, tissue, creep, places->order, k, places->tissue);
        for (int a = 0; a < 9; a++) row.tissue[a / 3][a % 3] = places->tissue[a / 3][a % 3];
    }
    kernel(&row, blocks);
}

void assemble_between_points(const tick_input *tick, insertion_workspace *w) {
    _Alignas(CACHE_LINE) layout places;
    _Alignas(CACHE_LINE) between_rows blocks;
    between_kernel *kernel = between_kernel_here();
    places.order[0] = 0;
    sort_points(&w->points, places.order);
    places.in_order = in_order_of_slots(&w->points, places.order);
    lay_out_frames(&w->points, &places);
    interpolate_columns(&w->points, &w->response, w->joints_to_points, places.order);
    for (int k = w->points.count - 1; k >= 0; k--) { /* tip first: between_store requires it */
        find_blocks(tick, &w->points, &w->tissue, &w->creep, w->joints_to_points, &places, kernel, k, blocks);
        if (places.in_order) between_store(w->problem.count, k, blocks, w->problem.compliance);
        else put_blocks(&w->points, &w->problem, places.order, k, blocks);
    }
    for (int i = 0; i < w->points.guided; i++)
        if (guides_is_open(&w->points, w->edges, i)) uncouple_guide(&w->points, &w->problem, i);
}
