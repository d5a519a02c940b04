#include "insertion/tip/next_body.h"

#include "insertion/state/strata.h"
#include "insertion/tip/known_tissue.h"
#include "insertion/tip/tip_walk.h"
#include "insertion/track/contact_nodes.h"
#include "insertion/track/old_tracks.h"

static const double OVERLAP = 2e-3; /* m: largest overlap allowed between separately meshed bodies. Chosen by judgement */

vec3 needle_direction(const tick_input *tick, const insertion_state *state) {
    quat frame = state->needle.frames[tick->model->needle->given.segments - 1];
    double slope = tick->model->needle->given.bevel_slope, lead = state->tip_lead;
    return q_rotate(frame, v3(slope * sin(lead), -slope * cos(lead), 1.0));
}

/* Returns how far (m) the needle's end is beyond the exit point, which moves with the tissue. */
static double beyond_exit(const tick_input *tick, const insertion_state *state, const creep_step *creep) {
    vec3 exit = v3_add(tip_position(&state->tip.place), displacement_at_tip(tick, state, creep));
    return v3_dot(v3_sub(state->needle.joints[tick->model->needle->given.segments], exit), v3_unit(needle_direction(tick, state)));
}

void reenter_tissue(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output) {
    needle_tip *tip = &state->tip;
    double beyond = beyond_exit(tick, state, creep);
    const shaft_contact *last = last_contact(state);
    if (beyond > -tick->model->needle->radius) return;
    tip->place.phase = TIP_INSIDE;
    tip->solved.slip = beyond;
    tip->shaft = last ? last->shaft : shaft_at_rest(tick->model, tip->place.depth + beyond);
    tip->shaft.traction = 0.0;
    output->events |= EVENT_REENTERED;
}

static entrance entrance_at(const tick_input *tick, const insertion_state *state, surface_hit hit) {
    int blocked_by = hit.hit ? old_tracks_obstacle(tick, state, hit.tet, hit.face, hit.tet, hit.point) : NOT_BLOCKED;
    return (entrance){hit.hit, hit.tet, hit.face, blocked_by, hit.point};
}

void enter_next(const tick_input *tick, insertion_state *state, tick_output *output, const entrance *at, double gap) {
    needle_tip *tip = &state->tip;
    if (!at->found) return;
    if (state->stratum_count + 2 > MAX_STRATA) {
        output->events |= EVENT_FULL;
        return;
    }
    note_stratum(state, output, IN_A_GAP);
    tip->place.phase = TIP_INSIDE;
    tip->place.tet = at->tet;
    tip->barrier.face = at->face;
    tip->place.nominal = at->point;
    set_beside(tip, v3(0, 0, 0));
    tip->place.direction = v3_unit(needle_direction(tick, state));
    tip->place.depth += fmax(gap, FACE_CLEARANCE);
    tip->known.tet = -1;
    tip->barrier.blocked_by = at->blocked_by;
    tip->barrier.entering = true;
    tip->next_contact = NAN;
    tip->shaft = shaft_at_rest(tick->model, tip->place.depth);
    enter_stratum(tick, state, output);
    output->events |= EVENT_TOUCHED;
}

entrance next_body(const tick_input *tick, const insertion_state *state, vec3 left, vec3 to) {
    const insertion_model *model = tick->model;
    vec3 direction = v3_unit(v3_sub(to, left)), beyond = v3_axpy(2.0 * FACE_CLEARANCE, direction, left);
    entrance overlap = entrance_at(tick, state, mesh_enter(model->mesh, v3_axpy(-OVERLAP, direction, left), left));
    surface_hit before = {.hit = overlap.found, .tet = overlap.tet, .point = overlap.point};
    if (before.hit && reaches(model->mesh, before, beyond, &overlap.tet)) {
        overlap.point = beyond;
        return overlap;
    }
    return entrance_at(tick, state, mesh_enter(model->mesh, v3_axpy(-FACE_CLEARANCE, direction, left), to));
}

void enter_touching_body(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction) {
    vec3 left = state->tip.place.nominal, way = v3_sub(state->tip.place.end, left);
    if (v3_dot(way, direction) < 2.0 * FACE_CLEARANCE) way = v3_scale(2.0 * FACE_CLEARANCE, direction);
    entrance at = next_body(tick, state, left, v3_add(left, way));
    enter_next(tick, state, output, &at, v3_norm(v3_sub(at.point, left)));
}

void enter_body_ahead(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output) {
    const insertion_model *model = tick->model;
    needle_tip *tip = &state->tip;
    vec3 before = tip->place.end, now = state->needle.joints[model->needle->given.segments];
    tip->place.end = now;
    if (v3_dot(v3_sub(now, before), needle_direction(tick, state)) <= 0.0) return;
    entrance at = entrance_at(tick, state, mesh_enter(model->mesh, before, now));
    enter_next(tick, state, output, &at, beyond_exit(tick, state, creep) - v3_norm(v3_sub(now, at.point)));
}
