#include "condensed/substructure.h"

#include <cblas.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tissue/node_order.h"

/* Rows and columns of a tile, a multiple of the block size 3. The fronts' contributions are subtracted from the region's triangle tile by tile. */
enum { TILE = 288 };

/* How part of the body responds to a load: |load|^2, and the energy |L^-1 load|^2 = load^T K^-1 load with the rest of the body fixed. */
typedef struct { double squares, energy; } response;

/* ---- plan ------------------------------------------------------------------------------------------------------------- */

/* The rows of a front, counted in nodes: first the pivots, then nodes that are eliminated later, then nodes of the region. */
typedef struct {
    const int *rows;         /* positions of the rows' nodes in the elimination order, ascending */
    int pivots, columns, count; /* columns: pivots and nodes eliminated later; count: all rows */
} extent;

static extent extent_of(const substructure *s, int front) {
    const cholmod_factor *f = s->symbolic;
    const int *super = f->super, *pi = f->pi;
    extent e = {.rows = (const int *)f->s + pi[front], .count = pi[front + 1] - pi[front]};
    while (e.columns < e.count && s->region[e.rows[e.columns]] < 0) e.columns++;
    int own = super[front + 1] - super[front];
    e.pivots = e.columns < own ? e.columns : own;
    return e;
}

/* Returns the memory (bytes) that a front takes after its pivots have been eliminated, until its parent takes over the remaining columns. */
static double rest_bytes(const extent *e) { return panels_bytes(3 * (e->count - e->pivots), 3 * (e->columns - e->pivots)); }

static double operations_of(const extent *e) {
    double sum = 0.0;
    for (int i = 0; i < 3 * e->pivots; i++) sum += pow(3.0 * e->count - i, 2);
    return sum;
}

/* Bytes: peak memory while a subtree is eliminated, and memory still allocated afterwards. */
typedef struct { double peak, rest; } memory_estimate;

/* Inserts a child into the list of its siblings. The list is in elimination order: descending peak memory minus remaining memory (Liu 1986). */
static void insert_child(substructure *s, const memory_estimate *estimates, int *list, int child) {
    double key = estimates[child].peak - estimates[child].rest;
    while (*list >= 0 && estimates[*list].peak - estimates[*list].rest >= key) list = &s->next[*list];
    s->next[child] = *list;
    *list = child;
}

/* Returns the memory (bytes) still taken by a front's later columns once its parent has taken over those before the parent's row `end`. */
static double left_bytes(const extent *e, const int *local, int end) {
    enum { WIDTH = PANEL_WIDTH / 3 };
    double numbers = 0.0;
    for (int first = e->pivots; first < e->columns; first += WIDTH) {
        int width = e->columns - first < WIDTH ? e->columns - first : WIDTH;
        if (local[e->rows[first + width - 1]] >= end) numbers += 9.0 * width * (e->count - first);
    }
    return sizeof(double) * numbers;
}

/* Returns the peak memory (bytes) while a front is eliminated. Its panels are created one by one, and take over its children's columns. */
static double front_peak(const substructure *s, const extent *e, int first_child, const int *local) {
    double here = 0.0, peak = 0.0;
    panels own;
    if (!panels_divide(&own, 3 * e->count, 3 * e->columns, 3 * e->pivots)) return INFINITY;
    for (int j = 0; j < own.count; j++) {
        double left = 0.0;
        here += sizeof(double) * (double)own.panels[j].rows * own.panels[j].width;
        for (int c = first_child; c >= 0; c = s->next[c]) {
            extent child = extent_of(s, c);
            left += left_bytes(&child, local, own.panels[j].first / 3);
        }
        peak = fmax(peak, here + left);
    }
    panels_free(&own);
    return peak;
}

/* Returns the peak memory (bytes) while a list of subtrees is eliminated, one after another. */
static double list_peak(const substructure *s, const memory_estimate *estimates, int first) {
    double before = 0.0, peak = 0.0;
    for (int c = first; c >= 0; c = s->next[c]) {
        peak = fmax(peak, before + estimates[c].peak);
        before += estimates[c].rest;
    }
    return peak;
}

