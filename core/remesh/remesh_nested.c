/* Nested addition: each contact node borders the inverse with its surplus, rank 3. With the surpluses as unknowns,

       inverse(a, b) = K^-1(a, b) + sum_j F_j(a) S_j F_j(b)^T,      F_j(a) = K^-1(a, .) c_j + sum_(i<j) F_i(a) G_ij - s_j(a) I

   where K^-1 is that of the nominal mesh (interpolated for an added node) and s_j(a) is surplus j's hat function at node a. Inside an
   element c_j = 0; on a face it touches five nodes. Nothing of the mesh's size is touched. README.md, "Node addition ...". Indices i and j
   below are slots; i < j: i is before j in order. */
#include "remesh/nested.h"

#include <stdlib.h>
#include <string.h>

#include "remesh/refined_field.h"

enum { PATCH = 6 };                       /* nodes that an addition touches, at most, with itself */
static const double ROUNDING = 1e-12;     /* a weight below this is that of a node on the opposite face */

/* ---- factors ------------------------------------------------------------------------------------------------------ */

static void add_product(mat3 *sum, const mat3 *a, const mat3 *b) {
    mat3 product = m3_multiply(a, b);
    m3_add_scaled(sum, 1.0, &product);
}

/* The nominal nodes that a coded node hangs on. */
static int support_of(const nested_remesher *r, int node, int nodes[4], double weights[4]) {
    if (node >= 0) {
        nodes[0] = node;
        weights[0] = 1.0;
        return 1;
    }
    memcpy(nodes, r->shared.tissue->mesh->tets[r->shared.refined.nodes[-1 - node].tet], 4 * sizeof *nodes);
    memcpy(weights, r->borders[-1 - node].weights, 4 * sizeof *weights);
    return 4;
}

/* K^-1 of the nominal mesh between two coded nodes. */
static mat3 interpolated_block(nested_remesher *r, int node, int other) {
    int nodes[4], others[4];
    double weights[4], other_weights[4];
    int rows = support_of(r, node, nodes, weights), columns = support_of(r, other, others, other_weights);
    mat3 sum = {{{0}}};
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < columns; j++) {
            mat3 block = nominal_block(&r->shared, nodes[i], others[j]);
            m3_add_scaled(&sum, weights[i] * other_weights[j], &block);
        }
    return sum;
}

/* Everything that the factors of rows given before may need, with the first `count` contact nodes. */
static trocar_status gather_factors(nested_remesher *r, int count, report *why) {
    for (int k = 0; k < MAX_WINDOW; k++)
        if (r->shared.window[k] >= 0) gather_column(&r->shared, r->shared.window[k]);
    for (int k = 0; k < count; k++) {
        int i = r->shared.refined.order[k];
        for (int c = 0; c < 4; c++) gather_column(&r->shared, r->shared.tissue->mesh->tets[r->shared.refined.nodes[i].tet][c]);
        for (int p = 0; p < r->borders[i].nominal_count; p++) gather_column(&r->shared, r->borders[i].nominal[p]);
    }
    return gather_finish(&r->shared, why);
}

static double hat_at(const nested_remesher *r, int j, int node) { return node < 0 ? r->borders[-1 - node].hats[j] : 0.0; }

/* F_j(node) of the j in place `position` of the order, with the F_i before it given. */
static mat3 factor_of(nested_remesher *r, int position, int node, const mat3 *before) {
    int j = r->shared.refined.order[position];
    const bordering *border = &r->borders[j];
    mat3 factor = {{{0}}};
    if (border->on_face) {
        for (int p = 0; p < border->nominal_count; p++) {
            mat3 block = interpolated_block(r, node, border->nominal[p]);
            add_product(&factor, &block, &border->coupling[p]);
        }
        for (int k = 0; k < position; k++) {
            int i = r->shared.refined.order[k];
            if (r->borders[i].on_face || hat_at(r, i, node) != 0.0) add_product(&factor, &before[i], &border->chain[i]);
        }
    }
    for (int a = 0; a < 3; a++) factor.m[a][a] -= hat_at(r, j, node);
    return factor;
}

