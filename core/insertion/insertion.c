#include "insertion/insertion.h"

#include <string.h>

#include "insertion/equilibrium.h"
#include "insertion/local_compliance.h"
#include "insertion/shaft.h"
#include "insertion/tip.h"
#include "insertion/prefetch.h"

enum { MOST_ELEMENTS = 64 };                /* looked through ahead of the tip */
static const double LOOK_BACK = 5e-3;       /* m behind the tip of a free needle: it may have come free below a dented surface */
static const double RETURN_DISTANCE = 5e-3; /* m from where it stuck, within which a buckled needle takes part again */
static const double SURFACE_GRIP = 0.5;     /* friction coefficient of a tip on the surface */

void insertion_reset(const insertion_model *model, pose base, insertion_state *state) {
    uint64_t serial = state->request.serial, next_id = state->next_id; /* go on counting: an old snapshot must not match */
    double base_compliance = state->base_compliance;
    memset(state, 0, sizeof *state);
    state->request.serial = serial;
    state->next_id = next_id;
    state->base_compliance = base_compliance;
    state->tip = (needle_tip){.phase = TIP_FREE, .tet = -1, .known_tet = -1, .blocked_by = NOT_BLOCKED, .next_contact = NAN};
    needle_rest(model->needle, base, &state->needle);
    tip_engage(model, state);
    prefetch_request(model, state);
}

/* ---- sliding ---------------------------------------------------------------------------------------------------------- */

/* Handles of the last point under the tip that the snapshot covered; false: none. */
static bool tip_handles(const insertion_model *model, const insertion_state *state, const compliance_snapshot *snapshot, int handles[4]) {
    const needle_tip *tip = &state->tip;
    return tip->phase == TIP_INSIDE && tip->known_tet >= 0 && prefetch_covers(snapshot, model->mesh->tets[tip->known_tet], handles);
}

/* Displacement of a handle under the present forces, m. */
static vec3 displacement_of(const insertion_model *model, const insertion_state *state, const compliance_snapshot *snapshot, int handle) {
    vec3 u = v3(0, 0, 0);
    for (int i = 0; i < state->active; i++) {
        mat3 c = compliance_between(snapshot, handle, i);
        u = v3_add(u, m3_apply(&c, state->contacts[i].force));
    }
    int corners[4];
    if (tip_handles(model, state, snapshot, corners)) {
        mat3 c = compliance_to_point(snapshot, corners, state->tip.known_weights, handle);
        u = v3_add(u, m3_apply_transposed(&c, tip_load(&state->tip)));
    }
    return u;
}

/* Where the material point of the tissue at a contact is carried by the shaft, relative to its nominal place, m. */
static vec3 carried(const insertion_model *model, const insertion_state *state, int index) {
    needle_point p = needle_at(model->needle, &state->needle, state->contacts[index].arc);
    return v3_sub(p.position, state->contacts[index].track);
}

/* Displacement of the tissue by which the shaft carries it WINDOW_SPAN behind the tip, m. */
static vec3 displacement_behind(const insertion_model *model, const insertion_state *state, vec3 at_tip) {
    vec3 ahead = at_tip;
    double ahead_depth = state->tip.depth, sought = ahead_depth - WINDOW_SPAN;
    for (int i = state->active - 1; i >= 0; i--) {
        double depth = state->contacts[i].depth;
        if (depth < tip_entry_depth(state)) break; /* of another body */
        vec3 here = carried(model, state, i);
        if (depth <= sought) return v3_axpy((sought - depth) / (ahead_depth - depth), v3_sub(ahead, here), here);
        ahead = here;
        ahead_depth = depth;
    }
    return ahead;
}

/* The same of the point up to WINDOW_SPAN ahead of the tip in the tissue; the tip's own where the snapshot does not cover it. */
static vec3 displacement_ahead(const insertion_model *model, const insertion_state *state, const compliance_snapshot *snapshot,
                               vec3 direction, vec3 at_tip) {
    const mesh *m = model->mesh;
    double left = WINDOW_SPAN, chord;
    vec3 x = state->tip.nominal;
    int tet = state->tip.tet;
    direction = tip_way(&state->tip, direction);
    for (int step = 0; step < MOST_ELEMENTS; step++) {
        int face = mesh_exit(m, tet, x, direction, &chord);
        x = v3_axpy(fmin(left, chord), direction, x);
        left -= chord;
        if (face < 0 || left <= 0.0 || m->neighbours[tet][face] < 0) break;
        tet = m->neighbours[tet][face];
    }
    int handles[4];
    double weights[4];
    tet = refinement_element(m, &state->refined, prefetch_known_contacts(snapshot, &state->refined), tet, x, weights);
    if (!prefetch_covers(snapshot, m->tets[tet], handles)) return at_tip;
    vec3 u = v3(0, 0, 0);
    for (int c = 0; c < 4; c++) u = v3_axpy(weights[c], displacement_of(model, state, snapshot, handles[c]), u);
    return u;
}

