#include "insertion/track/contact_nodes.h"

#include "insertion/model/local_compliance.h"
#include "insertion/state/strata.h"

static const double LONGEST_SHARE = 0.8; /* edge lengths: a chord longer than this gets several contacts, each for an equal part. Chosen by judgement */
static const double PLAN_TOLERANCE = 2e-4; /* m: a planned contact node can be used only if the tip passes it within this distance. Chosen by judgement */
static const double LAST_PLACE = 0.95; /* fraction of the chord, above 0.5 and below 1: along the chord through an element, a node due beyond this point is placed in the next
                                          element. Chosen: 0.5 is the usual place of a node, 1 is the face */

double last_contact_depth(const insertion_state *state) {
    const shaft_contact *last = last_contact(state);
    return last ? last->depth : -INFINITY;
}

void set_beside(needle_tip *tip, vec3 beside) {
    tip->place.beside = beside;
    tip->place.graze_normal = v3_norm(beside) > 0.0 ? v3_unit(beside) : v3(0, 0, 0);
}

/* Sets the needle's line at a new node. Uses the line of the last request if it is almost the same, so that it need not be measured again. */
static void set_line(insertion_state *state, int slot, vec3 direction) {
    added_node *node = &state->refined.nodes[slot];
    node->line = (line_in_tet){node->tet, node->position, v3_unit(direction)};
    const line_in_tet *known = request_line(&state->request, &node->line, SAME_FIELD);
    if (known) node->line = *known;
}

/* Adds a planned contact ahead of the tip. Returns its slot, or -1 if there is no room. */
static int add_contact(const tick_input *tick, insertion_state *state, tick_output *output, vec3 position, double depth, vec3 way) {
    const insertion_model *model = tick->model;
    if (state->refined.count == MAX_CONTACTS) {
        output->events |= EVENT_FULL;
        return -1;
    }
    uint64_t id = ++state->next_id;
    int slot = refinement_add(model->mesh, &state->refined, state->tip.place.tet, position, id);
    set_line(state, slot, way);
    state->contacts[slot] = (shaft_contact){.status = CONTACT_PLANNED, .track = position, .depth = depth};
    return slot;
}

void drop_plan(insertion_state *state) {
    if (contact_planned(state) >= 0) state->refined.count--;
    state->tip.next_contact = NAN;
}

/* Plans the next contact node. The chord through an element is divided into equal parts, with a node in the middle of each. `another`: the tip is at such a
   node, with half of its part still ahead. */
static void plan(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction, bool another) {
    const insertion_model *model = tick->model;
    needle_tip *tip = &state->tip;
    double chord;
    drop_plan(state);
    tip->next_contact = INFINITY;
    direction = tip_way(&tip->place, direction);
    if (mesh_exit(model->mesh, tip->place.tet, tip->place.nominal, direction, &chord) < 0) return;
    double earliest = last_contact_depth(state) + model->settings.contact_spacing;
    double shares = chord / (LONGEST_SHARE * mesh_edge_length(model->mesh, tip->place.tet));
    shares = another ? ceil(shares - 0.5) : fmax(ceil(shares), 1.0);
    if (shares < 1.0) return;
    double due = fmax(tip->place.depth + (another ? chord / (shares + 0.5) : 0.5 * chord / shares), earliest);
    if (due >= tip->place.depth + LAST_PLACE * chord) return;
    tip->next_contact = due;
    add_contact(tick, state, output, v3_axpy(due - tip->place.depth, direction, tip->place.nominal), due, direction);
}

void plan_contact(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction) { plan(tick, state, output, direction, false); }

void plan_another(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction) { plan(tick, state, output, direction, true); }

bool wants_contact_at_exit(const tick_input *tick, const insertion_state *state, double depth) {
    return depth - last_contact_depth(state) > 0.5 * tick->model->settings.contact_spacing;
}

void plan_exit(const tick_input *tick, insertion_state *state, tick_output *output, vec3 way, double left) {
    needle_tip *tip = &state->tip;
    double due = tip->next_contact;
    if (due < tip->place.depth + left || !wants_contact_at_exit(tick, state, tip->place.depth + left)) return;
    vec3 exit = v3_axpy(left, way, tip->place.nominal);
    int slot = contact_planned(state);
    if (slot >= 0 && v3_norm(v3_sub(state->contacts[slot].track, exit)) < 0.5 * PLAN_TOLERANCE) return;
    drop_plan(state);
    tip->next_contact = due;
    add_contact(tick, state, output, exit, tip->place.depth + left, way);
}

void set_resolution(const insertion_model *model, shaft_contact *contact, const resolved_field *resolved) {
    contact->log_axial = local_logarithm(model, resolved).axial;
    contact->log_lateral = local_logarithm_across(model, resolved, contact->direction);
    contact->resolved = *resolved;
}

void place_contact(const tick_input *tick, insertion_state *state, tick_output *output) {
    needle_tip *tip = &state->tip;
    int slot = contact_planned(state);
    if (slot < 0 || v3_norm(v3_sub(state->contacts[slot].track, tip->place.nominal)) >= PLAN_TOLERANCE) {
        drop_plan(state);
        slot = add_contact(tick, state, output, tip->place.nominal, tip->place.depth, tip_way(&tip->place, tip->place.direction));
    }
    if (slot >= 0) {
        state->contacts[slot] = (shaft_contact){.status = CONTACT_WAITING, .track = tip_position(&tip->place), .beside = tip->place.beside, .direction = tip->place.direction,
                                                .depth = tip->place.depth, .shaft = tip->shaft};
        if (tip->resolution.known) set_resolution(tick->model, &state->contacts[slot], &tip->resolution.field);
    }
    tip->next_contact = INFINITY;
}

void return_to_contact(const tick_input *tick, insertion_state *state, tick_output *output) {
    int last = state->refined.order[--state->refined.count];
    const added_node *node = &state->refined.nodes[last];
    const shaft_contact *contact = &state->contacts[last];
    needle_tip *tip = &state->tip;
    double weights[4];
    tip->place.nominal = v3_sub(contact->track, contact->beside);
    set_beside(tip, contact->beside);
    tip->place.tet = refinement_element(tick->model->mesh, &state->refined, 0, node->tet, tip->place.nominal, weights);
    tip->place.direction = contact->direction;
    tip->place.depth = contact->depth;
    tip->shaft = contact->shaft;
    if (contact->log_axial != 0.0) {
        double point = tip->resolution.field.point; /* resolution at the end face, which contacts do not have */
        tip->resolution.field = contact->resolved;
        tip->resolution.field.point = point;
        tip->resolution.at = tip->place.nominal;
    }
    tip->next_contact = NAN;
    drop_strata_ahead(state);
    output->events |= EVENT_REMOVED;
}
