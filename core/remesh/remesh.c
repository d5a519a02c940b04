#include "remesh/remesh.h"

#include <stdlib.h>
#include <string.h>

#include "linalg/rows.h"
#include "remesh/remesh_method.h"
#include "remesh/resolved_line.h"

trocar_status remesher_create(inverse *inv, remesher **created, trocar_error *why) {
    trocar_status status = remesher_create_nested(inv, created, why);
    if (status == TROCAR_OK) return TROCAR_OK;
    remesher_free(*created);
    *created = NULL;
    return status;
}

void remesher_free(remesher *r) {
    if (!r) return;
    r->operations->release(r);
    remesher_release(r);
    free(r);
}

/* ---- serving ------------------------------------------------------------------------------------------------------- */

/* Returns an error if the owner of the inverse failed to supply a block. */
static trocar_status confirm(const remesher *r, trocar_error *why) {
    if (r->gathered.status != TROCAR_OK) *why = r->gathered.why;
    return r->gathered.status;
}

static trocar_status take_nodes(remesher *r, int count, const int *handles, trocar_error *why) {
    if (count == 0 || !r->operations->take_nodes) return TROCAR_OK;
    trocar_status status = r->operations->take_nodes(r, count, handles, why);
    return status == TROCAR_OK ? confirm(r, why) : status;
}

/* Adds a contact node. `known`: the mesh's resolution there, or NULL to measure it. */
static trocar_status add_node(remesher *r, int slot, const added_node *node, const resolved_field *known, trocar_error *why) {
    refinement *refined = &r->refined;
    refined->order[refined->count] = slot;
    refined->nodes[slot] = *node;
    if (known) set_resolved(r, slot, known);
    trocar_status status = known ? TROCAR_OK : resolve_contact(r, slot, why);
    if (status == TROCAR_OK) status = r->operations->add(r, slot, why);
    if (status != TROCAR_OK) return status;
    status = confirm(r, why);
    if (status == TROCAR_OK) refined->count++;
    else r->operations->remove(r, slot, refined->count);
    return status;
}

static void remove_node(remesher *r, int position) {
    int *order = r->refined.order, slot = order[position], last = --r->refined.count;
    memmove(order + position, order + position + 1, (size_t)(last - position) * sizeof *order);
    order[last] = slot;
    r->operations->remove(r, slot, position);
}

/* Updates the window. Nodes that are still wanted stay where they are; new ones go into free places. */
static trocar_status move_window(remesher *r, const remesh_request *request, trocar_error *why) {
    int fresh[MAX_WINDOW] = {0}, count = 0;
    bool wanted[MAX_WINDOW] = {false};
    for (int i = 0; i < request->window_count; i++) {
        int place = window_place(r, request->window[i]);
        if (place >= 0) wanted[place] = true;
    }
    for (int k = 0; k < MAX_WINDOW; k++)
        if (!wanted[k]) window_put(r, k, -1);
    for (int i = 0, place = 0; i < request->window_count; i++) {
        int node = request->window[i];
        if (window_place(r, node) >= 0 || (i >= request->needed && !inverse_holds(r->inverse, node))) continue;
        while (r->window[place] >= 0) place++;
        window_put(r, place, node);
        fresh[count++] = MAX_CONTACTS + place;
    }
    trocar_status status = take_nodes(r, count, fresh, why);
    for (int i = 0; i < count && status != TROCAR_OK; i++) window_put(r, fresh[i] - MAX_CONTACTS, -1); /* the rows could not be filled, so take these nodes out
                                                                                                          again */
    return status;
}

static bool same_leaf(const leaf_point *a, const leaf_point *b) {
    return memcmp(a->corners, b->corners, sizeof a->corners) == 0 && memcmp(a->weights, b->weights, sizeof a->weights) == 0;
}

static bool same_node(const added_node *a, const added_node *b) {
    return a->id == b->id && a->moved == b->moved && a->tet == b->tet && same_leaf(&a->at, &b->at) && a->across_tet == b->across_tet
        && (a->across_tet < 0 || same_leaf(&a->across, &b->across));
}

/* Returns which nodes must be removed, as a bit mask of slots: those no longer wanted, those that have changed, and those that depend on either. */
static uint64_t slots_to_clear(const remesher *r, const refinement *wanted) {
    const refinement *refined = &r->refined;
    uint64_t clear = 0, same = 0;
    bool any_order = r->operations->any_order;
    for (int i = 0; i < wanted->count; i++) same |= (uint64_t)same_node(&refined->nodes[wanted->order[i]], &wanted->nodes[wanted->order[i]]) << wanted->order[i];
    for (int i = 0; i < refined->count; i++) any_order = any_order && refined->nodes[refined->order[i]].moved < 0;
    for (int i = 0; i < refined->count; i++) {
        int slot = refined->order[i];
        bool later = clear != 0 && !any_order, stays = same >> slot & 1 && !refinement_hangs_on(&refined->nodes[slot], clear);
        if (later || !stays) clear |= UINT64_C(1) << slot;
    }
    return clear;
}