/* Finds the order in which to eliminate the fronts: children before parents, and siblings in the order of their list. Fills the sequence from the end, using a
   stack. */
static bool find_sequence(substructure *s, int root) {
    int count = (int)s->symbolic->nsuper, depth = 0, end = count;
    int *stack = malloc(((size_t)count + 1) * sizeof *stack);
    if (!stack) return false;
    for (int c = root; c >= 0; c = s->next[c]) stack[depth++] = c;
    while (depth > 0) {
        int front = stack[--depth];
        s->sequence[--end] = front;
        for (int c = s->first_child[front]; c >= 0; c = s->next[c]) stack[depth++] = c;
    }
    free(stack);
    return true;
}

enum { PANEL_NODES = PANEL_WIDTH / 3 };

/* Finds the blocks of the region's triangle that have entries, and adds the operations needed to factorise it to the total. */
static bool find_filled(substructure *s) {
    const int *super = s->symbolic->super, *pi = s->symbolic->pi, *rows = s->symbolic->s;
    int count = (s->region_count + PANEL_NODES - 1) / PANEL_NODES;
    s->filled = calloc((size_t)count * (size_t)count + 1, sizeof *s->filled);
    if (!s->filled) return false;
    for (int f = 0; f < (int)s->symbolic->nsuper; f++)
        for (int column = super[f], from = pi[f]; column < super[f + 1]; column++, from++)
            for (int k = from; k < pi[f + 1] && s->region[column] >= 0; k++)
                s->filled[s->region[rows[k]] / PANEL_NODES * count + s->region[column] / PANEL_NODES] = true;
    double block = pow(PANEL_WIDTH, 3);
    for (int j = 0; j < count; j++)
        for (int i = j; i < count; i++) {
            if (!s->filled[i * count + j]) continue;
            s->operations += i == j ? block / 3.0 : block;
            for (int k = 0; k < j; k++) s->operations += s->filled[i * count + k] && s->filled[j * count + k] ? (i == j ? block : 2.0 * block) : 0.0;
        }
    return true;
}

static bool find_tree(substructure *s) {
    int count = (int)s->symbolic->nsuper, root = -1;
    const int *super = s->symbolic->super;
    memory_estimate *estimates = calloc((size_t)count + 1, sizeof *estimates);
    int *front_of = malloc((size_t)s->nodes * sizeof *front_of), *local = malloc((size_t)s->nodes * sizeof *local);
    bool done = estimates && front_of && local;
    for (int f = 0; f < count && done; f++)
        for (int place = super[f]; place < super[f + 1]; place++) front_of[place] = f;
    for (int f = 0; f < count && done; f++) {
        extent e = extent_of(s, f);
        for (int row = 0; row < e.count; row++) local[e.rows[row]] = row;
        estimates[f] = (memory_estimate){fmax(list_peak(s, estimates, s->first_child[f]), front_peak(s, &e, s->first_child[f], local)), rest_bytes(&e)};
        s->operations += operations_of(&e);
        int *list = e.columns > e.pivots ? &s->first_child[front_of[e.rows[e.pivots]]] : &root;
        insert_child(s, estimates, list, f);
    }
    if (done) s->bytes += list_peak(s, estimates, root);
    done = done && find_sequence(s, root);
    free(estimates);
    free(front_of);
    free(local);
    return done;
}

static double matrix_bytes(tissue *t) {
    return (double)cholmod_nnz(t->stiffness, &t->common) * (sizeof(double) + sizeof(int));
}

typedef struct { int place, node; } neighbour;

static int compare_places(const void *a, const void *b) {
    const neighbour *left = a, *right = b;
    return left->place != right->place ? (left->place > right->place) - (left->place < right->place) : (left->node > right->node) - (left->node < right->node);
}

