#include "insertion/step/tick.h"

#include <string.h>

#include "insertion/contact/contact_assembly.h"
#include "insertion/contact/tissue_stage.h"
#include "insertion/laws/creep.h"
#include "insertion/step/equilibrium.h"
#include "insertion/step/step.h"
#include "insertion/tip/outside.h"
#include "insertion/tip/prefetch.h"
#include "insertion/tip/tip.h"

static const double LEAST_TICK = 1e-6; /* s: shorter ticks are treated as this long. Rounding tolerance */
static const double SAME_TIME = 1e-6; /* steps: a tick longer than a whole number of steps by less than this gets no extra step. Rounding tolerance */

void insertion_reset(const insertion_model *model, pose base, insertion_state *state) {
    uint64_t insertion = state->request.insertion, serial = state->request.serial, next_id = state->next_id; /* these keep counting, so that no earlier snapshot
                                                                                                                matches */
    creep_forget(&state->memory);
    tissue_memory memory = state->memory; /* keeps the memory's clock running */
    memset(state, 0, sizeof *state);
    state->memory = memory;
    state->request.insertion = insertion + 1;
    state->request.serial = serial;
    state->next_id = next_id;
    state->tip = tip_in_air();
    state->tip.solved.arc = model->needle->given.length;
    state->surface = v3(NAN, NAN, NAN);
    needle_set_straight(model->needle, base, &state->needle);
    tip_engage(model, state);
    prefetch_request(model, state);
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
    profile_end_part(&w->profile, TIMED_WRENCH);
}

void insertion_soften(const tick_input *tick, insertion_state *state, insertion_workspace *w) {
    creep_soften(tick->model, &state->memory);
    if (touches_tissue(state)) soften_shear(tick, state, &w->points);
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

/* Adds everything up: a sum is finite only if all its terms are. */
bool insertion_is_finite(const insertion_state *state, const tick_output *output) {
    const needle_tip *tip = &state->tip;
    double sum = state->base_turn + state->tip_lead + sum_of(output->force) + sum_of(output->torque) + sum_of(tip_position(&tip->place)) + sum_of(state->entry) + tip->place.depth + tip->solved.slip
               + shaft_total(&tip->shaft) + tip->filtered_push + tip->dent.size + tip->dent.offset + sum_of(tip->dent.damping) + tip->solved.end_force
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
