#include "insertion/tip/outside.h"

static const double NEAR = 10e-3; /* m: the shaft is not checked this close to where the track begins and ends, because the skin is displaced there. Chosen by
                                     judgement */

/* A range of the shaft, in m from the base. */
typedef struct {
    double from, to;
} shaft_range;

/* Returns the range of the shaft that is in the track, plus a margin; if the needle is outside the tissue, only its end. */
static shaft_range known_range(const tick_input *tick, const insertion_state *state) {
    const needle_tip *tip = &state->tip;
    double length = tick->model->needle->given.length;
    if (tip->place.phase == TIP_FREE) return (shaft_range){length - NEAR, length};
    vec3 moved = v3_sub(state->needle.joints[tick->model->needle->given.segments], tip_position(&tip->place));
    double entry = length - tip->place.depth, exit = length;
    if (contacts_passed(state) > 0) {
        const shaft_contact *first = &state->contacts[state->refined.order[0]], *last = last_contact(state);
        moved = v3_sub(needle_at(tick->model->needle, &state->needle, contact_arc(first, length)).position, first->track);
        entry = first->shaft.origin;
        if (tip->place.phase == TIP_BEYOND) exit = last->shaft.origin + tip->place.depth + NEAR + v3_norm(moved);
    }
    return (shaft_range){entry - NEAR - v3_norm(moved), exit};
}

void outside_watch(const tick_input *tick, insertion_state *state, tick_output *output) {
    int count = tick->model->needle->given.segments, k = state->watched = (state->watched + 1) % count;
    shaft_range known = known_range(tick, state);
    double from = k * tick->model->needle->segment_length, to = from + tick->model->needle->segment_length;
    bool free = to <= known.from || (from >= known.to && to <= count * tick->model->needle->segment_length - NEAR);
    bool inside = free && mesh_enter(tick->model->mesh, state->needle.joints[k], state->needle.joints[k + 1]).hit;
    uint64_t bit = (uint64_t)1 << k;
    state->outside = inside ? state->outside | bit : state->outside & ~bit;
    if (state->outside) output->events |= EVENT_OUTSIDE_MODEL;
}
