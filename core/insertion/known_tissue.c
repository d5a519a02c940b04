#include "insertion/known_tissue.h"

#include <string.h>

#include "insertion/contact_nodes.h"
#include "insertion/creep.h"
#include "insertion/local_compliance.h"
#include "insertion/strata.h"
#include "remesh/snapshot_kernels.h"

/* Handles of the last point under the tip that the snapshot covered; false: there is none. */
static bool tip_handles(const tick_context *tick, int handles[4]) {
    const needle_tip *tip = &tick->state->tip;
    return tip->phase == TIP_INSIDE && tip->known_tet >= 0 && snapshot_covers(tick->snapshot, tick->model->mesh->tets[tip->known_tet], handles);
}

/* Load of active contact number k from the base on the tissue, N. */
static vec3 load_of(const tick_context *tick, int k) {
    const insertion_state *state = tick->state;
    return v3_add(state->contacts[state->refined.order[k]].force, creep_load(tick->model, &state->memory, k));
}

/* Displacement of a handle under the tip's load on those at `corners`, m. */
static vec3 displaced_by_tip(const tick_context *tick, const int corners[4], int handle) {
    const insertion_state *state = tick->state;
    mat3 c = compliance_to_point(tick->snapshot, corners, state->tip.known_weights, handle);
    return m3_apply_transposed(&c, v3_add(tip_load(&state->tip), creep_tip_load(tick->model, &state->memory)));
}

vec3 displacement_at(const tick_context *tick, const int handles[4], const double weights[4]) {
    const insertion_state *state = tick->state;
    handle_load loads[MAX_CONTACTS];
    int count = 0;
    for (; contact_is_active(state, count); count++) loads[count] = (handle_load){state->refined.order[count], load_of(tick, count)};
    vec3 u = creep_free_at(tick, handles, weights);
    u = v3_add(u, displacement_under(tick->snapshot, handles, weights, count, loads));
    int corners[4];
    if (!tip_handles(tick, corners)) return u;
    for (int c = 0; c < 4; c++) u = v3_axpy(weights[c], displaced_by_tip(tick, corners, handles[c]), u);
    return u;
}

vec3 displacement_at_tip(const tick_context *tick) {
    const needle_tip *tip = &tick->state->tip;
    int corners[4];
    bool covered = tip->known_tet >= 0 && snapshot_covers(tick->snapshot, tick->model->mesh->tets[tip->known_tet], corners);
    return covered ? displacement_at(tick, corners, tip->known_weights) : v3(0, 0, 0);
}

/* A contact whose row has arrived takes over the shaft that the tip has held for it until now. */
static void activate_contact(const tick_context *tick, int k) {
    insertion_state *state = tick->state;
    int slot = state->refined.order[k];
    shaft_contact *contact = &state->contacts[slot];
    contact->status = CONTACT_ACTIVE;
    contact->force = v3(0, 0, 0);
    if (contact->log_axial == 0.0) set_resolution(tick->model, contact, &tick->snapshot->resolved[slot]); /* the tip that left it did not know it yet */
    if (state->tip.phase != TIP_INSIDE || contact->depth < tip_entry_depth(state)) return;
    double origin = contact->shaft.origin;
    contact->shaft = state->tip.shaft;
    contact->shaft.origin = origin;
    shaft_share share = shaft_share_of(state, k, true);
    int last = tick->model->needle->given.segments - 1;
    contact->force = v3_scale(contact->shaft.traction * (share.to - share.from), q_axis(state->needle.frames[last]));
    state->tip.force = v3_sub(state->tip.force, contact->force);
}

void accept_snapshot(const tick_context *tick) {
    insertion_state *state = tick->state;
    int known = snapshot_known_contacts(tick->snapshot, &state->refined), passed = contacts_passed(state);
    tick->scratch->node_added = false;
    for (int k = contacts_active(state); k < known && k < passed; k++) {
        activate_contact(tick, k);
        tick->scratch->node_added = true;
        tick->output->events |= EVENT_ADDED;
    }
}

void follow_known_point(const tick_context *tick, int handles[4]) {
    const insertion_model *model = tick->model;
    insertion_state *state = tick->state;
    needle_tip *tip = &state->tip;
    double weights[4];
    int tet = refinement_element(model->mesh, &state->refined, snapshot_known_contacts(tick->snapshot, &state->refined), tip->tet, tip->nominal, weights);
    bool covered = snapshot_covers(tick->snapshot, model->mesh->tets[tet], handles);
    if (!covered && tet != tip->tet) { /* the window follows the nominal mesh */
        tet = tip->tet;
        mesh_barycentric(model->mesh, tet, tip->nominal, weights);
        covered = snapshot_covers(tick->snapshot, model->mesh->tets[tet], handles);
    }
    if (covered) {
        tip->known_tet = tet;
        memcpy(tip->known_weights, weights, sizeof weights);
        return;
    }
    tick->output->events |= EVENT_LATE;
    if (!tip_handles(tick, handles)) handles[0] = NO_HANDLE;
}

/* What remains of a difference between two measurements, of elements side by side or of a line that has turned, fades out as the tip
   moves on by about a diameter. */
static double faded(double now, double then, double used, double fading) { return now + (used - then) * fading; }

/* Goes on with what was measured last: elements side by side differ little. Farther away, or without any measurement, the worker is late. */
static void keep_resolution(const tick_context *tick) {
    const insertion_model *model = tick->model;
    needle_tip *tip = &tick->state->tip;
    if (!tip->resolved_known) tip->resolved = local_resolution_guess(model, tip->tet);
    bool beside = tip->resolved_known && v3_norm(v3_sub(tip->nominal, tip->resolved_at)) < mesh_edge_length(model->mesh, tip->tet);
    if (!beside) tick->output->events |= EVENT_LATE;
}

void follow_resolution(const tick_context *tick) {
    needle_tip *tip = &tick->state->tip;
    const line_piece *piece = snapshot_piece(tick->snapshot, tip->tet);
    if (!piece) {
        keep_resolution(tick);
        return;
    }
    resolved_field now = piece_at(piece, tip->nominal), used = now;
    if (tip->resolved_known) {
        resolved_field then = piece_at(piece, tip->resolved_at);
        double moved = v3_norm(v3_sub(tip->nominal, tip->resolved_at)), fading = exp(-0.5 * moved / tick->model->needle->radius);
        used.lateral = exp(faded(log(now.lateral), log(then.lateral), log(tip->resolved.lateral), fading));
        used.axial = exp(faded(log(now.axial), log(then.axial), log(tip->resolved.axial), fading));
        used.uneven = m3_scaled(1.0, now.uneven);
        m3_add_scaled(&used.uneven, fading, &tip->resolved.uneven);
        m3_add_scaled(&used.uneven, -fading, &then.uneven);
        line_end_add_scaled(&used.end, fading, &tip->resolved.end);
        line_end_add_scaled(&used.end, -fading, &then.end);
        used.end.reach = fmax(used.end.reach, 0.0);
        used.point = faded(now.point, then.point, tip->resolved.point, fading);
    }
    tip->resolved = used;
    tip->resolved_at = tip->nominal;
    tip->resolved_known = true;
}
