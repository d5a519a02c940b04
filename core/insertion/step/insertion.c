#include "insertion/step/insertion.h"

#include <string.h>

#include "insertion/contact/roll.h"
#include "insertion/contact/tissue_stage.h"
#include "insertion/memory/creep.h"
#include "insertion/step/equilibrium.h"
#include "insertion/step/hand.h"
#include "insertion/tip/known_tissue.h"
#include "insertion/tip/outside.h"
#include "insertion/tip/path.h"
#include "insertion/tip/prefetch.h"
#include "insertion/tip/tip.h"
#include "insertion/tip/track_gradient.h"

static const double LEAST_TICK = 1e-6; /* s: a shorter tick counts as that. Rounding */
static const double SAME_TIME = 1e-6; /* steps: by which a tick may be longer than a whole number of them. Rounding */

void insertion_reset(const insertion_model *model, pose base, insertion_state *state) {
    uint64_t serial = state->request.serial, next_id = state->next_id; /* kept, so that no old snapshot matches */
    creep_forget(&state->memory);
    tissue_memory memory = state->memory; /* its clock goes on */
    memset(state, 0, sizeof *state);
    state->memory = memory;
    state->request.serial = serial;
    state->next_id = next_id;
    state->tip = tip_in_air();
    state->tip.solved.arc = model->needle->given.length;
    state->surface = v3(NAN, NAN, NAN);
    needle_set_straight(model->needle, base, &state->needle);
    tip_engage(model, state);
    prefetch_request(model, state);
}

/* ---- one step ------------------------------------------------------------------------------------------------------ */

/* Sums the forces of all points into the wrench on the base. */
static void find_wrench(const insertion_state *state, const contact_points *points, tick_output *output) {
    output->force = output->torque = v3(0, 0, 0);
    for (int i = 0; i < points->count; i++) {
        const contact_point *point = &points->list[i];
        vec3 on_needle = v3_scale(-1.0, point_force(state, point));
        vec3 lever = v3_sub(point->at.position, state->needle.base.position);
        output->force = v3_add(output->force, on_needle);
        output->torque = v3_add(output->torque, v3_cross(lever, on_needle));
    }
    double torque = roll_torque(state, points);
    if (torque != 0.0) output->torque = v3_axpy(-torque, q_axis(state->needle.base.orientation), output->torque);
    output->depth = state->tip.place.phase == TIP_FREE ? 0.0 : state->tip.place.depth;
    output->contacts = contacts_active(state);
}

/* Each stage is given what those before it have written. */
static void step(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output) {
    creep_begin(tick, state, &w->creep);
    hand_slide_shaft(tick, state);
    vec3 gradient = track_gradient(tick, state, &w->creep);
    hand_move(tick, state, &w->hand);
    path_follow(tick, state, &w->hand, &w->path, &w->creep, output, gradient);
    accept_snapshot(tick, state, output);
    if (tissue_find(tick, state, &w->points, &w->tissue, &w->creep, &w->stiffening, &w->damper, output)) equilibrium_find(tick, state, w, output);
    else equilibrium_forget(state);
    tip_puncture(tick, state, output);
    find_wrench(state, &w->points, output);
}

void insertion_tick(const tick_input *given, insertion_state *state, insertion_workspace *w, tick_output *output) {
    *output = (tick_output){.membrane = -1};
    profile_begin(&w->profile);
    pose held = state->needle.base;
    held.position = v3_sub(held.position, state->base_shift);
    double dt = fmax(given->dt, LEAST_TICK);
    const insertion_settings *settings = &given->model->settings;
    int steps = (int)fmin(ceil(dt / settings->longest_step - SAME_TIME), settings->most_steps);
    tick_input tick = *given;
    tick.dt = steps > 1 ? dt / steps : dt;
    for (int i = 1; i < steps; i++) {
        tick.base.pose = pose_between(held, given->base.pose, (double)i / steps);
        step(&tick, state, w, output);
    }
    tick.base.pose = given->base.pose;
    step(&tick, state, w, output);
    outside_watch(&tick, state, output);
    prefetch_request(given->model, state);
    profile_end_stage(&w->profile, INSERTION_WRENCH);
}

bool insertion_linearise(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output, bool loaded) {
    if (!touches_tissue(state)) return false;
    creep_begin(tick, state, &w->creep);
    tissue_find(tick, state, &w->points, &w->tissue, &w->creep, &w->stiffening, &w->damper, output);
    equilibrium_linearise(tick, state, w, loaded);
    return true;
}

/* ---- what is not finite -------------------------------------------------------------------------------------------- */

static double sum_of(vec3 v) { return v.x + v.y + v.z; }

static double shaft_total(const shaft_hold *s) {
    return s->origin + s->slip + s->slid + s->traction + s->softness + s->stiffening + s->roll.turned + s->roll.torque;
}

