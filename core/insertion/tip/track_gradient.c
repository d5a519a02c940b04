#include "insertion/tip/track_gradient.h"

#include "insertion/laws/creep.h"
#include "insertion/state/strata.h"
#include "insertion/tip/known_tissue.h"
#include "insertion/tip/prefetch.h"
#include "insertion/tip/tip_walk.h"

/* Returns the displacement (m) of the tissue at a contact, which moves with the shaft. */
static vec3 carried(const tick_input *tick, const insertion_state *state, const shaft_contact *contact) {
    needle_point p = needle_at(tick->model->needle, &state->needle, contact_arc(contact, tick->model->needle->given.length));
    return v3_sub(p.position, contact->track);
}

/* Returns the displacement (m) of the tissue at one span (contact.gradient_span) behind the tip, where it moves with the shaft. */
static vec3 displacement_behind(const tick_input *tick, const insertion_state *state, vec3 at_tip) {
    vec3 ahead = at_tip;
    double ahead_depth = state->tip.place.depth, sought = ahead_depth - tick->model->settings.gradient_span;
    for (int k = contacts_active(state) - 1; k >= 0; k--) {
        const shaft_contact *contact = &state->contacts[state->refined.order[k]];
        double depth = contact->depth;
        if (depth < tip_bonded_depth(state)) break; /* the contact is in another body, or in tissue that slides along the tip's */
        vec3 here = carried(tick, state, contact);
        if (depth <= sought) return v3_axpy((sought - depth) / (ahead_depth - depth), v3_sub(ahead, here), here);
        ahead = here;
        ahead_depth = depth;
    }
    return ahead;
}

/* Returns the displacement (m) of the tissue one span ahead of the tip, or at the end of the tissue if that is closer. If the snapshot does not cover that
   point, returns the displacement at the tip. */
static vec3 displacement_ahead(const tick_input *tick, const insertion_state *state, const creep_step *creep, vec3 direction, vec3 at_tip) {
    const mesh *m = tick->model->mesh;
    double left = tick->model->settings.gradient_span, chord;
    vec3 x = state->tip.place.nominal;
    int tet = state->tip.place.tet;
    direction = tip_way(&state->tip.place, direction);
    for (int step = 0; step < MAX_STEPS; step++) {
        int face = mesh_exit(m, tet, x, direction, &chord);
        x = v3_axpy(fmin(left, chord), direction, x);
        left -= chord;
        if (face < 0 || left <= 0.0 || mesh_bonded(m, tet, face) < 0) break;
        tet = m->neighbours[tet][face];
    }
    int handles[4];
    double weights[4];
    tet = refinement_element(m, &state->refined, snapshot_known_contacts(tick->snapshot, &state->refined), tet, x, weights);
    if (!snapshot_covers(tick->snapshot, m->tets[tet], handles)) return at_tip;
    double depth = state->tip.place.depth + tick->model->settings.gradient_span - fmax(left, 0.0), half = 0.5 * tick->snapshot->unresolved.step;
    return v3_add(displacement_at(tick, state, creep, handles, weights), creep_unresolved(tick, state, creep, depth - half, depth + half));
}

vec3 track_gradient(const tick_input *tick, const insertion_state *state, const creep_step *creep) {
    if (state->tip.place.phase != TIP_INSIDE) return v3(0, 0, 0);
    needle_point end = needle_at(tick->model->needle, &state->needle, tick->model->needle->given.length - state->tip.solved.slip);
    vec3 at_tip = v3_sub(end.position, tip_position(&state->tip.place));
    vec3 ahead = displacement_ahead(tick, state, creep, needle_along(&end), at_tip);
    double span = tick->model->settings.gradient_span, behind = fmin((state->tip.place.depth - tip_bonded_depth(state)) / span, 1.0);
    return v3_scale(0.5 * behind / span, v3_sub(ahead, displacement_behind(tick, state, at_tip)));
}
