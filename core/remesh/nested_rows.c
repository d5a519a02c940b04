/* Computes the rows for nested addition. K^-1 and the factors F^T are stored between all places, so that an addition works on contiguous rows: a row of F_j is
   a sum of rows of K^-1 and of earlier F_i. Blocks are requested from the owner of the inverse only for new nodes. An entry is the same sum whether it is
   computed from a row or from a new node's block, so the stored values depend, bit for bit, only on the contact nodes and their order. After the removal of a
   node on a face that was not the last node, this holds only to within rounding error. */
#include "remesh/nested.h"

#include <string.h>


enum { GATHERED_LD = 3 * MAX_COLUMNS };

_Static_assert(3 * MAX_CONTACTS % COLUMN_STEP == 0 && 3 * MAX_HANDLES % COLUMN_STEP == 0, "ranges of columns begin with a whole step");
_Static_assert(NESTED_LD % COLUMN_STEP == 0 && SNAPSHOT_LD % COLUMN_STEP == 0, "ranges of columns end within a row");

/* ---- places ---------------------------------------------------------------------------------------------------------- */

int nested_place(const nested_remesher *r, int node) {
    int handle = handle_of_node(&r->shared, node);
    for (int g = 0; g < r->extra_count && handle < 0; g++)
        if (r->extra[g] == node) return MAX_HANDLES + g;
    return handle;
}

/* Returns the nominal node at a place, which must be in the window or among the extra nodes. */
static int node_at(const nested_remesher *r, int place) {
    return place < MAX_HANDLES ? r->shared.window[place - MAX_CONTACTS] : r->extra[place - MAX_HANDLES];
}

/* Lists the places in use: the contact nodes in order, then the window, then the extra nodes. */
static int places_in_use(const nested_remesher *r, int places[MAX_PLACES]) {
    int count = handles_in_use(&r->shared, places);
    for (int g = 0; g < r->extra_count; g++) places[count++] = MAX_HANDLES + g;
    return count;
}

column_ranges nested_columns(const nested_remesher *r, int slot) {
    column_ranges columns = {.count = 0};
    int span = refinement_span(&r->shared.refined), last = MAX_WINDOW;
    while (last > 0 && r->shared.window[last - 1] < 0) last--;
    column_ranges_add(&columns, 0, 3 * (slot < span ? span : slot + 1));
    column_ranges_add(&columns, 3 * MAX_CONTACTS, 3 * (MAX_CONTACTS + last));
    return columns;
}

column_ranges nested_all_columns(const nested_remesher *r, int slot) {
    column_ranges columns = nested_columns(r, slot);
    column_ranges_add(&columns, 3 * MAX_HANDLES, 3 * (MAX_HANDLES + r->extra_count));
    return columns;
}

mat3 nested_factor(const nested_remesher *r, int j, int place) {
    mat3 factor;
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) factor.m[a][b] = r->factors[j][b][3 * place + a];
    return factor;
}

void nested_mirror(double *matrix, int ld, int place, int count, const int *places) {
    const double *rows = matrix + (size_t)(3 * place) * (size_t)ld;
    for (int i = 0; i < count; i++) {
        const double *from = rows + 3 * places[i];
        double *to = matrix + (size_t)(3 * places[i]) * (size_t)ld + 3 * place;
        if (places[i] == place) continue;
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) to[(size_t)b * (size_t)ld + (size_t)a] = from[(size_t)a * (size_t)ld + (size_t)b];
    }
}

/* ---- new nominal nodes ----------------------------------------------------------------------------------------------- */

/* Fetches the blocks between the new nodes and every node they are combined with: the nodes at other places, the corners of the contact nodes' elements, and
   the nodes coupled to surpluses. */
static trocar_status gather(nested_remesher *r, int count, const int *places, trocar_error *why) {
    remesher *shared = &r->shared;
    gather_start(shared);
    for (int i = 0; i < count; i++) gather_row(shared, node_at(r, places[i]));
    for (int k = 0; k < MAX_WINDOW; k++)
        if (shared->window[k] >= 0) gather_column(shared, shared->window[k]);
    for (int g = 0; g < r->extra_count; g++) gather_column(shared, r->extra[g]);
    for (int k = 0; k < shared->refined.count; k++) {
        int i = shared->refined.order[k];
        for (int c = 0; c < 4; c++) gather_column(shared, shared->tissue->mesh->tets[shared->refined.nodes[i].tet][c]);
        for (int p = 0; p < r->borders[i].nominal_count; p++) gather_column(shared, r->borders[i].nominal[p]);
    }
    return gather_finish(shared, why);
}

/* Returns the block of K^-1 between a new node and another one. The block's rows are GATHERED_LD apart. */
static const double *gathered(const nested_remesher *r, int node, int other) {
    const gathered_blocks *g = &r->shared.gathered;
    return g->blocks + (size_t)(3 * g->row_of[node]) * GATHERED_LD + 3 * g->column_of[other];
}

static void put_nominal(nested_remesher *r, int place, int other, const double *block, int ld) {
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) r->nominal[3 * place + a][3 * other + b] = r->nominal[3 * other + b][3 * place + a] = block[a * ld + b];
}