/* Derivative of the tissue's displacement along the track at the tip, as a difference over a fixed length: the gradient in
   the tip's element would depend on the element's size. Behind the tip, the shaft tells; ahead, the mesh. */
static vec3 track_gradient(const insertion_model *model, const insertion_state *state, const compliance_snapshot *snapshot) {
    if (state->tip.phase != TIP_INSIDE || state->active == 0) return v3(0, 0, 0);
    needle_point end = needle_at(model->needle, &state->needle, model->needle->given.length - state->tip.slip);
    vec3 at_tip = v3_sub(end.position, tip_place(&state->tip));
    vec3 ahead = displacement_ahead(model, state, snapshot, needle_along(&end), at_tip);
    return v3_scale(0.5 / WINDOW_SPAN, v3_sub(ahead, displacement_behind(model, state, at_tip)));
}

static double slid_on(double slid, double slip, friction_state friction) { return friction == STICK ? 0.0 : slid + fabs(slip); }

/* The shaft moves past its contacts as the last solve said; contacts without a row yet move as their neighbour does. */
static void slide_shaft(insertion_state *state) {
    for (int i = 0; i < state->active; i++) {
        shaft_contact *contact = &state->contacts[i];
        contact->arc = fmax(contact->arc - contact->slip, 0.0); /* a needle pushed in to its base drags what has come there */
        contact->slid = slid_on(contact->slid, contact->slip, contact->friction);
    }
    double neighbour = state->tip.phase == TIP_INSIDE ? state->tip.slip : state->active > 0 ? state->contacts[state->active - 1].slip : 0.0;
    for (int i = state->active; i < contacts_passed(state); i++) state->contacts[i].arc -= neighbour;
    state->tip.shaft_slid = slid_on(state->tip.shaft_slid, state->tip.shaft_slip, state->tip.shaft_friction);
}

/* ---- contacts ----------------------------------------------------------------------------------------------------------- */

/* A contact whose row has arrived: its material point on the shaft is where friction is at its limit, as it was for the
   tip that left it there. */
static void activate_contact(const insertion_model *model, insertion_state *state, const compliance_snapshot *snapshot, int index, double dt) {
    shaft_contact *contact = &state->contacts[index];
    const added_node *node = &state->refined.nodes[index];
    lateral_axial logarithm = local_logarithm(model, node->tet, node->position);
    contact->log_lateral = logarithm.lateral;
    contact->log_axial = logarithm.axial;
    contact->surplus = local_surplus(model, node->tet, node->position);
    double ahead = shaft_ahead(model, state, index, dt) + contact->slip; /* it slides on in this tick, as the tip did */
    vec3 tissue = v3_add(contact->track, displacement_of(model, state, snapshot, index));
    needle_point p = needle_at(model->needle, &state->needle, contact->arc);
    contact->arc += ahead - v3_dot(needle_along(&p), v3_sub(p.position, tissue));
    contact->arc = fmin(fmax(contact->arc, 0.0), model->needle->given.length);
}

static void accept_snapshot(const insertion_model *model, insertion_state *state, const compliance_snapshot *snapshot, double dt,
                            insertion_wrench *wrench) {
    int known = prefetch_known_contacts(snapshot, &state->refined), passed = contacts_passed(state);
    while (state->active < known && state->active < passed) {
        int index = state->active++;
        state->contacts[index].force = v3(0, 0, 0);
        activate_contact(model, state, snapshot, index, dt);
        wrench->events |= EVENT_ADDED;
    }
}

/* Handles of the corners around the tip; where the worker is late, around the last point that the snapshot covered. False:
   none at all. The tip's force acts on the nominal mesh by interpolation: a node of its own would be stiffer the nearer it
   came to a face, and what it adds is below what the mesh resolves. */