/* Changes the set of contact nodes to `wanted`. `known`: the mesh's resolution at each wanted node, by slot, or NULL to measure it. */
static trocar_status update_nodes(remesher *r, const refinement *wanted, const resolved_field *known, trocar_error *why) {
    uint64_t clear = slots_to_clear(r, wanted), kept = 0;
    for (int i = r->refined.count - 1; i >= 0; i--)
        if (clear >> r->refined.order[i] & 1) remove_node(r, i);
    for (int i = 0; i < r->refined.count; i++) kept |= UINT64_C(1) << r->refined.order[i];
    for (int i = 0; i < wanted->count; i++) {
        int slot = wanted->order[i];
        if (kept >> slot & 1) continue;
        trocar_status status = add_node(r, slot, &wanted->nodes[slot], known ? &known[slot] : NULL, why);
        if (status != TROCAR_OK) return status;
    }
    return TROCAR_OK;
}

/* Copies the inverse between the remesher and a snapshot. Only the rows and columns in use are copied, because the matrices are large. */
static void copy_rows(const remesher *r, const double *from, double *to) {
    int handles[MAX_HANDLES], count = handles_in_use(r, handles);
    size_t contacts = 3 * (size_t)refinement_span(&r->refined), window = 3 * (size_t)MAX_CONTACTS, end = 3 * (size_t)(count > 0 ? handles[count - 1] + 1 : 0);
    for (int i = 0; i < 3 * count; i++) {
        size_t row = (size_t)(3 * handles[i / 3] + i % 3) * SNAPSHOT_LD;
        memcpy(to + row, from + row, contacts * sizeof(double));
        if (end > window) memcpy(to + row + window, from + row + window, (end - window) * sizeof(double));
    }
}

/* Copies the contact rows of the slots in use. */
static void copy_contact_rows(const remesher *r, const contact_rows *from, contact_rows *to) {
    int span = refinement_span(&r->refined);
    for (int i = 0; i < span; i++)
        for (int a = 0; a < 9; a++)
            row_copy(from[i].at[a / 3][a % 3], i, span, to[i].at[a / 3][a % 3]);
}

/* ---- looking ahead --------------------------------------------------------------------------------------------------- */

static void list_ahead(remesher *r, int tet) {
    const int *nodes = r->tissue->mesh->tets[tet];
    for (int c = 0; c < 4; c++) {
        bool there = r->ahead_count == MAX_AHEAD;
        for (int i = 0; i < r->ahead_count && !there; i++) there = r->ahead[i] == nodes[c];
        if (!there) r->ahead[r->ahead_count++] = nodes[c];
    }
}

/* Lists the nodes of the elements that the line crosses, and of these elements' neighbours. Starts at the tip, or where the line enters the body if the tip is
   outside. */
static void follow_line(remesher *r) {
    const mesh *m = r->tissue->mesh;
    vec3 tip = r->line_tip, direction = r->line_direction;
    r->line_new = false;
    r->ahead_count = r->ahead_done = 0;
    if (!inverse_prefetches(r->inverse) || v3_norm(direction) == 0.0) return;
    /* m: at this distance from the tip, the line is certainly outside the body */
    double beyond = v3_norm(v3_sub(m->bvh[0].low, tip)) + v3_norm(v3_sub(m->bvh[0].high, m->bvh[0].low));
    surface_hit hit = mesh_enter(m, tip, v3_axpy(beyond, direction, tip));
    int tet = mesh_locate(m, tip, -1);
    if (tet < 0 && hit.hit) tet = hit.tet, tip = hit.point;
    for (int step = 0; step < MAX_AHEAD && tet >= 0; step++) {
        double chord;
        list_ahead(r, tet);
        for (int f = 0; f < 4; f++)
            if (m->neighbours[tet][f] >= 0) list_ahead(r, m->neighbours[tet][f]);
        int face = mesh_exit(m, tet, tip, direction, &chord);
        if (face < 0) return;
        tip = v3_axpy(chord, direction, tip);
        tet = m->neighbours[tet][face];
    }
}

/* Fetches the blocks between the next few nodes along the line and all nodes they may be combined with: the line's earlier nodes, the window, and the corners
   of the contact nodes' elements. */
bool remesher_look_ahead(remesher *r) {
    enum { LARGE = 32, SMALL = 8 };
    int slice = r->refined.count > 0 ? SMALL : LARGE, most = inverse_slice(r->inverse); /* once the needle is in the tissue, keep this short so that requests do
                                                                                           not wait */
    if (slice > most) slice = most;
    trocar_error why; /* ignored: if these nodes are ever requested, the error is reported then */
    if (r->line_new) follow_line(r);
    int first = r->ahead_done, left = r->ahead_count - first;
    if (left == 0) return false;
    r->ahead_done += left < slice ? left : slice;
    gather_start(r);
    for (int i = first; i < r->ahead_done; i++) gather_row(r, r->ahead[i]);
    for (int i = 0; i < r->ahead_done; i++) gather_column(r, r->ahead[i]);
    for (int k = 0; k < MAX_WINDOW; k++)
        if (r->window[k] >= 0) gather_column(r, r->window[k]);
    for (int i = 0; i < r->refined.count; i++)
        for (int c = 0; c < 4; c++) gather_column(r, r->tissue->mesh->tets[r->refined.nodes[r->refined.order[i]].tet][c]);
    gather_finish(r, &why);
    return r->ahead_done < r->ahead_count;
}

