#include "insertion/tip/known_tissue.h"

#include <string.h>

#include "insertion/laws/creep.h"
#include "insertion/model/local_compliance.h"
#include "insertion/state/strata.h"
#include "insertion/track/contact_nodes.h"
#include "snapshot/snapshot_kernels.h"

/* Finds the handles of the corners around the last point of the tip's track that the snapshot covered. Returns false if there is none. */
static bool tip_handles(const tick_input *tick, const insertion_state *state, int handles[4]) {
    const needle_tip *tip = &state->tip;
    return tip->place.phase == TIP_INSIDE && tip->known.tet >= 0 && snapshot_covers(tick->snapshot, tick->model->mesh->tets[tip->known.tet], handles);
}

/* Returns the load (N) of active contact k, counted from the base, on the tissue. */
static vec3 load_of(const tick_input *tick, const insertion_state *state, int k) {
    return v3_add(state->contacts[state->refined.order[k]].force, creep_load(tick->model, &state->memory, k));
}

/* Returns how far (m) the tip's load displaces the node `handle`. The load acts on the nodes `corners`. */
static vec3 displaced_by_tip(const tick_input *tick, const insertion_state *state, const int corners[4], int handle) {
    mat3 c = compliance_to_point(tick->snapshot, corners, state->tip.known.weights, handle);
    return m3_apply_transposed(&c, v3_add(tip_load(&state->tip), creep_tip_load(tick->model, &state->memory)));
}

vec3 displacement_at(const tick_input *tick, const insertion_state *state, const creep_step *creep, const int handles[4], const double weights[4]) {
    handle_load loads[MAX_CONTACTS];
    int count = 0;
    for (; contact_is_active(state, count); count++) loads[count] = (handle_load){state->refined.order[count], load_of(tick, state, count)};
    vec3 u = creep_free_at(tick, state, creep, handles, weights);
    u = v3_add(u, displacement_under(tick->snapshot, handles, weights, count, loads));
    int corners[4];
    if (!tip_handles(tick, state, corners)) return u;
    for (int c = 0; c < 4; c++) u = v3_axpy(weights[c], displaced_by_tip(tick, state, corners, handles[c]), u);
    return u;
}

vec3 displacement_at_tip(const tick_input *tick, const insertion_state *state, const creep_step *creep) {
    const needle_tip *tip = &state->tip;
    int corners[4];
    bool covered = tip->known.tet >= 0 && snapshot_covers(tick->snapshot, tick->model->mesh->tets[tip->known.tet], corners);
    return covered ? displacement_at(tick, state, creep, corners, tip->known.weights) : v3(0, 0, 0);
}

/* Activates a contact whose row of the inverse has arrived. It starts with the state of the shaft next to the tip. */
static void activate_contact(const tick_input *tick, insertion_state *state, int k) {
    int slot = state->refined.order[k];
    shaft_contact *contact = &state->contacts[slot];
    contact->status = CONTACT_ACTIVE;
    contact->force = v3(0, 0, 0);
    /* the resolution was not known yet when the tip left the contact behind */
    if (contact->log_axial == 0.0) set_resolution(tick->model, contact, &tick->snapshot->resolved[slot]);
    if (state->tip.place.phase != TIP_INSIDE || contact->depth < tip_entry_depth(state)) return;
    double origin = contact->shaft.origin;
    contact->shaft = state->tip.shaft;
    contact->shaft.origin = origin;
}

/* Moves force from the tip to a new contact: the force on the part of the contact's share that was the tip's until now. The tip's share began at `from` (m of
   depth). */
static void take_over_force(const tick_input *tick, insertion_state *state, int k, double from) {
    shaft_contact *contact = &state->contacts[state->refined.order[k]];
    if (state->tip.place.phase != TIP_INSIDE || contact->depth < tip_entry_depth(state)) return;
    shaft_share share = shaft_share_of(state, k, true);
    vec3 along = q_axis(state->needle.frames[tick->model->needle->given.segments - 1]);
    contact->force = v3_scale(state->tip.shaft.traction * larger_of(share.to - larger_of(share.from, from), 0.0), along);
    state->tip.solved.force = v3_sub(state->tip.solved.force, contact->force);
}

