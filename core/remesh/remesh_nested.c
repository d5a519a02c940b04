/* Nested addition. Each contact node borders the inverse with its surplus, which is an update of rank 3. With the surpluses as unknowns,
       inverse(a, b) = K^-1(a, b) + sum_j F_j(a) S_j F_j(b)^T, F_j(a) = K^-1(a, .) c_j + sum_(i<j) F_i(a) G_ij - s_j(a) I
   where K^-1 is that of the nominal mesh (interpolated for an added node) and s_j(a) is surplus j's hat function at node a. Inside an element c_j = 0; on a
   face it touches five nodes. The cost is independent of the size of the mesh. See docs/mechanics.md, "Node addition". Indices i and j below are slots; i < j
   means that i comes before j in `order`. */
#include "remesh/nested.h"

#include <stdlib.h>
#include <string.h>

#include "base/sparse_memory.h"
#include "refinement/refined_field.h"

static const double ROUNDING = 1e-12; /* dimensionless: if a barycentric weight is below this, the node counts as lying on the face opposite that corner.
                                         Rounding tolerance */

/* ---- what the new node couples to ------------------------------------------------------------------------------------ */

static void add_product(mat3 *sum, const mat3 *a, const mat3 *b) {
    mat3 product = m3_multiply(a, b);
    m3_add_scaled(sum, 1.0, &product);
}

static void add_coupling(bordering *border, int nominal, double weight, const mat3 *c) {
    int p = 0;
    if (weight == 0.0) return;
    while (p < border->nominal_count && border->nominal[p] != nominal) p++;
    if (p == border->nominal_count) {
        border->nominal[border->nominal_count++] = nominal;
        border->coupling[p] = (mat3){{{0}}};
    }
    m3_add_scaled(&border->coupling[p], weight, c);
}

/* Adds a touched node's c to the nominal nodes that the touched node depends on. */
static void collect_coupling(nested_remesher *r, bordering *border, int node, const mat3 *c) {
    if (node >= 0) { /* a nominal node; otherwise -1 - slot of a contact node */
        add_coupling(border, node, 1.0, c);
        return;
    }
    const int *corners = r->shared.tissue->mesh->tets[r->shared.refined.nodes[-1 - node].tet];
    for (int i = 0; i < 4; i++) add_coupling(border, corners[i], r->borders[-1 - node].weights[i], c);
}

/* Returns a corner's weight in the interpolation at the contact node; 0 if it is not a corner of the node's leaf. */
static double weight_of(const added_node *node, int corner) {
    for (int c = 0; c < 4; c++)
        if (node->at.corners[c] == corner) return node->at.weights[c];
    return 0.0;
}

/* Stores c for each touched node in `touched->beside`, and d in `touched->own`. With u_new = sum w u + h, c = K(old, new) + w K(new, new) and d = K(new, new).
   */
static void couple(nested_remesher *r, int slot, split_columns *touched) {
    const refinement *refined = &r->shared.refined;
    patch_own_columns(r->shared.tissue, refined, refined->count, touched);
    for (int q = 0; q < touched->count; q++) {
        m3_add_scaled(&touched->beside[q], weight_of(&refined->nodes[slot], touched->nodes[q]), &touched->own);
        collect_coupling(r, &r->borders[slot], touched->nodes[q], &touched->beside[q]);
    }
}

static void add_extra(nested_remesher *r, int node) {
    if (nested_place(r, node) < 0) r->extra[r->extra_count++] = node;
}

/* Assigns places to the nominal nodes that the addition needs: those with nominal weights, those of the node's leaf (which can differ from the former because
   of rounding), and those coupled to it. Nodes in the window have places already. */
static trocar_status add_all_extra(nested_remesher *r, int slot, trocar_error *why) {
    const bordering *border = &r->borders[slot];
    const int *corners = r->shared.tissue->mesh->tets[r->shared.refined.nodes[slot].tet];
    const leaf_point *at = &r->shared.refined.nodes[slot].at;
    int places[MAX_EXTRA];
    r->extra_count = 0;
    for (int c = 0; c < 4; c++)
        if (border->weights[c] != 0.0) add_extra(r, corners[c]);
    for (int c = 0; c < 4; c++)
        if (at->corners[c] >= 0 && at->weights[c] != 0.0) add_extra(r, at->corners[c]);
    for (int p = 0; p < border->nominal_count; p++) add_extra(r, border->nominal[p]);
    for (int g = 0; g < r->extra_count; g++) places[g] = MAX_HANDLES + g;
    return r->extra_count > 0 ? nested_enter(r, r->extra_count, places, why) : TROCAR_OK;
}

/* ---- factors and surplus --------------------------------------------------------------------------------------------- */

/* Computes G_ij from the factors of surplus i at the touched nodes. */
static mat3 chain_to(const nested_remesher *r, int i, const split_columns *touched, const int *places) {
    mat3 sum = {{{0}}};
    for (int q = 0; q < touched->count; q++) {
        mat3 factor = nested_factor(r, i, places[q]), transposed = m3_transposed(&factor);
        add_product(&sum, &transposed, &touched->beside[q]);
    }
    return m3_multiply(&r->borders[i].surplus, &sum);
}