static void enter_nominal(nested_remesher *r, int place) {
    static const column_ranges block = {1, {{0, BLOCK_LD}}};
    int places[MAX_PLACES], count = places_in_use(r, places), node = node_at(r, place);
    for (int i = 0; i < count; i++) {
        if (places[i] >= MAX_CONTACTS) {
            put_nominal(r, place, places[i], gathered(r, node, node_at(r, places[i])), GATHERED_LD);
            continue;
        }
        const int *corners = r->shared.tissue->mesh->tets[r->shared.refined.nodes[places[i]].tet];
        weighted_triple parts[4];
        double between[3][BLOCK_LD];
        for (int c = 0; c < 4; c++) parts[c] = (weighted_triple){gathered(r, node, corners[c]), GATHERED_LD, r->borders[places[i]].weights[c]};
        rows_interpolate(&block, 4, parts, between[0], BLOCK_LD);
        put_nominal(r, place, places[i], between[0], BLOCK_LD);
    }
}

/* Computes every F_j at a nominal node, using the same sum as rows_add. For surpluses inside elements, F_j is zero there. */
static void enter_factors(nested_remesher *r, int place) {
    const refinement *refined = &r->shared.refined;
    double factors[MAX_CONTACTS][3][BLOCK_LD];
    int node = node_at(r, place);
    for (int k = 0; k < refined->count; k++) {
        int j = refined->order[k];
        const bordering *border = &r->borders[j];
        block_product parts[REACHED + MAX_CONTACTS];
        int count = 0;
        for (int p = 0; p < border->nominal_count; p++) parts[count++] = (block_product){gathered(r, node, border->nominal[p]), GATHERED_LD, &border->coupling[p]};
        for (int before = 0; before < k && border->on_face; before++) {
            int i = refined->order[before];
            if (r->borders[i].on_face) parts[count++] = (block_product){factors[i][0], BLOCK_LD, &border->chain[i]};
        }
        block_sum(count, parts, factors[j]);
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) r->factors[j][b][3 * place + a] = factors[j][a][b];
    }
}

trocar_status nested_enter(nested_remesher *r, int count, const int *places, trocar_error *why) {
    trocar_status status = gather(r, count, places, why);
    for (int i = 0; i < count && status == TROCAR_OK; i++) {
        enter_nominal(r, places[i]);
        enter_factors(r, places[i]);
    }
    return status;
}

/* ---- contact nodes --------------------------------------------------------------------------------------------------- */

void nested_interpolate(nested_remesher *r, int slot) {
    const int *corners = r->shared.tissue->mesh->tets[r->shared.refined.nodes[slot].tet];
    const double *weights = r->borders[slot].weights;
    int places[MAX_PLACES], all = places_in_use(r, places), count = 0;
    column_ranges columns = nested_all_columns(r, slot), own = {.count = 0};
    weighted_triple parts[4];
    for (int c = 0; c < 4; c++)
        if (weights[c] != 0.0) parts[count++] = (weighted_triple){r->nominal[3 * nested_place(r, corners[c])], NESTED_LD, weights[c]};
    rows_interpolate(&columns, count, parts, r->nominal[3 * slot], NESTED_LD);
    nested_mirror(r->nominal[0], NESTED_LD, slot, all, places);
    column_ranges_add(&own, 3 * slot / COLUMN_STEP * COLUMN_STEP, 3 * slot + 3);
    rows_interpolate(&own, count, parts, r->nominal[3 * slot], NESTED_LD); /* its columns are filled already */
}

/* ---- the inverse ----------------------------------------------------------------------------------------------------- */

void nested_inverse_rows(const nested_remesher *r, int count, int place, const column_ranges *columns, double *rows) {
    row_triple parts[MAX_CONTACTS];
    int faces = 0;
    for (int k = 0; k < count; k++) {
        int j = r->shared.refined.order[k];
        if (!r->borders[j].on_face) continue; /* otherwise, the factor is zero at nominal nodes */
        mat3 factor = nested_factor(r, j, place);
        parts[faces++] = (row_triple){r->factors[j][0], NESTED_LD, m3_multiply(&factor, &r->borders[j].surplus)};
    }
    rows_copy(columns, r->nominal[3 * place], NESTED_LD, rows, SNAPSHOT_LD);
    rows_add(columns, faces, parts, rows, SNAPSHOT_LD);
}

void nested_update_rows(nested_remesher *r, int slot, double sign) {
    int handles[MAX_HANDLES], count = handles_in_use(&r->shared, handles);
    column_ranges columns = nested_columns(r, -1);
    mat3 surplus = m3_scaled(sign, r->borders[slot].surplus);
    for (int i = 0; i < count; i++) {
        mat3 factor = nested_factor(r, slot, handles[i]);
        row_triple gained = {r->factors[slot][0], NESTED_LD, m3_multiply(&factor, &surplus)};
        rows_add(&columns, 1, &gained, handle_block(&r->shared, handles[i], 0), SNAPSHOT_LD);
    }
}