int accept_snapshot(const tick_input *tick, insertion_state *state, tick_output *output) {
    int known = snapshot_known_contacts(tick->snapshot, &state->refined), passed = contacts_passed(state), before = contacts_active(state), now = before;
    double from = shaft_share_of(state, before, true).from;
    for (; now < known && now < passed; now++) activate_contact(tick, state, now);
    for (int k = before; k < now; k++) take_over_force(tick, state, k, from);
    if (now > before) output->events |= EVENT_ADDED;
    return now - before;
}

void follow_known_point(const tick_input *tick, insertion_state *state, tick_output *output, int handles[4]) {
    const insertion_model *model = tick->model;
    needle_tip *tip = &state->tip;
    double weights[4];
    int tet = refinement_element(model->mesh, &state->refined, snapshot_known_contacts(tick->snapshot, &state->refined), tip->place.tet, tip->place.nominal, weights);
    bool covered = snapshot_covers(tick->snapshot, model->mesh->tets[tet], handles);
    if (!covered && tet != tip->place.tet) { /* falls back to the nominal element, whose corners were requested */
        tet = tip->place.tet;
        mesh_barycentric(model->mesh, tet, tip->place.nominal, weights);
        covered = snapshot_covers(tick->snapshot, model->mesh->tets[tet], handles);
    }
    if (covered) {
        tip->known.tet = tet;
        memcpy(tip->known.weights, weights, sizeof weights);
        return;
    }
    output->events |= EVENT_LATE;
    if (!tip_handles(tick, state, handles)) handles[0] = NO_HANDLE;
}

/* Two measurements differ if the tip has entered another element or the line has turned. The difference fades as the tip advances by about one diameter. */
static double faded(double now, double then, double used, double fading) { return now + (used - then) * fading; }

/* Keeps the last measurement, because neighbouring elements differ little. If it was made more than an edge length away, or if there is none, the worker counts
   as late. */
static void keep_resolution(const tick_input *tick, insertion_state *state, tick_output *output) {
    const insertion_model *model = tick->model;
    needle_tip *tip = &state->tip;
    if (!tip->resolution.known) tip->resolution.field = local_resolution_guess(model, tip->place.tet);
    bool beside = tip->resolution.known && v3_norm(v3_sub(tip->place.nominal, tip->resolution.at)) < mesh_edge_length(model->mesh, tip->place.tet);
    if (!beside) output->events |= EVENT_LATE;
}

void follow_resolution(const tick_input *tick, insertion_state *state, tick_output *output) {
    needle_tip *tip = &state->tip;
    const line_piece *piece = snapshot_piece(tick->snapshot, tip->place.tet);
    if (!piece) {
        keep_resolution(tick, state, output);
        return;
    }
    resolved_field now = piece_at(piece, tip->place.nominal), used = now;
    if (tip->resolution.known) {
        resolved_field then = piece_at(piece, tip->resolution.at);
        double moved = v3_norm(v3_sub(tip->place.nominal, tip->resolution.at)), fading = exp(-0.5 * moved / tick->model->needle->radius);
        used.lateral = exp(faded(log(now.lateral), log(then.lateral), log(tip->resolution.field.lateral), fading));
        used.axial = exp(faded(log(now.axial), log(then.axial), log(tip->resolution.field.axial), fading));
        used.uneven = m3_scaled(1.0, now.uneven);
        m3_add_scaled(&used.uneven, fading, &tip->resolution.field.uneven);
        m3_add_scaled(&used.uneven, -fading, &then.uneven);
        line_end_add_scaled(&used.end, fading, &tip->resolution.field.end);
        line_end_add_scaled(&used.end, -fading, &then.end);
        used.end.reach = fmax(used.end.reach, 0.0);
        used.point = faded(now.point, then.point, tip->resolution.field.point, fading);
    }
    tip->resolution.field = used;
    tip->resolution.at = tip->place.nominal;
    tip->resolution.known = true;
}
