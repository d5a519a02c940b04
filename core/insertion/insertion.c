#include "insertion/insertion.h"

#include <string.h>

#include "insertion/creep.h"
#include "insertion/equilibrium.h"
#include "insertion/guides.h"
#include "insertion/known_tissue.h"
#include "insertion/old_tracks.h"
#include "insertion/outside.h"
#include "insertion/prefetch.h"
#include "insertion/roll.h"
#include "insertion/strata.h"
#include "insertion/tip.h"
#include "insertion/track_gradient.h"

static const double LOOK_BACK = 5e-3;       /* m behind the tip of a free needle, which may have been freed below a dented surface */
static const double RETURN_DISTANCE = 5e-3; /* m from where it stuck, within which a buckled needle is solved for again */

void insertion_reset(const insertion_model *model, pose base, insertion_state *state) {
    uint64_t serial = state->request.serial, next_id = state->next_id; /* kept, so that no old snapshot matches */
    creep_forget(&state->memory);
    tissue_memory memory = state->memory; /* its clock goes on */
    memset(state, 0, sizeof *state);
    state->memory = memory;
    state->request.serial = serial;
    state->next_id = next_id;
    state->tip = (needle_tip){.phase = TIP_FREE, .tet = -1, .known_tet = -1, .blocked_by = NOT_BLOCKED, .next_contact = NAN};
    needle_rest(model->needle, base, &state->needle);
    tip_engage(model, state);
    prefetch_request(model, state);
}

/* ---- move: the base, and the shaft past its contacts --------------------------------------------------------------- */

static double slid_on(double slid, double slip, friction_state friction, const roll_friction *roll, double radius) {
    return friction == STICK && roll->friction == STICK ? 0.0 : slid + roll_way(slip, roll, radius);
}

/* The shaft slides past its contacts by the slip of the last solve; contacts without a row yet by their neighbour's. */
static void slide_shaft(insertion_state *state, double radius) {
    int k = 0;
    double neighbour = 0.0;
    for (; contact_is_active(state, k); k++) {
        shaft_contact *contact = &state->contacts[state->refined.order[k]];
        neighbour = contact->slip;
        contact->arc = larger_of(contact->arc - contact->slip, 0.0); /* a needle pushed in up to its base drags the contacts that have reached it */
        contact->slid = slid_on(contact->slid, contact->slip, contact->friction, &contact->roll, radius);
    }
    if (state->tip.phase == TIP_INSIDE) neighbour = state->tip.slip;
    for (; k < contacts_passed(state); k++) state->contacts[state->refined.order[k]].arc -= neighbour;
    state->tip.shaft_slid = slid_on(state->tip.shaft_slid, state->tip.shaft_slip, state->tip.shaft_friction, &state->tip.roll, radius);
}

/* Moves the base; the spring that holds it stays as it has yielded. */
static void hold_base(const tick_context *tick) {
    pose base = tick->base.pose;
    base.position = v3_add(base.position, tick->state->base_shift);
    roll_turn_base(tick->state, base.orientation);
    needle_hold(tick->model->needle, base, &tick->state->needle);
}

static vec3 needle_end(const tick_context *tick) { return tick->state->needle.joints[tick->model->needle->given.segments]; }

/* How far the hand has carried the needle's end forward, from where it was `before`. */
static void note_carried(const tick_context *tick, vec3 before) {
    const vec3 *joints = tick->state->needle.joints;
    int end = tick->model->needle->given.segments;
    vec3 along = v3_unit(v3_sub(joints[end], joints[end - 1]));
    tick->scratch->tip_carried = fmax(0.0, v3_dot(along, v3_sub(joints[end], before)));
}