/* Appends nodes to `order`, sorted by their first neighbour among the `placed` nodes already there. */
static bool sort_by_neighbours(const cholmod_sparse *graph, int placed, int count, const int *nodes, int *order) {
    const int *start = graph->p, *row = graph->i;
    int all = (int)graph->nrow;
    int *place = malloc((size_t)all * sizeof *place), *first = malloc((size_t)all * sizeof *first);
    neighbour *sorted = malloc(((size_t)count + 1) * sizeof *sorted);
    bool done = place && first && sorted;
    for (int i = 0; i < all && done; i++) place[i] = first[i] = all;
    for (int i = 0; i < placed && done; i++) place[order[i]] = i;
    for (int j = 0; j < all && done; j++)
        for (int k = start[j]; k < start[j + 1]; k++) {
            if (place[row[k]] < first[j]) first[j] = place[row[k]];
            if (place[j] < first[row[k]]) first[row[k]] = place[j];
        }
    for (int i = 0; i < count && done; i++) sorted[i] = (neighbour){first[nodes[i]], nodes[i]};
    if (done) qsort(sorted, (size_t)count, sizeof *sorted, compare_places);
    for (int i = 0; i < count && done; i++) order[placed + i] = sorted[i].node;
    free(place);
    free(first);
    free(sorted);
    return done;
}

/* Puts the nodes outside the region first, then the region's nodes without neighbours outside, then those on its border. Eliminating the outside nodes couples
   only border nodes, so many blocks of the region's triangle stay empty. The border nodes are sorted so that the filled blocks are contiguous. */
static bool order_nodes(const substructure *s, const cholmod_sparse *graph, const bool *last, int *order) {
    enum { OUTSIDE, INNER, BORDER, GROUPS };
    const int *start = graph->p, *row = graph->i;
    char *group = malloc((size_t)s->nodes);
    int *listed = malloc((size_t)s->nodes * sizeof *listed), counts[GROUPS] = {0}, filled = 0;
    bool done = group && listed;
    for (int j = 0; j < s->nodes && done; j++) group[j] = last[j] ? INNER : OUTSIDE;
    for (int j = 0; j < s->nodes && done; j++)
        for (int k = start[j]; k < start[j + 1]; k++)
            if (last[row[k]] != last[j]) group[last[j] ? j : row[k]] = BORDER;
    for (char g = 0; g < GROUPS && done; g++)
        for (int j = 0; j < s->nodes; j++)
            if (group[j] == g) {
                listed[filled++] = j;
                counts[(int)g]++;
            }
    const int *inner = listed + counts[OUTSIDE], *border = inner + counts[INNER];
    done = done && node_dissect(s->tissue, graph, counts[OUTSIDE], listed, order)
         && node_dissect(s->tissue, graph, counts[INNER], inner, order + counts[OUTSIDE])
         && sort_by_neighbours(graph, counts[INNER], counts[BORDER], border, order + counts[OUTSIDE]);
    free(group);
    free(listed);
    return done;
}

static bool analyse(substructure *s, const bool *last) {
    tissue *t = s->tissue;
    int *order = malloc((size_t)s->nodes * sizeof *order);
    cholmod_sparse *graph = order ? node_graph(t) : NULL;
    if (graph && order_nodes(s, graph, last, order)) {
        t->common.nmethods = 1;
        t->common.method[0].ordering = CHOLMOD_GIVEN;
        s->symbolic = cholmod_analyze_p(graph, order, NULL, 0, &t->common);
    }
    cholmod_free_sparse(&graph, &t->common);
    free(order);
    return s->symbolic != NULL;
}

