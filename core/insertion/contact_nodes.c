#include "insertion/contact_nodes.h"

#include "insertion/strata.h"

static const double PLAN_TOLERANCE = 2e-4; /* m, a planned contact node is used if the tip passes this close to it */

double last_contact_depth(const insertion_state *state) {
    int passed = contacts_passed(state);
    return passed > 0 ? state->contacts[passed - 1].depth : -INFINITY;
}

void set_beside(needle_tip *tip, vec3 beside) {
    tip->beside = beside;
    tip->outward = v3_norm(beside) > 0.0 ? v3_unit(beside) : v3(0, 0, 0);
}

/* Adds a node on the face, or inside the element if moved nodes have displaced the face. */
static int add_instead(const mesh *m, refinement *r, int tet, vec3 position, uint64_t id) {
    int index = refinement_add_on_face(m, r, tet, position, id);
    if (v3_norm(v3_sub(r->nodes[index].position, position)) < PLAN_TOLERANCE) return index;
    r->count--;
    return refinement_add(m, r, tet, position, id);
}

static int move_or_add(const tick_context *tick, int near, vec3 position, uint64_t id) {
    const insertion_model *model = tick->model;
    refinement *r = &tick->state->refined;
    double weights[4];
    int tet = refinement_element(model->mesh, r, r->count, near, position, weights), index = refinement_move(model->tissue, r, tet, position, id);
    if (index >= 0) return index;
    tick->output->events |= EVENT_KEPT;
    return add_instead(model->mesh, r, tet, position, id);
}

/* Adds a contact node; false when there is no room. */
static bool add_contact(const tick_context *tick, vec3 position, double depth) {
    const insertion_model *model = tick->model;
    insertion_state *state = tick->state;
    if (state->refined.count == MAX_CONTACTS) {
        tick->output->events |= EVENT_FULL;
        return false;
    }
    uint64_t id = ++state->next_id;
    int tet = state->tip.tet, index;
    switch (model->settings.placement) {
    case PLACE_ON_FACES: index = refinement_add_on_face(model->mesh, &state->refined, tet, position, id); break;
    case PLACE_MOVED: index = move_or_add(tick, tet, position, id); break;
    default: index = refinement_add(model->mesh, &state->refined, tet, position, id); break;
    }
    state->contacts[index] = (shaft_contact){.track = position, .depth = depth};
    return true;
}

void drop_plan(insertion_state *state) {
    if (state->tip.planned) state->refined.count--;
    state->tip.planned = false;
    state->tip.next_contact = NAN;
}

void plan_contact(const tick_context *tick, vec3 direction) {
    const insertion_model *model = tick->model;
    insertion_state *state = tick->state;
    needle_tip *tip = &state->tip;
    double chord;
    drop_plan(state);
    tip->next_contact = INFINITY;
    direction = tip_way(tip, direction);
    if (mesh_exit(model->mesh, tip->tet, tip->nominal, direction, &chord) < 0) return;
    double earliest = last_contact_depth(state) + model->settings.contact_spacing;
    if (model->settings.placement != PLACE_INSIDE) { /* left where the tip crosses the face, not at a given depth */
        if (tip->depth + chord >= earliest)
            tip->planned = add_contact(tick, v3_axpy(chord, direction, tip->nominal), tip->depth + chord);
        return;
    }
    double due = fmax(tip->depth + 0.5 * chord, earliest);
    if (due >= tip->depth + 0.95 * chord) return;
    tip->next_contact = due;
    tip->planned = add_contact(tick, v3_axpy(due - tip->depth, direction, tip->nominal), due);
}

void leave_contact(const tick_context *tick) {
    insertion_state *state = tick->state;
    needle_tip *tip = &state->tip;
    bool met = tip->planned && v3_norm(v3_sub(state->contacts[state->refined.count - 1].track, tip->nominal)) < PLAN_TOLERANCE;
    if (!met) drop_plan(state);
    if (met || add_contact(tick, tip->nominal, tip->depth)) {
        shaft_contact *contact = &state->contacts[state->refined.count - 1];
        *contact = (shaft_contact){.arc = tick->model->needle->given.length, .track = tip_place(tip), .beside = tip->beside, .direction = tip->direction, .depth = tip->depth, .slip = tip->shaft_slip, .slid = tip->shaft_slid,
                                   .friction = tip->shaft_friction};
    }
    tip->planned = false;
    tip->next_contact = INFINITY;
}

void take_up_contact(const tick_context *tick) {
    insertion_state *state = tick->state;
    int last = --state->refined.count;
    const added_node *node = &state->refined.nodes[last];
    needle_tip *tip = &state->tip;
    double weights[4];
    tip->nominal = v3_sub(state->contacts[last].track, state->contacts[last].beside);
    set_beside(tip, state->contacts[last].beside);
    tip->tet = refinement_element(tick->model->mesh, &state->refined, 0, node->tet, tip->nominal, weights);
    tip->direction = state->contacts[last].direction;
    tip->depth = state->contacts[last].depth;
    tip->shaft_slid = state->contacts[last].slid;
    tip->next_contact = NAN;
    leave_strata(state);
    if (state->active > last) state->active = last;
    tick->output->events |= EVENT_REMOVED;
}