/* Displacement of the surface ahead of a free needle's end, or just behind it, by whatever else deforms the tissue. */
static vec3 free_at_surface(const tick_context *tick, vec3 end, vec3 axis) {
    const mesh *m = tick->model->mesh;
    int handles[4];
    double weights[4];
    if (!tick->snapshot->loaded) return v3(0, 0, 0);
    surface_hit hit = mesh_enter(m, v3_axpy(-DENT_DEPTH, axis, end), v3_axpy(DENT_DEPTH, axis, end));
    if (!hit.hit || !snapshot_covers(tick->snapshot, m->tets[hit.tet], handles)) return v3(0, 0, 0);
    mesh_barycentric(m, hit.tet, hit.point, weights);
    return creep_free_at(tick, handles, weights);
}

/* A needle in the air is straight, unless a guide bends it. Touching the outer surface starts an insertion; a needle drawn out of a dent touches nothing.
   A needle whose end has slid over an edge is past the tissue, although its axis still cuts the corner. */
static void move_freely(const tick_context *tick) {
    const insertion_model *model = tick->model;
    insertion_state *state = tick->state;
    int n = model->needle->given.segments;
    vec3 before = needle_end(tick);
    if (guides_hold(model, state)) hold_base(tick);
    else needle_rest(model->needle, tick->base.pose, &state->needle);
    vec3 axis = q_axis(tick->base.pose.orientation), now = state->needle.joints[n];
    note_carried(tick, before);
    vec3 surface = free_at_surface(tick, now, axis); /* the mesh is the tissue at rest */
    before = v3_sub(before, surface);
    now = v3_sub(now, surface);
    vec3 behind = v3_axpy(-LOOK_BACK, axis, before);
    bool advancing = v3_dot(v3_sub(now, before), axis) > 0.0;
    tip_touch(tick, advancing && tip_is_below(model, behind, before) ? behind : before, now);
}

/* A buckled needle is taken to be straight and free of force until the hand has drawn its end back to where it was stuck. */
static bool has_returned(const tick_context *tick) {
    insertion_state *state = tick->state;
    equilibrium_release(state);
    needle_rest(tick->model->needle, tick->base.pose, &state->needle);
    vec3 off = v3_sub(state->needle.joints[tick->model->needle->given.segments], state->stuck_at);
    state->buckled = v3_norm(off) > RETURN_DISTANCE || v3_dot(off, q_axis(tick->base.pose.orientation)) > 0.0;
    if (state->buckled) tick->output->events |= EVENT_UNSTABLE;
    return !state->buckled;
}

/* Slides the shaft by the slip of the last solve and moves the base. Returns the tissue's deformation around the tip before that. */
static vec3 move(const tick_context *tick) {
    insertion_state *state = tick->state;
    slide_shaft(state, tick->model->needle->radius);
    vec3 gradient = track_gradient(tick), before = needle_end(tick);
    hold_base(tick);
    note_carried(tick, before);
    return gradient;
}

/* ---- cross, solve, answer ------------------------------------------------------------------------------------------ */

/* The tip advances in the tissue and the shaft next to it slides, each by its slip in the last solve: these may differ. */
static void cross(const tick_context *tick, vec3 gradient) {
    insertion_state *state = tick->state;
    needle_tip *tip = &state->tip;
    double before = tip->depth, slid = tip->shaft_slip;
    bool beyond = tip->phase == TIP_BEYOND;
    if (!isfinite(tip->slip)) tip->stretch = NAN; /* the insertion starts over (insertion_is_finite), so that the tip does not leave a track right through the tissue */
    tip_move(tick, gradient);
    if (tip->phase != TIP_INSIDE) return;
    tip->stretch += tip->depth - before - slid;
    int passed = contacts_passed(state);
    bool next_body = tip->entering && tip->depth == tip_entry_depth(state);
    if (beyond) tip->stretch = passed == 0 || next_body ? 0.0 : creep_shaft_ahead(tick, passed - 1);
    if (tip->depth == 0.0) tip_glide_on_surface(tick);
}

/* No tissue is touched. */
static void lose_contact(const tick_context *tick) {
    tick->state->tip_lead = 0.0;
    creep_leave_all(tick->model, &tick->state->memory, tick->scratch->creep.decay);
}