static bool plan(substructure *s, const bool *last) {
    size_t nodes = (size_t)s->nodes;
    if (!last || !(s->region = malloc(nodes * sizeof *s->region)) || !analyse(s, last)) return false;
    const int *order = s->symbolic->Perm;
    for (int place = 0; place < s->nodes; place++) s->region[place] = last[order[place]] ? s->region_count++ : -1;
    size_t fronts = s->symbolic->nsuper + 1;
    s->first_child = malloc(fronts * sizeof *s->first_child);
    s->next = malloc(fronts * sizeof *s->next);
    s->sequence = malloc(fronts * sizeof *s->sequence);
    if (!s->first_child || !s->next || !s->sequence) return false;
    for (size_t i = 0; i < fronts; i++) s->first_child[i] = s->next[i] = -1;
    double matrix = matrix_bytes(s->tissue), tiles = (double)TILE * TILE * team_members(s->team) * sizeof(double);
    s->bytes = matrix + tiles + panels_bytes(3 * s->region_count, 3 * s->region_count);
    s->bytes += (double)nodes * (2.0 * sizeof(int) + sizeof(response)); /* the elimination's scratch per node */
    if (!find_filled(s) || !find_tree(s)) return false;
    s->bytes = fmax(s->bytes, 2.0 * matrix); /* reordering K needs two copies of it */
    return true;
}

/* Lists the region's free nodes in the row order of the triangle. */
static bool list_nodes(const substructure *s, int count, const int *region, int *nodes) {
    const tissue *t = s->tissue;
    const int *order = s->symbolic->Perm;
    int *place = malloc((size_t)s->nodes * sizeof *place);
    for (int i = 0; place && i < s->nodes; i++) place[order[i]] = i;
    for (int i = 0; place && i < count; i++)
        if (t->dof[region[i]] >= 0) nodes[s->region[place[t->dof[region[i]] / 3]]] = region[i];
    free(place);
    return place != NULL;
}

trocar_status substructure_plan(tissue *t, team *team, int count, const int *region, int *nodes, substructure *s, trocar_error *why) {
    *s = (substructure){.tissue = t, .team = team, .nodes = t->dof_count / 3};
    bool *last = mark_free_nodes(t, count, region);
    bool planned = plan(s, last) && list_nodes(s, count, region, nodes);
    free(last);
    if (planned) return TROCAR_OK;
    substructure_free(s);
    if (t->common.status == CHOLMOD_TOO_LARGE)
        return fail(why, TROCAR_BAD_INPUT, "the elimination of %d nodes has more than 2^31 entries to order, too many: make the mesh coarser",
                    t->dof_count / 3);
    return fail(why, TROCAR_NO_MEMORY, "no memory to order the elimination of %d nodes", t->dof_count / 3);
}

void substructure_free(substructure *s) {
    if (s->tissue) cholmod_free_factor(&s->symbolic, &s->tissue->common);
    free(s->region);
    free(s->filled);
    free(s->first_child);
    free(s->next);
    free(s->sequence);
    *s = (substructure){0};
}

/* ---- elimination ------------------------------------------------------------------------------------------------------ */

typedef struct {
    extent size;
    panels matrix;           /* columns of the pivots and of nodes eliminated later, with all rows */
    int pivot_panels;
    double *load;            /* load on the front's rows, 3 size.count entries */
    response below;          /* response of the pivots of this front and of all its descendants in the tree */
    int taken, taken_panels; /* number of columns (in nodes) and panels eliminated or taken over by the parent so far */
} front;

typedef struct {
    const substructure *plan;
    cholmod_sparse *k;       /* lower triangle of K in elimination order */
    front **fronts;          /* front of each supernode; NULL before it is started and after its parent has taken it over */
    panels *corner;
    int *local;              /* row of each node in the current front; plan->nodes entries */
    double *load;            /* load on the region, 3 region_count entries */
    double *tiles;           /* scratch: a TILE x TILE matrix for each team member */
    int *piece;              /* union-find forest of connected components, plan->nodes entries: each node's parent, which is in the same component; the
                                representative's parent is itself */
    response *of_piece;      /* response of each connected component, at the index of its representative; plan->nodes entries */
    double norm;             /* largest column sum of K, an upper bound on its largest eigenvalue */
    inverse_progress progress;
    trocar_error *why;
    double done;             /* number of operations completed */
    int shown;               /* last progress reported, in per cent */
} elimination;