static void factors_of(nested_remesher *r, int count, int node, mat3 *factors) {
    for (int k = 0; k < count; k++) factors[r->shared.refined.order[k]] = factor_of(r, k, node, factors);
}

/* The same from the node's row, where it has one. Inside an element only the nodes within have a factor. */
static void known_factors(nested_remesher *r, int count, int node, mat3 *factors) {
    int handle = handle_of_node(&r->shared, node);
    if (handle < 0) factors_of(r, count, node, factors);
    for (int k = 0; k < count && handle >= 0; k++) {
        int j = r->shared.refined.order[k];
        factors[j] = r->borders[j].on_face || hat_at(r, j, node) != 0.0 ? r->factors[handle][j] : (mat3){{{0}}};
    }
}

/* Those of a new node: its corners' with its weights, and its own surplus. */
static void interpolate_factors(nested_remesher *r, int slot) {
    const refinement *refined = &r->shared.refined;
    const added_node *node = &refined->nodes[slot];
    memset(r->factors[slot], 0, sizeof r->factors[slot]);
    for (int c = 0; c < 4; c++) {
        mat3 factors[MAX_CONTACTS];
        if (node->at.weights[c] == 0.0) continue;
        known_factors(r, refined->count + 1, node->at.corners[c], factors);
        for (int k = 0; k <= refined->count; k++)
            m3_add_scaled(&r->factors[slot][refined->order[k]], node->at.weights[c], &factors[refined->order[k]]);
    }
    for (int a = 0; a < 3; a++) r->factors[slot][slot].m[a][a] -= 1.0;
}

/* F_j S_j, as F_j S_j F_j^T is wanted. */
static mat3 weighted(const nested_remesher *r, int j, const mat3 *factor) { return m3_multiply(factor, &r->borders[j].surplus); }

/* The inverse with the first `count` contact nodes, between a nominal node and any node, from their factors. */
static mat3 block_of(nested_remesher *r, int count, int node, int other, const mat3 *factors, const mat3 *other_factors) {
    mat3 sum = interpolated_block(r, node, other);
    for (int k = 0; k < count; k++) {
        int j = r->shared.refined.order[k];
        if (!r->borders[j].on_face) continue; /* zero at nominal nodes */
        mat3 left = weighted(r, j, &factors[j]), right = m3_transposed(&other_factors[j]);
        add_product(&sum, &left, &right);
    }
    return sum;
}

/* ---- adding ------------------------------------------------------------------------------------------------------- */

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

static void collect_coupling(nested_remesher *r, bordering *border, int node, const mat3 *c) {
    if (node >= 0) {
        add_coupling(border, node, 1.0, c);
        return;
    }
    const int *corners = r->shared.tissue->mesh->tets[r->shared.refined.nodes[-1 - node].tet];
    for (int i = 0; i < 4; i++) add_coupling(border, corners[i], r->borders[-1 - node].weights[i], c);
}

/* Weight of a touched node in the interpolation of the contact node. */
static double weight_of(const added_node *node, int corner) {
    for (int c = 0; c < 4; c++)
        if (node->at.corners[c] == corner) return node->at.weights[c];
    return 0.0;
}