/* Brings needle and tissue into equilibrium, with the newest snapshot. */
static void solve(const tick_context *tick) {
    int handles[4];
    accept_snapshot(tick);
    tick->scratch->tip = follow_known_point(tick, handles) && follow_resolution(tick);
    tick->scratch->point_count = 0;
    bool in_tissue = tick->scratch->tip || contact_is_active(tick->state, 0);
    guides_follow(tick);
    if (!in_tissue) lose_contact(tick);
    if (in_tissue || guides_hold(tick->model, tick->state)) equilibrium_find(tick, handles);
    else tick->state->base_shift = v3(0, 0, 0), tick->state->motion.time = 0.0;
}

/* Sums the forces of all points into the wrench on the base. */
static void answer(const tick_context *tick) {
    insertion_state *state = tick->state;
    tick_output *output = tick->output;
    output->force = output->torque = v3(0, 0, 0);
    for (int i = 0; i < tick->scratch->point_count; i++) {
        const contact_point *point = &tick->scratch->points[i];
        vec3 on_needle = v3_scale(-1.0, *point_force(state, point));
        vec3 lever = v3_sub(point->at.position, state->needle.base.position);
        output->force = v3_add(output->force, on_needle);
        output->torque = v3_add(output->torque, v3_cross(lever, on_needle));
    }
    double torque = roll_torque(tick);
    if (torque != 0.0) output->torque = v3_axpy(-torque, q_axis(state->needle.base.orientation), output->torque);
    output->depth = state->tip.phase == TIP_FREE ? 0.0 : state->tip.depth;
    output->contacts = contacts_active(state);
}

/* ---- the tick ------------------------------------------------------------------------------------------------------ */

static void step(const tick_context *tick) {
    insertion_state *state = tick->state;
    vec3 gradient = v3(0, 0, 0);
    tick->scratch->tip_carried = INFINITY;
    creep_begin(tick);
    guides_slide(tick->model, state);
    if (state->buckled) {
        state->motion.time = 0.0;
        bool returned = has_returned(tick);
        tick->output->depth = state->tip.depth;
        tick->output->contacts = contacts_active(state);
        if (!returned) {
            creep_fade(tick);
            return;
        }
    } else if (state->tip.phase == TIP_FREE) {
        move_freely(tick);
    } else {
        gradient = move(tick);
        cross(tick, gradient);
    }
    tick->scratch->aim = tip_aim(tick, gradient);
    old_tracks_find(tick);
    solve(tick);
    tip_puncture(tick);
    answer(tick);
}

void insertion_tick(const tick_context *given) {
    insertion_state *state = given->state;
    *given->output = (tick_output){.membrane = -1};
    profile_begin(&given->scratch->profile);
    pose held = state->needle.base;
    held.position = v3_sub(held.position, state->base_shift);
    double dt = fmax(given->dt, 1e-6);
    const insertion_settings *settings = &given->model->settings;
    int steps = (int)fmin(ceil(dt / settings->longest_step - 1e-6), settings->most_steps);
    tick_context tick = *given;
    tick.dt = steps > 1 ? dt / steps : dt;
    for (int i = 1; i < steps; i++) {
        tick.base.pose = pose_between(held, given->base.pose, (double)i / steps);
        step(&tick);
    }
    tick.base.pose = given->base.pose;
    step(&tick);
    outside_watch(&tick);
    prefetch_request(given->model, state);
    profile_end_stage(&given->scratch->profile, INSERTION_WRENCH);
}

bool insertion_linearise(const tick_context *tick, bool loaded) {
    int handles[4];
    insertion_workspace *w = tick->scratch;
    if (tick->state->buckled || tick->state->tip.phase == TIP_FREE) return false;
    creep_begin(tick);
    w->point_count = 0;
    w->tip = follow_known_point(tick, handles) && follow_resolution(tick);
    if (!w->tip && !contact_is_active(tick->state, 0)) return false;
    equilibrium_linearise(tick, handles, loaded);
    return true;
}

/* ---- what is not finite -------------------------------------------------------------------------------------------- */