static void show(inverse_progress progress, double fraction) {
    if (progress.show) progress.show("eliminating the tissue outside the region", fraction, progress.context);
}

/* Reports progress: the operations completed in all previous fronts, plus `here` in this one. CANCELLED. */
static trocar_status show_done(elimination *e, double here) {
    int percent = (int)(100.0 * (e->done + here) / e->plan->operations);
    if (percent <= e->shown || percent >= 100) return TROCAR_OK;
    show(e->progress, 0.01 * (e->shown = percent));
    return inverse_go_on(e->progress, e->why);
}

static void front_free(front *f) {
    if (!f) return;
    panels_free(&f->matrix);
    free(f->load);
    free(f);
}

static front *front_create(const extent *e) {
    front *f = calloc(1, sizeof *f);
    if (!f) return NULL;
    f->size = *e;
    f->load = calloc(3 * (size_t)e->count, sizeof *f->load);
    if (!f->load || !panels_divide(&f->matrix, 3 * e->count, 3 * e->columns, 3 * e->pivots)) {
        front_free(f);
        return NULL;
    }
    f->pivot_panels = (3 * e->pivots + PANEL_WIDTH - 1) / PANEL_WIDTH;
    f->taken = e->pivots;
    f->taken_panels = f->pivot_panels;
    return f;
}

static double load_at(const substructure *s, int row) { return tissue_test_load(3 * ((const int *)s->symbolic->Perm)[row / 3] + row % 3); }

/* Returns a column of the matrix, numbered in the whole matrix, from the panel that contains it. Its rows start at p->first. */
static double *column_at(const panel *p, int column) { return (double *)p->values + (size_t)(column - p->first) * (size_t)p->rows; }

/* Adds the columns of K and the loads for the pivots in this panel to the front. */
static void add_stiffness(const elimination *e, front *f, panel *p) {
    const int *start = e->k->p, *row = e->k->i;
    const double *value = e->k->x;
    for (int column = p->first; column < p->first + p->width; column++) {
        int at = 3 * f->size.rows[column / 3] + column % 3;
        double *into = column_at(p, column);
        for (int k = start[at]; k < start[at + 1]; k++) into[3 * e->local[row[k] / 3] + row[k] % 3 - p->first] += value[k];
        double load = load_at(e->plan, at);
        f->load[column] += load;
        f->below.squares += load * load;
    }
}

/* The task of adding a child's nodes [child->taken, end) to a panel, in groups of nodes. */
typedef struct {
    const elimination *elimination;
    const front *child;
    const panel *to;
    int end;
} addition;

enum { GROUP = 16 };         /* a thread adds this many of a child's nodes at a time */

static void add_columns(void *context, int i, int member) {
    (void)member;
    const addition *a = context;
    const front *child = a->child;
    const extent *c = &child->size;
    const int *local = a->elimination->local;
    int first = child->taken + i * GROUP, end = first + GROUP < a->end ? first + GROUP : a->end;
    for (int column = 3 * first; column < 3 * end; column++) {
        const panel *from = &child->matrix.panels[child->pivot_panels + (column - 3 * c->pivots) / PANEL_WIDTH];
        const double *values = column_at(from, column);
        double *into = column_at(a->to, 3 * local[c->rows[column / 3]] + column % 3);
        for (int row = column / 3; row < c->count; row++) {
            int to = 3 * local[c->rows[row]] - a->to->first, at = 3 * row - from->first;
            for (int b = 0; b < 3; b++) into[to + b] += values[at + b];
        }
    }
}