static bool is_zero(const mat3 *a) {
    static const mat3 zero = {{{0}}};
    return memcmp(a, &zero, sizeof zero) == 0;
}

/* Computes the factors of a surplus on a face at all places, by summing rows. */
static void find_factors(nested_remesher *r, int slot, const split_columns *touched, const int *places) {
    const refinement *refined = &r->shared.refined;
    bordering *border = &r->borders[slot];
    row_triple parts[REACHED + MAX_CONTACTS];
    int count = 0;
    for (int p = 0; p < border->nominal_count; p++)
        parts[count++] = (row_triple){r->nominal[3 * nested_place(r, border->nominal[p])], NESTED_LD, m3_transposed(&border->coupling[p])};
    for (int k = 0; k < refined->count; k++) {
        int i = refined->order[k];
        border->chain[i] = chain_to(r, i, touched, places);
        if (r->borders[i].on_face || !is_zero(&border->chain[i]))
            parts[count++] = (row_triple){r->factors[i][0], NESTED_LD, m3_transposed(&border->chain[i])};
    }
    column_ranges columns = nested_all_columns(r, slot);
    rows_clear(&columns, r->factors[slot][0], NESTED_LD);
    rows_add(&columns, count, parts, r->factors[slot][0], NESTED_LD);
}

/* Computes the factors, chains and surplus of a node on a face. */
static trocar_status border_face(nested_remesher *r, int slot, const split_columns *touched, trocar_error *why) {
    int places[SPLIT_NODES];
    mat3 stiffness = touched->own, reached = {{{0}}};
    for (int q = 0; q < touched->count; q++) places[q] = nested_place(r, touched->nodes[q]);
    find_factors(r, slot, touched, places);
    for (int q = 0; q < touched->count; q++) { /* c^T W, where W is the factor: at the touched nodes, this surplus's own hat function is zero */
        mat3 transposed = m3_transposed(&touched->beside[q]), factor = nested_factor(r, slot, places[q]);
        add_product(&reached, &transposed, &factor);
    }
    m3_add_scaled(&stiffness, -1.0, &reached);
    if (!(m3_determinant(&stiffness) > 0.0)) return fail(why, TROCAR_NUMERIC, "contact node %d on a face has no stiffness", slot);
    r->borders[slot].surplus = m3_inverse(&stiffness);
    return TROCAR_OK;
}

/* Sets the factors of a node inside an element. They are nonzero only at the node itself and at nodes that depend on it. */
static void border_inside(nested_remesher *r, int slot) {
    const added_node *node = &r->shared.refined.nodes[slot];
    column_ranges columns = nested_all_columns(r, slot);
    rows_clear(&columns, r->factors[slot][0], NESTED_LD);
    r->borders[slot].surplus = surplus_compliance(r->shared.tissue, &r->shared.refined, node->tet, &node->at);
}

/* Computes the factors at a new node: those of earlier surpluses by interpolation between its corners, and that of its own surplus. */
static void interpolate_factors(nested_remesher *r, int slot) {
    const refinement *refined = &r->shared.refined;
    const leaf_point *at = &refined->nodes[slot].at;
    int places[4];
    for (int c = 0; c < 4; c++) places[c] = at->weights[c] == 0.0 ? 0 : nested_place(r, at->corners[c]);
    for (int k = 0; k <= refined->count; k++) {
        int j = refined->order[k];
        for (int b = 0; b < 3; b++) {
            double *row = r->factors[j][b], sum[3] = {0};
            for (int c = 0; c < 4; c++)
                for (int a = 0; a < 3 && at->weights[c] != 0.0; a++) sum[a] += at->weights[c] * row[3 * places[c] + a];
            memcpy(row + 3 * slot, sum, sizeof sum);
        }
    }
    for (int a = 0; a < 3; a++) r->factors[slot][a][3 * slot + a] -= 1.0;
}

/* ---- adding ---------------------------------------------------------------------------------------------------------- */

static void fill_row(nested_remesher *r, int slot, const column_ranges *columns, int count, const weighted_triple *corners) {
    double *row = handle_block(&r->shared, slot, 0);
    row_triple surplus = {r->factors[slot][0], NESTED_LD, m3_scaled(-1.0, r->borders[slot].surplus)};
    rows_interpolate(columns, count, corners, row, SNAPSHOT_LD);
    rows_add(columns, 1, &surplus, row, SNAPSHOT_LD);
}

