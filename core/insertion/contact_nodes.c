#include "insertion/contact_nodes.h"

#include "insertion/local_compliance.h"
#include "insertion/strata.h"

static const double LONGEST_SHARE = 0.8; /* edge lengths: of the mesh; a longer way through an element has more than one contact. Chosen */
static const double PLAN_TOLERANCE = 2e-4; /* m: a planned contact node is used if the tip passes this close to it. Chosen */
static const double LAST_PLACE = 0.95; /* fraction above 0.5 and below 1: of the way through an element; a node that would be due farther on is left to the next
                                          one. Chosen: 0.5 is where its node usually is, 1 is the face */

double last_contact_depth(const insertion_state *state) {
    const shaft_contact *last = last_contact(state);
    return last ? last->depth : -INFINITY;
}

void set_beside(needle_tip *tip, vec3 beside) {
    tip->beside = beside;
    tip->outward = v3_norm(beside) > 0.0 ? v3_unit(beside) : v3(0, 0, 0);
}

/* The needle's way past a new node, as it was asked for before if it was. */
static void set_line(insertion_state *state, int slot, vec3 direction) {
    added_node *node = &state->refined.nodes[slot];
    node->line = (line_in_tet){node->tet, node->position, v3_unit(direction)};
    const line_in_tet *known = request_line(&state->request, &node->line, SAME_FIELD);
    if (known) node->line = *known;
}

/* Adds a planned contact on the tip's way. Returns its slot, or -1 when there is no room. */
static int add_contact(const tick_context *tick, vec3 position, double depth, vec3 way) {
    const insertion_model *model = tick->model;
    insertion_state *state = tick->state;
    if (state->refined.count == MAX_CONTACTS) {
        tick->output->events |= EVENT_FULL;
        return -1;
    }
    uint64_t id = ++state->next_id;
    int slot = refinement_add(model->mesh, &state->refined, state->tip.tet, position, id);
    set_line(state, slot, way);
    state->contacts[slot] = (shaft_contact){.status = CONTACT_PLANNED, .track = position, .depth = depth};
    return slot;
}

void drop_plan(insertion_state *state) {
    if (contact_planned(state) >= 0) state->refined.count--;
    state->tip.next_contact = NAN;
}

/* The way through an element has shares of equal length, each with its contact node in the middle. `another`: the tip is at such a node,
   with half of its share ahead. */
static void plan(const tick_context *tick, vec3 direction, bool another) {
    const insertion_model *model = tick->model;
    insertion_state *state = tick->state;
    needle_tip *tip = &state->tip;
    double chord;
    drop_plan(state);
    tip->next_contact = INFINITY;
    direction = tip_way(tip, direction);
    if (mesh_exit(model->mesh, tip->tet, tip->nominal, direction, &chord) < 0) return;
    double earliest = last_contact_depth(state) + model->settings.contact_spacing;
    double shares = chord / (LONGEST_SHARE * mesh_edge_length(model->mesh, tip->tet));
    shares = another ? ceil(shares - 0.5) : fmax(ceil(shares), 1.0);
    if (shares < 1.0) return;
    double due = fmax(tip->depth + (another ? chord / (shares + 0.5) : 0.5 * chord / shares), earliest);
    if (due >= tip->depth + LAST_PLACE * chord) return;
    tip->next_contact = due;
    add_contact(tick, v3_axpy(due - tip->depth, direction, tip->nominal), due, direction);
}

void plan_contact(const tick_context *tick, vec3 direction) { plan(tick, direction, false); }

void plan_another(const tick_context *tick, vec3 direction) { plan(tick, direction, true); }

bool leaves_contact_at_exit(const tick_context *tick, double depth) {
    return depth - last_contact_depth(tick->state) > 0.5 * tick->model->settings.contact_spacing;
}

void plan_exit(const tick_context *tick, vec3 way, double left) {
    insertion_state *state = tick->state;
    needle_tip *tip = &state->tip;
    double due = tip->next_contact;
    if (due < tip->depth + left || !leaves_contact_at_exit(tick, tip->depth + left)) return;
    vec3 exit = v3_axpy(left, way, tip->nominal);
    int slot = contact_planned(state);
    if (slot >= 0 && v3_norm(v3_sub(state->contacts[slot].track, exit)) < 0.5 * PLAN_TOLERANCE) return;
    drop_plan(state);
    tip->next_contact = due;
    add_contact(tick, exit, tip->depth + left, way);
}

void set_resolution(const insertion_model *model, shaft_contact *contact, const resolved_field *resolved) {
    contact->log_axial = local_logarithm(model, resolved).axial;
    contact->log_lateral = local_logarithm_across(model, resolved, contact->direction);
    contact->resolved = *resolved;
}

void leave_contact(const tick_context *tick) {
    insertion_state *state = tick->state;
    needle_tip *tip = &state->tip;
    int slot = contact_planned(state);
    if (slot < 0 || v3_norm(v3_sub(state->contacts[slot].track, tip->nominal)) >= PLAN_TOLERANCE) {
        drop_plan(state);
        slot = add_contact(tick, tip->nominal, tip->depth, tip_way(tip, tip->direction));
    }
    if (slot >= 0) {
        state->contacts[slot] = (shaft_contact){.status = CONTACT_WAITING, .track = tip_place(tip), .beside = tip->beside, .direction = tip->direction,
                                                .depth = tip->depth, .shaft = tip->shaft};
        if (tip->resolved_known) set_resolution(tick->model, &state->contacts[slot], &tip->resolved);
    }
    tip->next_contact = INFINITY;
}

void take_up_contact(const tick_context *tick) {
    insertion_state *state = tick->state;
    int last = state->refined.order[--state->refined.count];
    const added_node *node = &state->refined.nodes[last];
    const shaft_contact *contact = &state->contacts[last];
    needle_tip *tip = &state->tip;
    double weights[4];
    tip->nominal = v3_sub(contact->track, contact->beside);
    set_beside(tip, contact->beside);
    tip->tet = refinement_element(tick->model->mesh, &state->refined, 0, node->tet, tip->nominal, weights);
    tip->direction = contact->direction;
    tip->depth = contact->depth;
    tip->shaft = contact->shaft;
    if (contact->log_axial != 0.0) {
        double point = tip->resolved.point; /* of the end face, which nothing else has borne */
        tip->resolved = contact->resolved;
        tip->resolved.point = point;
        tip->resolved_at = tip->nominal;
    }
    tip->next_contact = NAN;
    leave_strata(state);
    tick->output->events |= EVENT_REMOVED;
}