/* Adds a child's columns to this panel, and frees those of the child's panels that have been added completely. */
static void add_child(const elimination *e, front *child, panel *p) {
    const extent *c = &child->size;
    addition a = {e, child, p, child->taken};
    while (a.end < c->columns && 3 * e->local[c->rows[a.end]] < p->first + p->width) a.end++;
    int added = a.end - child->taken;
    bool large = (double)added * c->count > 1e4;
    team_run(large ? e->plan->team : NULL, (added + GROUP - 1) / GROUP, add_columns, &a);
    child->taken = a.end;
    for (; child->taken_panels < child->matrix.count; child->taken_panels++) {
        panel *from = &child->matrix.panels[child->taken_panels];
        if (from->first + from->width > 3 * a.end) return;
        panel_release(from);
    }
}

/* The task of subtracting a front's contribution from the region, tile by tile in the lower triangle. */
typedef struct {
    const elimination *elimination;
    const front *front;
} contribution;

static void subtract_tile(void *context, int i, int member) {
    const contribution *c = context;
    const elimination *e = c->elimination;
    const front *f = c->front;
    const int *rows = f->size.rows + f->size.columns, *region = e->plan->region;
    int above = (int)((sqrt(8.0 * i + 1.0) - 1.0) / 2.0), count = 3 * (f->size.count - f->size.columns); /* above: number of tile rows above this tile */
    int row = above * TILE, column = (i - above * (above + 1) / 2) * TILE;
    int height = count - row < TILE ? count - row : TILE, width = count - column < TILE ? count - column : TILE;
    double *tile = e->tiles + (size_t)member * TILE * TILE;
    for (int k = 0; k < f->pivot_panels; k++)
        panel_multiply(&f->matrix.panels[k], 3 * f->size.columns + row, height, 3 * f->size.columns + column, width, 1.0, k == 0 ? 0.0 : 1.0, tile, height);
    for (int b = 0; b < width; b++) {
        int at = 3 * region[rows[(column + b) / 3]] + (column + b) % 3;
        const panel *p = &e->corner->panels[at / PANEL_WIDTH];
        double *into = column_at(p, at);
        for (int a = row == column ? b : 0; a < height; a++)
            into[3 * region[rows[(row + a) / 3]] + (row + a) % 3 - p->first] -= tile[(size_t)b * (size_t)height + (size_t)a];
    }
}

/* Subtracts the pivots' contribution from the region's triangle. */
static void subtract_from_region(const elimination *e, const front *f) {
    int size = f->size.count - f->size.columns, across = (3 * size + TILE - 1) / TILE;
    team_run(e->plan->team, across * (across + 1) / 2, subtract_tile, &(contribution){e, f});
}

static int piece_of(const elimination *e, int place) {
    while (e->piece[place] != place) place = e->piece[place] = e->piece[e->piece[place]];
    return place;
}

/* Adds one node's energy to that of its connected component, and returns it. `y`: the node's part of L^-1 load. */
static double add_energy(elimination *e, int place, const double y[3]) {
    double energy = y[0] * y[0] + y[1] * y[1] + y[2] * y[2];
    e->of_piece[piece_of(e, place)].energy += energy;
    return energy;
}

/* True if a part of the body is sufficiently constrained. The ratio of |load|^2 to the energy is an upper bound on the part's smallest eigenvalue, and close
   to it if the part is barely constrained. With the rest of the body fixed, no part has a smaller eigenvalue than the whole body (interlacing). Testing only
   the whole body would miss a small, barely constrained part next to a large one. */
static bool is_constrained(const elimination *e, const response *part) { return part->squares >= LOOSE_BODY * e->norm * part->energy; }

/* Solves L y = load for the pivots. Adds the remaining load on the region's nodes to the load on the region; the parent takes over the rest (take_loads). */
static void pass_load(elimination *e, front *f) {
    panels_forward(&f->matrix, f->pivot_panels, f->load);
    for (int row = 0; row < f->size.pivots; row++) f->below.energy += add_energy(e, f->size.rows[row], f->load + 3 * row);
    for (int row = f->size.columns; row < f->size.count; row++)
        for (int a = 0; a < 3; a++) e->load[3 * e->plan->region[f->size.rows[row]] + a] += f->load[3 * row + a];
}