static bool follow_known_point(const insertion_model *model, insertion_state *state, const compliance_snapshot *snapshot, int handles[4],
                               insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    if (tip->phase != TIP_INSIDE) return false;
    double weights[4];
    int tet = refinement_element(model->mesh, &state->refined, prefetch_known_contacts(snapshot, &state->refined), tip->tet, tip->nominal, weights);
    bool covered = prefetch_covers(snapshot, model->mesh->tets[tet], handles);
    if (!covered && tet != tip->tet) { /* the window follows the nominal mesh */
        tet = tip->tet;
        mesh_barycentric(model->mesh, tet, tip->nominal, weights);
        covered = prefetch_covers(snapshot, model->mesh->tets[tet], handles);
    }
    if (!covered) {
        wrench->events |= EVENT_LATE;
        return tip_handles(model, state, snapshot, handles);
    }
    tip->known_tet = tet;
    memcpy(tip->known_weights, weights, sizeof weights);
    return true;
}

/* ---- the tick ----------------------------------------------------------------------------------------------------------- */

/* On the surface, before it is in, the tip sticks by Coulomb friction: the force on the skin stays within a cone about the
   surface's normal. Outside the cone the tip slides along the surface, half of the way that would bring the force back: whole,
   it could overshoot and lift a needle off that hardly presses. */
static void glide_on_surface(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    const needle_tip *tip = &state->tip;
    vec3 inward = mesh_face_normal(model->mesh, tip->tet, tip->face);
    double pressing = v3_dot(tip->force, inward);
    vec3 tangential = v3_axpy(-pressing, inward, tip->force);
    double excess = v3_norm(tangential) - SURFACE_GRIP * fmax(pressing, 0.0);
    if (excess <= 0.0) return;
    double compliance = 0.5 * local_at(model, tip->tet, tip->nominal).lateral / model->needle->radius;
    tip_glide(model, state, inward, v3_scale(excess * compliance / v3_norm(tangential), tangential), wrench);
}

/* Needle in the air: straight. Touching the outer surface starts an insertion; drawn out of a dent, it touches nothing.
   One whose end has slid over an edge is past the tissue, though its axis still cuts the corner. */
static void move_freely(const insertion_model *model, insertion_state *state, pose base, insertion_wrench *wrench) {
    int n = model->needle->given.segments;
    vec3 before = state->needle.joints[n];
    needle_rest(model->needle, base, &state->needle);
    vec3 axis = q_axis(base.orientation), now = state->needle.joints[n];
    vec3 behind = v3_axpy(-LOOK_BACK, axis, before);
    bool advancing = v3_dot(v3_sub(now, before), axis) > 0.0;
    tip_touch(model, state, advancing && tip_is_below(model, behind, before) ? behind : before, now, wrench);
}

/* A buckled needle counts as straight and without force until the hand has drawn its end back to where that was stuck. */
static void wait_for_return(const insertion_model *model, insertion_state *state, pose base, insertion_wrench *wrench) {
    equilibrium_release(state);
    needle_rest(model->needle, base, &state->needle);
    vec3 off = v3_sub(state->needle.joints[model->needle->given.segments], state->stuck_at);
    state->buckled = v3_norm(off) > RETURN_DISTANCE || v3_dot(off, q_axis(base.orientation)) > 0.0;
    if (state->buckled) wrench->events |= EVENT_UNSTABLE;
}

static void sum_wrench(const insertion_state *state, const insertion_workspace *w, insertion_wrench *wrench) {
    wrench->force = wrench->torque = v3(0, 0, 0);
    for (int i = 0; i < state->active + w->tip; i++) {
        vec3 on_needle = v3_scale(-1.0, i < state->active ? state->contacts[i].force : state->tip.force);
        vec3 lever = v3_sub(w->points[i].position, state->needle.base.position);
        wrench->force = v3_add(wrench->force, on_needle);
        wrench->torque = v3_add(wrench->torque, v3_cross(lever, on_needle));
    }
    wrench->depth = state->tip.phase == TIP_FREE ? 0.0 : state->tip.depth;
    wrench->contacts = state->active;
}

/* The tip goes on in the tissue and the shaft next to it slides, each as the last solve said: not always equally far. */
static void move_tip(const insertion_model *model, insertion_state *state, vec3 gradient, double dt, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    double before = tip->depth, slid = tip->shaft_slip;
    bool beyond = tip->phase == TIP_BEYOND;
    tip_move(model, state, gradient, wrench);
    if (tip->phase != TIP_INSIDE) return;
    tip->stretch += tip->depth - before - slid;
    int last = contacts_passed(state) - 1;
    bool next_body = tip->entering && tip->depth == tip_entry_depth(state);
    if (beyond) tip->stretch = last < 0 || next_body ? 0.0 : shaft_ahead(model, state, last, dt);
}