/* Adds the new node's row: the interpolation between the corners of its leaf, plus the surplus. */
static void add_row(nested_remesher *r, int slot) {
    remesher *shared = &r->shared;
    const leaf_point *at = &shared->refined.nodes[slot].at;
    double extra_rows[4][3 * SNAPSHOT_LD];
    weighted_triple corners[4];
    int handles[MAX_HANDLES], all = handles_in_use(shared, handles), count = 0;
    column_ranges columns = nested_columns(r, slot), own = {.count = 0};
    for (int c = 0; c < 4; c++) {
        if (at->weights[c] == 0.0) continue;
        int place = nested_place(r, at->corners[c]);
        bool extra = place >= MAX_HANDLES;
        if (extra) nested_inverse_rows(r, shared->refined.count + 1, place, &columns, extra_rows[c]);
        corners[count++] = (weighted_triple){extra ? extra_rows[c] : handle_block(shared, place, 0), SNAPSHOT_LD, at->weights[c]};
    }
    fill_row(r, slot, &columns, count, corners);
    nested_mirror(shared->handles, SNAPSHOT_LD, slot, all, handles);
    column_ranges_add(&own, 3 * slot / COLUMN_STEP * COLUMN_STEP, 3 * slot + 3);
    fill_row(r, slot, &own, count, corners); /* its columns are filled already */
}

/* Computes the nominal mesh's compliance between the new node and all contact nodes. */
static void find_between_contacts(nested_remesher *r, int slot) {
    const refinement *refined = &r->shared.refined;
    for (int k = 0; k <= refined->count; k++) {
        int other = refined->order[k], higher = slot > other ? slot : other, lower = slot > other ? other : slot;
        for (int a = 0; a < 9; a++) r->shared.between_contacts[lower].at[a / 3][a % 3][higher] = r->nominal[3 * lower + a / 3][3 * higher + a % 3];
    }
}

static trocar_status nested_add(remesher *shared, int slot, trocar_error *why) {
    nested_remesher *r = (nested_remesher *)shared;
    const added_node *node = &shared->refined.nodes[slot];
    bordering *border = &r->borders[slot];
    split_columns touched = {.count = 0};
    if (node->moved >= 0) return fail(why, TROCAR_BAD_INPUT, "remeshing: nested moves no nodes; choose implicit");
    gather_start(shared);
    border->on_face = added_on_face(node);
    border->nominal_count = 0;
    mesh_barycentric(shared->tissue->mesh, node->tet, node->position, border->weights);
    for (int i = 0; i < 4; i++)
        if (fabs(border->weights[i]) < ROUNDING) border->weights[i] = 0.0;
    if (border->on_face) couple(r, slot, &touched);
    trocar_status status = add_all_extra(r, slot, why);
    if (status != TROCAR_OK) return status;
    nested_interpolate(r, slot);
    if (border->on_face) status = border_face(r, slot, &touched, why);
    else border_inside(r, slot);
    if (status != TROCAR_OK) return status;
    interpolate_factors(r, slot);
    if (border->on_face) nested_update_rows(r, slot, 1.0);
    add_row(r, slot);
    find_between_contacts(r, slot);
    r->extra_count = 0;
    return TROCAR_OK;
}

/* ---- removing -------------------------------------------------------------------------------------------------------- */

static void nested_remove(remesher *shared, int slot, int position) {
    nested_remesher *r = (nested_remesher *)shared;
    if (!r->borders[slot].on_face) return; /* inside an element, the surplus goes away with the node's row */
    nested_move_to_end(r, slot, position);
    nested_update_rows(r, slot, -1.0);
}

/* ---- the window ------------------------------------------------------------------------------------------------------ */

static trocar_status nested_take_nodes(remesher *shared, int count, const int *places, trocar_error *why) {
    nested_remesher *r = (nested_remesher *)shared;
    int handles[MAX_HANDLES], all = handles_in_use(shared, handles);
    r->extra_count = 0;
    trocar_status status = nested_enter(r, count, places, why);
    column_ranges columns = nested_columns(r, -1);
    for (int i = 0; i < count && status == TROCAR_OK; i++) {
        nested_inverse_rows(r, shared->refined.count, places[i], &columns, handle_block(shared, places[i], 0));
        nested_mirror(shared->handles, SNAPSHOT_LD, places[i], all, handles);
    }
    return status;
}

static void nested_release(remesher *shared) {
    nested_remesher *r = (nested_remesher *)shared;
    sparse_free(r->nominal, NESTED_LD * sizeof *r->nominal);
    sparse_free(r->factors, MAX_CONTACTS * sizeof *r->factors);
}

static const remesh_operations nested = {nested_add, nested_remove, true, nested_take_nodes, NULL, nested_release};

trocar_status remesher_create_nested(inverse *inv, remesher **created, trocar_error *why) {
    nested_remesher *r = calloc(1, sizeof *r);
    *created = r ? &r->shared : NULL;
    if (!r) return fail(why, TROCAR_NO_MEMORY, "no memory");
    trocar_status status = remesher_init(*created, &nested, inv, why);
    r->nominal = sparse_zeros(NESTED_LD * sizeof *r->nominal);
    r->factors = sparse_zeros(MAX_CONTACTS * sizeof *r->factors);
    return status != TROCAR_OK || (r->nominal && r->factors) ? status : fail(why, TROCAR_NO_MEMORY, "no memory");
}