/* c, d and S of a node on a face. With u_new = sum w u + h, c = K(old, new) + w K(new, new), d = K(new, new). */
static trocar_status border_face(nested_remesher *r, int slot, report *why) {
    const refinement *refined = &r->shared.refined;
    bordering *border = &r->borders[slot];
    patch *p = &r->shared.patch;
    patch_create(r->shared.tissue, refined, refined->count, p);
    int own = p->count - 1;
    mat3 own_stiffness, reached = {{{0}}}, c[PATCH], factors[PATCH][MAX_CONTACTS];
    for (int q = 0; q <= own; q++) {
        double weight = q == own ? 0.0 : weight_of(&refined->nodes[slot], p->nodes[q]);
        for (int a = 0; a < 9; a++)
            c[q].m[a / 3][a % 3] = p->change[3 * q + a / 3][3 * own + a % 3] + weight * p->change[3 * own + a / 3][3 * own + a % 3];
    }
    own_stiffness = c[own];
    for (int q = 0; q < own; q++) collect_coupling(r, border, p->nodes[q], &c[q]);
    for (int q = 0; q < border->nominal_count; q++) gather_row(&r->shared, border->nominal[q]);
    trocar_status status = gather_factors(r, refined->count + 1, why);
    if (status != TROCAR_OK) return status;
    memset(border->chain, 0, sizeof border->chain);
    for (int q = 0; q < own; q++) {
        known_factors(r, refined->count, p->nodes[q], factors[q]);
        for (int k = 0; k < refined->count; k++) {
            int i = refined->order[k];
            mat3 transposed = m3_transposed(&factors[q][i]), product = m3_multiply(&transposed, &c[q]);
            add_product(&border->chain[i], &r->borders[i].surplus, &product);
        }
    }
    for (int q = 0; q < own; q++) { /* c^T W: W is the factor at the nodes touched, where this surplus' hat is zero */
        mat3 transposed = m3_transposed(&c[q]), factor = factor_of(r, refined->count, p->nodes[q], factors[q]);
        add_product(&reached, &transposed, &factor);
    }
    m3_add_scaled(&own_stiffness, -1.0, &reached);
    if (!(m3_determinant(&own_stiffness) > 0.0)) return fail(why, TROCAR_NUMERIC, "contact node %d on a face has no stiffness", slot);
    border->surplus = m3_inverse(&own_stiffness);
    return TROCAR_OK;
}

static void interpolate_hats(nested_remesher *r, int slot) {
    const refinement *refined = &r->shared.refined;
    const added_node *node = &refined->nodes[slot];
    memset(r->borders[slot].hats, 0, sizeof r->borders[slot].hats);
    for (int k = 0; k < refined->count; k++) {
        int j = refined->order[k];
        r->borders[j].hats[slot] = 0.0;
        for (int c = 0; c < 4; c++) r->borders[slot].hats[j] += node->at.weights[c] * hat_at(r, j, node->at.corners[c]);
    }
    r->borders[slot].hats[slot] = 1.0;
}

/* The rows in use gain F S F^T, or lose it again: plain loops over whole rows, which places not in use pass through. */
static void update_rows(nested_remesher *r, int slot, double sign) {
    int handles[MAX_HANDLES], count = handles_in_use(&r->shared, handles);
    int contacts = 3 * refinement_span(&r->shared.refined), window = 3 * MAX_CONTACTS, end = count > 0 ? 3 * handles[count - 1] + 3 : 0;
    double columns[3][SNAPSHOT_LD] = {{0}};
    for (int i = 0; i < 3 * count; i++)
        for (int b = 0; b < 3; b++) columns[b][3 * handles[i / 3] + i % 3] = r->factors[handles[i / 3]][slot].m[i % 3][b];
    for (int i = 0; i < count; i++) {
        mat3 left = weighted(r, slot, &r->factors[handles[i]][slot]);
        for (int a = 0; a < 3; a++) {
            double *row = handle_block(&r->shared, handles[i], 0) + (size_t)a * SNAPSHOT_LD;
            double x = sign * left.m[a][0], y = sign * left.m[a][1], z = sign * left.m[a][2];
            for (int c = 0; c < contacts; c++) row[c] += x * columns[0][c] + y * columns[1][c] + z * columns[2][c];
            for (int c = window; c < end; c++) row[c] += x * columns[0][c] + y * columns[1][c] + z * columns[2][c];
        }
    }
}

/* The inverse between a corner of the node's leaf and a handle. */
static mat3 corner_to_handle(nested_remesher *r, int slot, int corner, int handle) {
    int count = r->shared.refined.count + 1, own = handle_of_node(&r->shared, corner);
    if (own >= 0) return handle_get(&r->shared, own, handle);
    mat3 factors[MAX_CONTACTS]; /* a nominal node, not in the window */
    factors_of(r, count, corner, factors);
    return block_of(r, count, corner, handle == slot ? -1 - slot : handle_node(&r->shared, handle), factors, r->factors[handle]);
}