static void step(const insertion_model *model, insertion_state *state, insertion_workspace *scratch,
                 const compliance_snapshot *snapshot, pose base, double dt, insertion_wrench *wrench) {
    if (state->buckled) {
        wait_for_return(model, state, base, wrench);
        wrench->depth = state->tip.depth;
        wrench->contacts = state->active;
        if (state->buckled) return;
    } else if (state->tip.phase == TIP_FREE) {
        move_freely(model, state, base, wrench);
    } else {
        slide_shaft(state);
        vec3 gradient = track_gradient(model, state, snapshot);
        pose shifted = {v3_add(base.position, state->base_shift), base.orientation};
        needle_hold(model->needle, shifted, &state->needle);
        move_tip(model, state, gradient, dt, wrench);
        if (state->tip.phase == TIP_INSIDE && state->tip.depth == 0.0) glide_on_surface(model, state, wrench);
    }
    accept_snapshot(model, state, snapshot, dt, wrench);
    int handles[4];
    scratch->tip = follow_known_point(model, state, snapshot, handles, wrench);
    if (state->active + scratch->tip > 0) equilibrium_find(model, state, scratch, snapshot, handles, dt, wrench);
    else state->base_shift = v3(0, 0, 0);
    tip_puncture(model, state, wrench);
    sum_wrench(state, scratch, wrench);
}

void insertion_tick(const insertion_model *model, insertion_state *state, insertion_workspace *scratch,
                    const compliance_snapshot *snapshot, pose base, double dt, insertion_wrench *wrench) {
    *wrench = (insertion_wrench){.membrane = -1};
    profile_begin(&scratch->profile);
    pose held = state->needle.base;
    held.position = v3_sub(held.position, state->base_shift);
    dt = fmax(dt, 1e-6);
    int steps = (int)fmin(ceil(dt / model->settings.longest_step - 1e-6), model->settings.most_steps);
    for (int i = 1; i < steps; i++) step(model, state, scratch, snapshot, pose_between(held, base, (double)i / steps), dt / steps, wrench);
    step(model, state, scratch, snapshot, base, steps > 1 ? dt / steps : dt, wrench);
    prefetch_request(model, state);
    profile_end_stage(&scratch->profile, INSERTION_WRENCH);
}

/* ---- what is not finite ------------------------------------------------------------------------------------------- */

static double sum_of(vec3 v) { return v.x + v.y + v.z; }

/* A sum is finite only if all its terms are. */
bool insertion_is_finite(const insertion_state *state, const insertion_wrench *wrench) {
    const needle_tip *tip = &state->tip;
    double sum = sum_of(wrench->force) + sum_of(wrench->torque) + sum_of(tip_place(tip)) + sum_of(state->entry) + tip->depth + tip->slip
               + tip->shaft_slip + tip->shaft_slid + tip->stretch + tip->pressing + tip->dent + sum_of(tip->damping) + tip->shaft_softness
               + tip->shaft_traction;
    for (int i = 0; i < state->refined.count; i++) {
        const shaft_contact *c = &state->contacts[i];
        sum += sum_of(state->refined.nodes[i].position) + c->arc + c->depth + c->slip + c->slid + c->log_lateral + c->log_axial + c->surplus
             + c->softness + c->traction;
    }
    return isfinite(sum);
}

void insertion_start_over(const insertion_model *model, pose base, insertion_state *state, insertion_wrench *wrench) {
    insertion_reset(model, base, state);
    *wrench = (insertion_wrench){.depth = state->tip.depth, .membrane = -1, .events = EVENT_UNSTABLE};
}

/* ---- export ------------------------------------------------------------------------------------------------------------- */

void insertion_refinement(const insertion_state *state, refinement *out) {
    out->count = state->active;
    memcpy(out->nodes, state->refined.nodes, (size_t)state->active * sizeof *out->nodes);
}

void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added) {
    const needle_tip *tip = &state->tip;
    for (int i = 0; i < state->active; i++) added[i] = state->contacts[i].force;
    if (tip->phase != TIP_INSIDE || tip->known_tet < 0) return;
    for (int c = 0; c < 4; c++) {
        vec3 *corner = &nominal[model->mesh->tets[tip->known_tet][c]];
        *corner = v3_axpy(tip->known_weights[c], tip_load(tip), *corner);
    }
}