static double sum_of(vec3 v) { return v.x + v.y + v.z; }

/* A sum is finite only if all its terms are. */
bool insertion_is_finite(const insertion_state *state, const tick_output *output) {
    const needle_tip *tip = &state->tip;
    double sum = state->base_turn + state->tip_lead + tip->roll.turned + tip->roll.torque + sum_of(output->force) + sum_of(output->torque) + sum_of(tip_place(tip)) + sum_of(state->entry) + tip->depth + tip->slip
               + tip->shaft_slip + tip->shaft_slid + tip->stretch + tip->pressing + tip->dent + sum_of(tip->damping) + tip->shaft_softness + tip->shaft_stiffening + tip->end_force
               + tip->shaft_traction + tip->resolved.lateral + tip->resolved.axial + tip->resolved.point + line_end_total(&tip->resolved.end);
    for (int k = 0; k < state->refined.count; k++) {
        int slot = state->refined.order[k];
        const shaft_contact *c = &state->contacts[slot];
        sum += sum_of(state->refined.nodes[slot].position) + c->arc + c->depth + c->slip + c->slid + plane_total(c->log_lateral) + c->log_axial + line_end_total(&c->end)
             + c->softness + c->stiffening + c->traction + c->roll.turned + c->roll.torque;
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
    *output = (tick_output){.depth = state->tip.depth, .membrane = -1, .events = EVENT_UNSTABLE};
}

/* ---- export -------------------------------------------------------------------------------------------------------- */

void insertion_refinement(const insertion_state *state, refinement *out) {
    refinement_compact(&state->refined, contacts_active(state), out);
}

void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added) {
    const needle_tip *tip = &state->tip;
    for (int k = 0; contact_is_active(state, k); k++)
        added[k] = v3_add(state->contacts[state->refined.order[k]].force, creep_load(model, &state->memory, k));
    for (int i = 0; i < state->memory.left.count; i++)
        for (int c = 0; c < 4; c++) {
            const left_load *left = &state->memory.left.loads[i];
            vec3 *corner = &nominal[model->mesh->tets[left->tet][c]];
            *corner = v3_axpy(left->weights[c], creep_left_load(model, left), *corner);
        }
    if (tip->phase != TIP_INSIDE || tip->known_tet < 0) return;
    for (int c = 0; c < 4; c++) {
        vec3 *corner = &nominal[model->mesh->tets[tip->known_tet][c]];
        *corner = v3_axpy(tip->known_weights[c], v3_add(tip_load(tip), creep_tip_load(model, &state->memory)), *corner);
    }
}

void insertion_add_left_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    for (int i = 0; i < state->memory.left.count && loads->count < MAX_LOADS; i++) {
        const left_load *left = &state->memory.left.loads[i];
        tissue_load *load = &loads->loads[loads->count++];
        *load = (tissue_load){.tet = left->tet, .force = creep_left_load(model, left)};
        memcpy(load->weights, left->weights, sizeof load->weights);
    }
}

void insertion_add_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    const needle_tip *tip = &state->tip;
    for (int k = 0; contact_is_active(state, k) && loads->count < MAX_LOADS; k++) {
        int slot = state->refined.order[k];
        const added_node *node = &state->refined.nodes[slot];
        tissue_load *load = &loads->loads[loads->count++];
        *load = (tissue_load){.tet = node->tet, .force = v3_add(state->contacts[slot].force, creep_load(model, &state->memory, k))};
        mesh_barycentric(model->mesh, node->tet, node->position, load->weights);
    }
    insertion_add_left_loads(model, state, loads);
    if (tip->phase != TIP_INSIDE || tip->known_tet < 0 || loads->count == MAX_LOADS) return;
    tissue_load *load = &loads->loads[loads->count++];
    *load = (tissue_load){.tet = tip->known_tet, .force = v3_add(tip_load(tip), creep_tip_load(model, &state->memory))};
    memcpy(load->weights, tip->known_weights, sizeof load->weights);
}
