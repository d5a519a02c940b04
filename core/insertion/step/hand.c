#include "insertion/step/hand.h"

#include "insertion/contact/roll.h"
#include "insertion/guide/guides.h"

static double slid_on(double slid, double slip, friction_state friction, const roll_friction *roll, double radius) {
    return friction == STICK && roll->friction == STICK ? 0.0 : slid + roll_slip_length(slip, roll, radius);
}

static void slide(shaft_hold *shaft, double radius) {
    shaft->origin -= shaft->slip;
    shaft->slid = slid_on(shaft->slid, shaft->slip, shaft->friction, &shaft->roll, radius);
}

/* Slides the shaft past its contacts by the slips of the last solve. At contacts still waiting for their row of the inverse, it slides as far as the shaft next
   to them. */
static void slide_in_tissue(insertion_state *state, double radius) {
    double slip = 0.0;
    for (int k = 0; contact_is_active(state, k); k++) {
        shaft_contact *contact = &state->contacts[state->refined.order[k]];
        slide(&contact->shaft, radius);
        contact->shaft.origin = larger_of(contact->shaft.origin, -contact->depth); /* if the needle is pushed in all the way, its base carries along the
                                                                                      contacts it reaches */
        slip = contact->shaft.slip;
    }
    bool inside = state->tip.place.phase == TIP_INSIDE;
    if (inside) slip = state->tip.shaft.slip;
    if (inside) state->tip.shaft.slid = slid_on(state->tip.shaft.slid, slip, state->tip.shaft.friction, &state->tip.shaft.roll, radius);
    shift_tip_shaft(state, -slip); /* does nothing if the tip is outside the tissue */
}

/* Moves the base to the hand's new pose, keeping the deflection of the spring that connects them. */
static void move_base(const tick_input *tick, insertion_state *state) {
    pose base = tick->base.pose;
    base.position = v3_add(base.position, state->base_shift);
    roll_follow_base(state, base.orientation);
    needle_move_base(tick->model->needle, base, &state->needle);
}

void hand_slide_shaft(const tick_input *tick, insertion_state *state) {
    guides_slide(tick->model, state);
    if (state->tip.place.phase != TIP_FREE) slide_in_tissue(state, tick->model->needle->radius);
}

void hand_move(const tick_input *tick, insertion_state *state, hand_advance *hand) {
    const insertion_model *model = tick->model;
    const vec3 *joints = state->needle.joints;
    int end = model->needle->given.segments;
    hand->end_before = joints[end];
    hand->straight_before = needle_straight_end(model->needle, state->needle.base);
    if (state->tip.place.phase == TIP_FREE && !guides_hold(model, state)) needle_set_straight(model->needle, tick->base.pose, &state->needle);
    else move_base(tick, state);
    vec3 along = v3_unit(v3_sub(joints[end], joints[end - 1]));
    hand->carried = fmax(0.0, v3_dot(along, v3_sub(joints[end], hand->end_before)));
}