static void take_loads(const elimination *e, front *f, int first_child) {
    for (int c = first_child; c >= 0; c = e->plan->next[c]) {
        const front *child = e->fronts[c];
        f->below.squares += child->below.squares;
        f->below.energy += child->below.energy;
        for (int row = child->size.pivots; row < child->size.columns; row++)
            for (int a = 0; a < 3; a++) f->load[3 * e->local[child->size.rows[row]] + a] += child->load[3 * row + a];
    }
}

static trocar_status eliminate_front(elimination *e, int number) {
    extent size = extent_of(e->plan, number);
    if (size.pivots == 0) return TROCAR_OK;
    front *f = e->fronts[number] = front_create(&size);
    if (!f) return TROCAR_NO_MEMORY;
    for (int row = 0; row < size.count; row++) e->local[size.rows[row]] = row;
    int first_child = e->plan->first_child[number];
    double operations = operations_of(&size);
    take_loads(e, f, first_child);
    for (int j = 0; j < f->matrix.count; j++) {
        panel *p = &f->matrix.panels[j];
        if (!panel_allocate(p, e->plan->team)) return TROCAR_NO_MEMORY;
        if (j < f->pivot_panels) add_stiffness(e, f, p);
        for (int c = first_child; c >= 0; c = e->plan->next[c]) add_child(e, e->fronts[c], p);
        if (!panels_eliminate(&f->matrix, j, f->pivot_panels, e->plan->team)) return TROCAR_BAD_INPUT;
        trocar_status status = show_done(e, operations * (j + 1) / (f->matrix.count + 1));
        if (status != TROCAR_OK) return status;
    }
    for (int c = first_child; c >= 0; c = e->plan->next[c]) {
        front_free(e->fronts[c]);
        e->fronts[c] = NULL;
    }
    subtract_from_region(e, f);
    pass_load(e, f);
    if (!is_constrained(e, &f->below)) return TROCAR_BAD_INPUT;
    for (int k = 0; k < f->pivot_panels; k++) panel_release(&f->matrix.panels[k]);
    e->done += operations;
    return show_done(e, 0.0);
}

/* Returns a copy of K in elimination order. */
static cholmod_sparse *reorder(const substructure *s) {
    cholmod_common *common = &s->tissue->common;
    const int *by_node = s->symbolic->Perm;
    int *order = malloc(3 * (size_t)s->nodes * sizeof *order);
    for (int i = 0; order && i < 3 * s->nodes; i++) order[i] = 3 * by_node[i / 3] + i % 3;
    cholmod_sparse *upper = order ? cholmod_ptranspose(s->tissue->stiffness, 1, order, NULL, 0, common) : NULL;
    cholmod_sparse *lower = upper ? cholmod_transpose(upper, 1, common) : NULL;
    cholmod_free_sparse(&upper, common);
    free(order);
    return lower;
}

/* Copies the region's block of K to the corner, and adds the loads on the region's nodes. */
static bool begin_corner(elimination *e) {
    const substructure *s = e->plan;
    const int *start = e->k->p, *row = e->k->i;
    const double *value = e->k->x;
    int size = 3 * s->region_count;
    bool created = panels_divide(e->corner, size, size, size);
    size_t blocks = (size_t)e->corner->count * (size_t)e->corner->count;
    if (created && (created = (e->corner->filled = malloc(blocks + 1)) != NULL)) memcpy(e->corner->filled, s->filled, blocks);
    for (int j = 0; j < e->corner->count && created; j++) created = panel_allocate(&e->corner->panels[j], s->team);
    for (int place = 0; place < 3 * s->nodes && created; place++) {
        if (s->region[place / 3] < 0) continue;
        int column = 3 * s->region[place / 3] + place % 3;
        const panel *p = &e->corner->panels[column / PANEL_WIDTH];
        double *into = column_at(p, column);
        for (int k = start[place]; k < start[place + 1]; k++) into[3 * s->region[row[k] / 3] + row[k] % 3 - p->first] += value[k];
        e->load[column] += load_at(s, place);
    }
    return created;
}

