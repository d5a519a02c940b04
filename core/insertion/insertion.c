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

static const double SAME_PLACE = 1e-7; /* m: to which the displacement of the surface is found. Rounding */
enum { MOST_LOOKS = 5 }; /* looks: for the displaced surface, at most. Effort */
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
    state->tip = (needle_tip){.phase = TIP_FREE, .tet = -1, .known_tet = -1, .blocked_by = NOT_BLOCKED, .arc = model->needle->given.length, .next_contact = NAN};
    state->surface = v3(NAN, NAN, NAN);
    needle_rest(model->needle, base, &state->needle);
    tip_engage(model, state);
    prefetch_request(model, state);
}

/* ---- move: the base, and the shaft past its contacts --------------------------------------------------------------- */

static double slid_on(double slid, double slip, friction_state friction, const roll_friction *roll, double radius) {
    return friction == STICK && roll->friction == STICK ? 0.0 : slid + roll_way(slip, roll, radius);
}

static void slide(shaft_hold *shaft, double radius) {
    shaft->origin -= shaft->slip;
    shaft->slid = slid_on(shaft->slid, shaft->slip, shaft->friction, &shaft->roll, radius);
}

/* The shaft slides past its contacts by the slip of the last solve; contacts without a row yet as the shaft next to them. */
static void slide_shaft(insertion_state *state, double radius) {
    double slip = 0.0;
    for (int k = 0; contact_is_active(state, k); k++) {
        shaft_contact *contact = &state->contacts[state->refined.order[k]];
        slide(&contact->shaft, radius);
        contact->shaft.origin = larger_of(contact->shaft.origin, -contact->depth); /* a needle pushed in up to its base drags the contacts that have reached it */
        slip = contact->shaft.slip;
    }
    bool inside = state->tip.phase == TIP_INSIDE;
    if (inside) slip = state->tip.shaft.slip;
    if (inside) state->tip.shaft.slid = slid_on(state->tip.shaft.slid, slip, state->tip.shaft.friction, &state->tip.shaft.roll, radius);
    shift_tip_shaft(state, -slip); /* of a tip that is out of the tissue, it means nothing */
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

/* Displacement, by whatever else deforms the tissue and by what it remembers, of the surface ahead of a free needle's end or just behind it. The mesh is the tissue at rest: the
   axis meets the displaced surface where its line, moved back by the displacement there, meets the mesh. What is not known yet is what it was. */
static vec3 surface_displacement(const tick_context *tick, vec3 end, vec3 axis) {
    const mesh *m = tick->model->mesh;
    vec3 u = isnan(tick->state->surface.x) ? v3(0, 0, 0) : tick->state->surface, before;
    int handles[4];
    double weights[4];
    if (creep_free_is_zero(tick)) return v3(0, 0, 0);
    for (int i = 0; i < MOST_LOOKS; i++) {
        vec3 middle = v3_sub(end, u);
        surface_hit hit = mesh_enter(m, v3_axpy(-DENT_DEPTH, axis, middle), v3_axpy(DENT_DEPTH, axis, middle));
        if (!hit.hit) return v3(0, 0, 0);
        if (!snapshot_covers(tick->snapshot, m->tets[hit.tet], handles)) break;
        mesh_barycentric(m, hit.tet, hit.point, weights);
        before = u;
        u = v3_add(creep_free_at(tick, handles, weights), unresolved_at_entry(&tick->snapshot->unresolved));
        if (v3_norm(v3_sub(u, before)) < SAME_PLACE) break;
    }
    return u;
}

/* Touches the surface that lies above a tip in the tissue, `now` (m, nominal): others have moved the tissue over it, or it has just come to be known that
   they had. It is looked for from a diameter behind the tip on, then from twice as far, and so on up to two lengths of the needle. */
static void touch_above(const tick_context *tick, vec3 now, vec3 axis) {
    const insertion_model *model = tick->model;
    for (double back = model->needle->given.outer_diameter; back < 2.0 * model->needle->given.length; back *= 2.0) {
        vec3 behind = v3_axpy(-back, axis, now);
        if (tip_is_below(model, behind, now)) {
            tip_touch(tick, behind, now);
            return;
        }
    }
}

/* A needle in the air is straight, unless a guide bends it. Touching the outer surface starts an insertion; a needle that the hand draws out of a dent
   touches nothing.
   A needle whose end has slid over an edge is past the tissue, although its axis still cuts the corner. */
static void move_freely(const tick_context *tick) {
    const insertion_model *model = tick->model;
    insertion_state *state = tick->state;
    vec3 start = needle_end(tick), straight = needle_straight_end(model->needle, state->needle.base), known = state->surface;
    if (guides_hold(model, state)) hold_base(tick);
    else needle_rest(model->needle, tick->base.pose, &state->needle);
    note_carried(tick, start);
    vec3 axis = q_axis(tick->base.pose.orientation), end = needle_end(tick), advance = v3_sub(needle_straight_end(model->needle, tick->base.pose), straight);
    state->surface = surface_displacement(tick, end, axis);
    if (isnan(known.x)) known = state->surface;
    vec3 now = v3_sub(end, state->surface), rise = v3_sub(state->surface, known);
    if (!tip_touch(tick, v3_sub(start, known), now) && v3_dot(v3_sub(advance, rise), axis) > 0.0) touch_above(tick, now, axis);
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

/* The tip advances in the tissue by its slip in the last solve. */
static void cross(const tick_context *tick, vec3 gradient) {
    insertion_state *state = tick->state;
    needle_tip *tip = &state->tip;
    if (!isfinite(tip->slip)) tip->shaft.origin = NAN; /* the insertion starts over (insertion_is_finite), so that the tip does not leave a track right through the tissue */
    tip->offset *= exp(-fabs(tip->slip) / (2.0 * tick->model->needle->radius));
    tip_move(tick, tip_aim(tick, gradient));
    if (tip->phase == TIP_INSIDE && tip->depth == 0.0) tip_glide_on_surface(tick);
}

/* No tissue is touched. */
static void lose_contact(const tick_context *tick) {
    tick->state->tip_lead = 0.0;
    creep_leave_all(tick->model, &tick->state->memory, tick->scratch->creep.decay);
}

/* What is known of the tissue at the tip, if that is in it. */
static void find_tip(const tick_context *tick, int handles[4]) {
    tick->scratch->tip = tick->state->tip.phase == TIP_INSIDE;
    if (!tick->scratch->tip) return;
    follow_known_point(tick, handles);
    follow_resolution(tick);
}

/* Brings needle and tissue into equilibrium, with the newest snapshot. */
static void solve(const tick_context *tick) {
    int handles[4];
    accept_snapshot(tick);
    find_tip(tick, handles);
    tick->scratch->point_count = 0;
    bool in_tissue = tick->scratch->tip || contact_is_active(tick->state, 0);
    guides_follow(tick);
    if (!in_tissue) lose_contact(tick);
    if (in_tissue || guides_hold(tick->model, tick->state)) equilibrium_find(tick, handles);
    else equilibrium_forget(tick->state);
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

static void find_what_is_open(const tick_context *tick) {
    needle_tip *tip = &tick->state->tip;
    tip->torn = tip->phase == TIP_INSIDE ? old_tracks_torn(tick, tip->blocked_by, tip->nominal) : 0.0;
    tip->follows = old_tracks_ahead(tick, 0.0);
}

static void step(const tick_context *tick) {
    insertion_state *state = tick->state;
    vec3 gradient = v3(0, 0, 0);
    tick->scratch->tip_carried = INFINITY;
    creep_begin(tick);
    guides_slide(tick->model, state);
    if (state->tip.phase == TIP_FREE) {
        move_freely(tick);
    } else {
        gradient = move(tick);
        cross(tick, gradient);
    }
    tick->scratch->aim = tip_aim(tick, gradient);
    find_what_is_open(tick);
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
    double dt = fmax(given->dt, LEAST_TICK);
    const insertion_settings *settings = &given->model->settings;
    int steps = (int)fmin(ceil(dt / settings->longest_step - SAME_TIME), settings->most_steps);
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
    if (tick->state->tip.phase == TIP_FREE) return false;
    creep_begin(tick);
    w->point_count = 0;
    find_tip(tick, handles);
    if (!w->tip && !contact_is_active(tick->state, 0)) return false;
    equilibrium_linearise(tick, handles, loaded);
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
    double sum = state->base_turn + state->tip_lead + sum_of(output->force) + sum_of(output->torque) + sum_of(tip_place(tip)) + sum_of(state->entry) + tip->depth + tip->slip
               + shaft_total(&tip->shaft) + tip->pressing + tip->dent + tip->held_dent + tip->offset + sum_of(tip->damping) + tip->end_force
               + tip->resolved.lateral + tip->resolved.axial + tip->resolved.point + line_end_total(&tip->resolved.end);
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
    line_in_tet line = {tip->tet, tip->nominal, tip->direction};
    for (int i = 0; i < state->request.piece_count; i++) /* one for all of its way through an element */
        if (state->request.pieces[i].tet == tip->tet) line = state->request.pieces[i];
    return (shaft_piece){share.from, share.to, tip->depth, tip->nominal, tip->direction, line};
}

void insertion_place_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    const needle_tip *tip = &state->tip;
    bool inside = tip->phase == TIP_INSIDE && tip->known_tet >= 0;
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
    *load = (tissue_load){.tet = tip->known_tet, .shaft = piece_of(state, NO_SLOT, shaft_next_share(state, loads->count, true, &border))};
    memcpy(load->weights, tip->known_weights, sizeof load->weights);
    loads->count++;
}

void insertion_add_loads(const insertion_model *model, const insertion_state *state, tissue_loads *loads) {
    insertion_place_loads(model, state, loads);
    int contacts = contacts_active(state);
    for (int k = 0; k < contacts; k++)
        loads->loads[k].force = v3_add(state->contacts[state->refined.order[k]].force, creep_load(model, &state->memory, k));
    if (loads->count > contacts) loads->loads[contacts].force = v3_add(tip_load(&state->tip), creep_tip_load(model, &state->memory));
    insertion_add_left_loads(model, state, loads);
}