/* The new row: interpolated between the corners of the leaf, and the surplus. */
static void add_row(nested_remesher *r, int slot, int handle) {
    const added_node *node = &r->shared.refined.nodes[slot];
    const bordering *border = &r->borders[slot];
    mat3 sum = {{{0}}};
    for (int c = 0; c < 4; c++) {
        if (node->at.weights[c] == 0.0) continue;
        mat3 block = corner_to_handle(r, slot, node->at.corners[c], handle);
        m3_add_scaled(&sum, node->at.weights[c], &block);
    }
    if (border->on_face || handle == slot) {
        mat3 factor = m3_transposed(&r->factors[handle][slot]), surplus = m3_multiply(&border->surplus, &factor);
        m3_add_scaled(&sum, -1.0, &surplus);
    }
    handle_put(&r->shared, slot, handle, &sum);
}

static trocar_status nested_add(remesher *shared, int slot, report *why) {
    nested_remesher *r = (nested_remesher *)shared;
    const added_node *node = &shared->refined.nodes[slot];
    bordering *border = &r->borders[slot];
    if (node->moved >= 0) return fail(why, TROCAR_BAD_INPUT, "remeshing: nested moves no nodes; choose implicit");
    border->on_face = added_on_face(node);
    border->nominal_count = 0;
    mesh_barycentric(shared->tissue->mesh, node->tet, node->position, border->weights);
    for (int i = 0; i < 4; i++)
        if (fabs(border->weights[i]) < ROUNDING) border->weights[i] = 0.0;
    interpolate_hats(r, slot);
    gather_start(shared);
    for (int c = 0; c < 4; c++) gather_row(shared, shared->tissue->mesh->tets[node->tet][c]);
    trocar_status status = TROCAR_OK;
    if (border->on_face) status = border_face(r, slot, why);
    else border->surplus = surplus_compliance(shared->tissue, &shared->refined, node->tet, &node->at);
    if (status != TROCAR_OK) return status;

    int handles[MAX_HANDLES], count = handles_in_use(shared, handles);
    for (int i = 0; i < count && border->on_face; i++) {
        int handle = handles[i];
        r->factors[handle][slot] = factor_of(r, shared->refined.count, handle_node(shared, handle), r->factors[handle]);
    }
    interpolate_factors(r, slot);
    if (border->on_face) update_rows(r, slot, 1.0);
    for (int i = 0; i < count; i++) add_row(r, slot, handles[i]);
    add_row(r, slot, slot);
    return TROCAR_OK;
}

/* ---- removing ------------------------------------------------------------------------------------------------------ */

static void nested_remove(remesher *shared, int slot, int position) {
    nested_remesher *r = (nested_remesher *)shared;
    if (!r->borders[slot].on_face) return; /* the surplus goes with its row */
    nested_move_to_end(r, slot, position);
    update_rows(r, slot, -1.0);
}

/* ---- rows ------------------------------------------------------------------------------------------------------------ */

static void fill_row(nested_remesher *r, int handle) {
    remesher *shared = &r->shared;
    int handles[MAX_HANDLES], count = handles_in_use(shared, handles), added = shared->refined.count;
    for (int i = 0; i < count; i++) {
        mat3 block = block_of(r, added, handle_node(shared, handle), handle_node(shared, handles[i]), r->factors[handle], r->factors[handles[i]]);
        handle_put(shared, handle, handles[i], &block);
    }
}

static trocar_status nested_take_nodes(remesher *shared, int count, const int *handles, report *why) {
    nested_remesher *r = (nested_remesher *)shared;
    gather_start(shared);
    for (int i = 0; i < count; i++) gather_row(shared, handle_node(shared, handles[i]));
    trocar_status status = gather_factors(r, shared->refined.count, why);
    for (int i = 0; i < count && status == TROCAR_OK; i++)
        factors_of(r, shared->refined.count, handle_node(shared, handles[i]), r->factors[handles[i]]);
    for (int i = 0; i < count && status == TROCAR_OK; i++) fill_row(r, handles[i]);
    return status;
}

static void nested_release(remesher *shared) { (void)shared; }

static const remesh_operations nested = {nested_add, nested_remove, true, nested_take_nodes, NULL, nested_release};

trocar_status remesher_create_nested(inverse *inv, remesher **created, report *why) {
    nested_remesher *r = calloc(1, sizeof *r);
    *created = r ? &r->shared : NULL;
    return r ? remesher_init(*created, &nested, inv, why) : fail(why, TROCAR_NO_MEMORY, "no memory");
}