/* A sum is finite only if all its terms are. */
bool insertion_is_finite(const insertion_state *state, const tick_output *output) {
    const needle_tip *tip = &state->tip;
    double sum = state->base_turn + state->tip_lead + sum_of(output->force) + sum_of(output->torque) + sum_of(tip_position(&tip->place)) + sum_of(state->entry) + tip->place.depth + tip->solved.slip
               + shaft_total(&tip->shaft) + tip->filtered_push + tip->dent.size + sum_of(tip->dent.damping) + tip->solved.end_force
               + tip->resolution.field.lateral + tip->resolution.field.axial + tip->resolution.field.point + line_end_total(&tip->resolution.field.end);
    for (int k = 0; k < state->refined.count; k++) {
        int slot = state->refined.order[k];
        const shaft_contact *c = &state->contacts[slot];
        sum += sum_of(state->refined.nodes[slot].position) + c->depth + shaft_total(&c->shaft) + plane_total(c->log_lateral) + c->log_axial + line_end_total(&c->resolved.end);
    }
    sum += creep_sum(&state->memory);
    for (int i = 0; i < MAX_GUIDES; i++)
        for (int f = 0; f < GUIDE_FACES; f++) {
            const guide_contact *face = &state->guides[i].faces[f];
            sum += face->arc + face->slip + sum_of(face->force);
        }
    return isfinite(sum);
}

void insertion_start_over(const insertion_model *model, pose base, insertion_state *state, tick_output *output) {
    insertion_reset(model, base, state);
    *output = (tick_output){.depth = state->tip.place.depth, .membrane = -1, .events = EVENT_UNSTABLE};
}

/* ---- export -------------------------------------------------------------------------------------------------------- */

void insertion_refinement(const insertion_state *state, refinement *out) {
    refinement_compact(&state->refined, contacts_active(state), out);
}

void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added) {
    const needle_tip *tip = &state->tip;
    for (int k = 0; contact_is_active(state, k); k++)
        added[k] = v3_add(state->contacts[state->refined.order[k]].force, creep_load(model, &state->memory, k));
    for (int i = 0; i < state->memory.residual.count; i++)
        for (int c = 0; c < 4; c++) {
            const left_load *left = &state->memory.residual.loads[i];
            vec3 *corner = &nominal[model->mesh->tets[left->tet][c]];
            *corner = v3_axpy(left->weights[c], creep_residual_load(model, left), *corner);
        }
    if (tip->place.phase != TIP_INSIDE || tip->known.tet < 0) return;
    for (int c = 0; c < 4; c++) {
        vec3 *corner = &nominal[model->mesh->tets[tip->known.tet][c]];
        *corner = v3_axpy(tip->known.weights[c], v3_add(tip_load(tip), creep_tip_load(model, &state->memory)), *corner);
    }
}

void insertion_add_residual_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    for (int i = 0; i < state->memory.residual.count && loads->count < MAX_LOADS; i++) {
        const left_load *left = &state->memory.residual.loads[i];
        tissue_load *load = &loads->loads[loads->count++];
        *load = (tissue_load){.tet = left->tet, .force = creep_residual_load(model, left)};
        memcpy(load->weights, left->weights, sizeof load->weights);
    }
}

/* The shaft that the contact in `slot`, or with NO_SLOT the tip, stands for. */
enum { NO_SLOT = -1 };
static shaft_piece piece_of(const insertion_state *state, int slot, shaft_share share) {
    const needle_tip *tip = &state->tip;
    if (slot != NO_SLOT) {
        const shaft_contact *contact = &state->contacts[slot];
        const added_node *node = &state->refined.nodes[slot];
        line_in_tet line = v3_norm(node->line.direction) > 0.0 ? node->line : (line_in_tet){node->tet, node->position, contact->direction};
        return (shaft_piece){share.from, share.to, contact->depth, v3_sub(contact->track, contact->beside), contact->direction, line};
    }
    line_in_tet line = {tip->place.tet, tip->place.nominal, tip->place.direction};
    for (int i = 0; i < state->request.piece_count; i++) /* one for all of its way through an element */
        if (state->request.pieces[i].tet == tip->place.tet) line = state->request.pieces[i];
    return (shaft_piece){share.from, share.to, tip->place.depth, tip->place.nominal, tip->place.direction, line};
}

void insertion_place_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    const needle_tip *tip = &state->tip;
    bool inside = tip->place.phase == TIP_INSIDE && tip->known.tet >= 0;
    double border = 0.0;
    loads->count = 0;
    for (int k = 0; contact_is_active(state, k); k++) {
        int slot = state->refined.order[k];
        const added_node *node = &state->refined.nodes[slot];
        tissue_load *load = &loads->loads[loads->count++];
        *load = (tissue_load){.tet = node->tet, .shaft = piece_of(state, slot, shaft_next_share(state, k, inside, &border))};
        mesh_barycentric(model->mesh, node->tet, node->position, load->weights);
    }
    if (!inside) return;
    tissue_load *load = &loads->loads[loads->count];
    *load = (tissue_load){.tet = tip->known.tet, .shaft = piece_of(state, NO_SLOT, shaft_next_share(state, loads->count, true, &border))};
    memcpy(load->weights, tip->known.weights, sizeof load->weights);
    loads->count++;
}

void insertion_add_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    insertion_place_loads(model, state, loads);
    int contacts = contacts_active(state);
    for (int k = 0; k < contacts; k++)
        loads->loads[k].force = v3_add(state->contacts[state->refined.order[k]].force, creep_load(model, &state->memory, k));
    if (loads->count > contacts) loads->loads[contacts].force = v3_add(tip_load(&state->tip), creep_tip_load(model, &state->memory));
    insertion_add_residual_loads(model, state, loads);
}