/* ---- a request ------------------------------------------------------------------------------------------------------- */

static void fill(remesher *r, const remesh_request *request, compliance_snapshot *snapshot) {
    snapshot->insertion = request->insertion;
    snapshot->serial = request->serial;
    memset(snapshot->ids, 0, sizeof snapshot->ids);
    for (int i = 0; i < r->refined.count; i++) snapshot->ids[r->refined.order[i]] = r->refined.nodes[r->refined.order[i]].id;
    memcpy(snapshot->window, r->window, sizeof r->window);
    memcpy(snapshot->resolved, r->resolved, sizeof snapshot->resolved);
    copy_contact_rows(r, r->between_contacts, snapshot->between_contacts);
    snapshot->piece_count = r->piece_count;
    memcpy(snapshot->pieces, r->pieces, (size_t)r->piece_count * sizeof *r->pieces);
    copy_rows(r, r->handles, snapshot->compliance);
    r->line_tip = request->tip;
    r->line_direction = request->direction;
    r->line_new = true;
    snapshot->has_residuals = r->residual.any;
    snapshot->residual_time = r->residual.time;
    if (r->residual.any) memcpy(snapshot->u_residual, r->residual.u, sizeof snapshot->u_residual);
}

static trocar_status check_counts(const remesh_request *request, trocar_error *why) {
    if (request->wanted.count > MAX_CONTACTS || request->window_count > MAX_WINDOW)
        return fail(why, TROCAR_BAD_INPUT, "a request of %d contact nodes and %d in the window: at most %d and %d", request->wanted.count,
                    request->window_count, MAX_CONTACTS, MAX_WINDOW);
    return TROCAR_OK;
}

static trocar_status update(remesher *r, const remesh_request *request, trocar_error *why) {
    trocar_status status = check_counts(request, why);
    if (status == TROCAR_OK) status = move_window(r, request, why);
    if (status == TROCAR_OK) status = update_nodes(r, &request->wanted, NULL, why);
    if (status == TROCAR_OK && r->operations->gather) status = r->operations->gather(r, why);
    return status == TROCAR_OK ? residual_displacement_find(r->inverse, request, r->window, &r->residual, why) : status;
}

trocar_status remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why) {
    trocar_status status = update(r, request, why);
    if (status == TROCAR_OK) fill(r, request, snapshot);
    return status;
}

bool remesher_must_measure(const remesher *r, const remesh_request *request) { return lines_are_new(r, request); }

trocar_status remesher_measure(remesher *r, const remesh_request *request, int most, compliance_snapshot *snapshot, trocar_error *why) {
    trocar_status status = resolve_pieces(r, request, most, why);
    if (status == TROCAR_OK) fill(r, request, snapshot);
    return status;
}

trocar_status remesher_answer(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why) {
    trocar_status status = update(r, request, why);
    return status == TROCAR_OK ? remesher_measure(r, request, MAX_PIECES, snapshot, why) : status;
}

trocar_status remesher_forget(remesher *r, trocar_error *why) {
    static const refinement nothing = {.count = 0};
    for (int k = 0; k < MAX_WINDOW; k++) window_put(r, k, -1);
    return update_nodes(r, &nothing, NULL, why);
}

trocar_status remesher_resume(remesher *r, const remesh_request *request, const compliance_snapshot *snapshot, trocar_error *why) {
    bool answered = snapshot->serial != 0 && snapshot->serial == request->serial;
    trocar_status status = check_counts(request, why);
    if (status != TROCAR_OK) return status;
    if (answered && (snapshot->piece_count < 0 || snapshot->piece_count > MAX_PIECES))
        return fail(why, TROCAR_BAD_INPUT, "an answer with %d pieces of lines: at most %d", snapshot->piece_count, MAX_PIECES);
    status = remesher_forget(r, why);
    r->piece_count = answered ? snapshot->piece_count : 0;
    memcpy(r->pieces, snapshot->pieces, (size_t)r->piece_count * sizeof *r->pieces);
    for (int k = 0; k < MAX_WINDOW; k++) window_put(r, k, answered ? snapshot->window[k] : -1);
    if (status != TROCAR_OK || !answered) return status;
    int handles[MAX_HANDLES], count = handles_in_use(r, handles);
    status = take_nodes(r, count, handles, why);
    if (status == TROCAR_OK) status = update_nodes(r, &request->wanted, snapshot->resolved, why);
    copy_contact_rows(r, snapshot->between_contacts, r->between_contacts);
    r->residual.any = snapshot->has_residuals;
    r->residual.time = snapshot->residual_time;
    if (r->residual.any) memcpy(r->residual.u, snapshot->u_residual, sizeof r->residual.u);
    if (status == TROCAR_OK) copy_rows(r, snapshot->compliance, r->handles); /* restore the stored rows: rows computed in another order would differ in the last
                                                                                bits */
    return status;
}