/* Finds the connected components of the body, and sums the squared loads of each. */
static void find_pieces(elimination *e) {
    const int *start = e->k->p, *row = e->k->i;
    for (int place = 0; place < e->plan->nodes; place++) e->piece[place] = place;
    for (int place = 0; place < e->plan->nodes; place++)
        for (int k = start[3 * place]; k < start[3 * place + 1]; k++) e->piece[piece_of(e, row[k] / 3)] = piece_of(e, place);
    for (int at = 0; at < 3 * e->plan->nodes; at++) e->of_piece[piece_of(e, at / 3)].squares += pow(load_at(e->plan, at), 2);
}

static bool begin(elimination *e) {
    const substructure *s = e->plan;
    size_t size = 3 * (size_t)s->region_count;
    e->fronts = calloc(s->symbolic->nsuper, sizeof *e->fronts);
    e->local = malloc((size_t)s->nodes * sizeof *e->local);
    e->load = calloc(size, sizeof *e->load);
    e->tiles = malloc((size_t)team_members(s->team) * TILE * TILE * sizeof *e->tiles);
    e->piece = malloc((size_t)s->nodes * sizeof *e->piece);
    e->of_piece = calloc((size_t)s->nodes, sizeof *e->of_piece);
    if (!(e->fronts && e->local && e->load && e->tiles && e->piece && e->of_piece && (e->k = reorder(s)))) return false;
    find_pieces(e);
    return begin_corner(e);
}

static trocar_status eliminate_all(elimination *e) {
    const substructure *s = e->plan;
    trocar_status status = TROCAR_OK;
    for (int i = 0; i < (int)s->symbolic->nsuper && status == TROCAR_OK; i++) status = eliminate_front(e, s->sequence[i]);
    cholmod_free_sparse(&e->k, &s->tissue->common);
    for (int j = 0; j < e->corner->count && status == TROCAR_OK; j++) {
        status = panels_eliminate(e->corner, j, e->corner->count, s->team) ? TROCAR_OK : TROCAR_BAD_INPUT;
        if (status == TROCAR_OK) status = show_done(e, (s->operations - e->done) * (j + 1) / e->corner->count);
    }
    if (status != TROCAR_OK) return status;
    panels_forward(e->corner, e->corner->count, e->load);
    for (int place = 0; place < s->nodes; place++)
        if (s->region[place] >= 0) add_energy(e, place, e->load + 3 * s->region[place]);
    for (int place = 0; place < s->nodes; place++)
        if (!is_constrained(e, &e->of_piece[place])) return TROCAR_BAD_INPUT;
    show(e->progress, 1.0);
    return TROCAR_OK;
}

trocar_status substructure_eliminate(const substructure *s, panels *corner, inverse_progress progress, trocar_error *why) {
    elimination e = {.plan = s, .corner = corner, .progress = progress, .why = why};
    e.norm = cholmod_norm_sparse(s->tissue->stiffness, 1, &s->tissue->common);
    *corner = (panels){0};
    show(progress, 0.0);
    trocar_status status = inverse_go_on(progress, why);
    if (status == TROCAR_OK) status = begin(&e) ? eliminate_all(&e) : TROCAR_NO_MEMORY;
    for (size_t i = 0; e.fronts && i < s->symbolic->nsuper; i++) front_free(e.fronts[i]);
    cholmod_free_sparse(&e.k, &s->tissue->common);
    free(e.fronts);
    free(e.local);
    free(e.load);
    free(e.tiles);
    free(e.piece);
    free(e.of_piece);
    if (status == TROCAR_OK) return status;
    panels_free(corner);
    if (status == TROCAR_CANCELLED) return status;
    return status == TROCAR_NO_MEMORY ? fail(why, status, "no memory to eliminate %d nodes", s->nodes - s->region_count) : tissue_loose(why);
}
