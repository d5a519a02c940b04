#include "insertion/tip_path.h"

#include "insertion/contact_nodes.h"
#include "insertion/obstacle.h"
#include "insertion/old_tracks.h"
#include "insertion/strata.h"

static const double GRAZING = 0.2; /* 1: sine of the angle to an outer face, below which the tip goes along the face. Chosen: 11 degrees */
static const double GRAZING_DEPTH = 1e-5; /* m: how far inside that face `nominal` is then. Rounding */
static const double SAME_FORCE = 1e-6; /* fraction: by which a resistance may be above the force that the tip cuts with, and is overcome. Rounding */

int follow_line(const mesh *m, int tet, vec3 *from, vec3 target) {
    for (int step = 0; step < MAX_STEPS; step++) {
        vec3 rest = v3_sub(target, *from);
        double fraction;
        int face = mesh_exit(m, tet, *from, rest, &fraction);
        if (face < 0 || fraction >= 1.0 || m->neighbours[tet][face] < 0) break;
        *from = v3_axpy(fraction, rest, *from);
        tet = m->neighbours[tet][face];
    }
    *from = target;
    return tet;
}

bool reaches(const mesh *m, surface_hit hit, vec3 x, int *tet) {
    double weights[4];
    *tet = follow_line(m, hit.tet, &hit.point, x);
    mesh_barycentric(m, *tet, x, weights);
    return fmin(fmin(weights[0], weights[1]), fmin(weights[2], weights[3])) >= 0.0;
}

/* ---- out of the tissue ------------------------------------------------------------------------------------------------- */

/* Out of the tissue, with the shaft still in it. */
static void go_beyond(const tick_context *tick) {
    needle_tip *tip = &tick->state->tip;
    tip->phase = TIP_BEYOND;
    tip->force = tip->damping = v3(0, 0, 0);
    tip->dent = tip->held_dent = tip->offset = 0.0;
    tip->slip = tip->shaft.slip = 0.0;
    tip->blocked_by = NOT_BLOCKED;
    tip->end = tick->state->needle.joints[tick->model->needle->given.segments];
}

static void exit_tissue(const tick_context *tick) {
    insertion_state *state = tick->state;
    if (leaves_contact_at_exit(tick, state->tip.depth)) leave_contact(tick);
    drop_plan(state);
    go_beyond(tick);
    tick->output->events |= EVENT_EXITED;
}

/* Out of this body, back into the gap before it: the tip is again where it had left the previous body. */
static void back_into_gap(const tick_context *tick) {
    insertion_state *state = tick->state;
    int gap = last_gap(state);
    const stratum *left = &state->strata[gap];
    state->tip.depth = left->depth;
    state->tip.tet = left->tet;
    state->tip.nominal = left->point;
    set_beside(&state->tip, v3(0, 0, 0));
    state->stratum_count = gap;
    go_beyond(tick);
    tick->output->events |= EVENT_EXITED;
}

void leave_tissue(const tick_context *tick) {
    tick->state->request.piece_count = 0; /* the next insertion must not depend on this one's lines */
    tick->state->tip = (needle_tip){.phase = TIP_FREE, .tet = -1, .known_tet = -1, .blocked_by = NOT_BLOCKED, .next_contact = NAN};
    tick->state->surface = v3(NAN, NAN, NAN);
    tick->output->events |= EVENT_WITHDRAWN;
}

/* ---- along an outer face ----------------------------------------------------------------------------------------------

   A needle is not out of the tissue as soon as its axis is: a tip that reaches an outer face at a small angle goes on along the face
   until it is out by the needle's radius. In the mesh, a point just inside the face stands for it. */

/* Does the tip go on along the outer face that it has reached? Not if there is other tissue behind it, or a membrane on it. */
static bool grazes(const tick_context *tick, int face, vec3 direction) {
    const insertion_model *model = tick->model;
    const needle_tip *tip = &tick->state->tip;
    vec3 inward = mesh_face_normal(model->mesh, tip->tet, face);
    if (v3_dot(direction, inward) < -GRAZING || old_tracks_obstacle(tick, tip->tet, face, -1, tip->nominal) != NOT_BLOCKED) return false;
    return !mesh_enter(model->mesh, tip->nominal, v3_axpy(-model->needle->radius, inward, tip->nominal)).hit;
}

static void begin_grazing(const tick_context *tick, int face, vec3 direction) {
    needle_tip *tip = &tick->state->tip;
    vec3 inward = mesh_face_normal(tick->model->mesh, tip->tet, face);
    tip->tet = follow_line(tick->model->mesh, tip->tet, &tip->nominal, v3_axpy(GRAZING_DEPTH, inward, tip->nominal));
    tip->beside = v3_axpy(-GRAZING_DEPTH, inward, tip->beside);
    tip->outward = v3_scale(-1.0, inward);
    plan_contact(tick, direction);
}

/* The tip has moved by `part` along `direction`, and `nominal` along the face. It may have returned to the tissue, or left it. */
static void graze_on(const tick_context *tick, vec3 direction, double part) {
    needle_tip *tip = &tick->state->tip;
    tip->beside = v3_axpy(part * v3_dot(direction, tip->outward), tip->outward, tip->beside);
    double out = v3_dot(tip->beside, tip->outward);
    if (out > tick->model->needle->radius) {
        exit_tissue(tick);
    } else if (out < 0.0) {
        tip->tet = follow_line(tick->model->mesh, tip->tet, &tip->nominal, tip_place(tip));
        tip->beside = tip->outward = v3(0, 0, 0);
        plan_contact(tick, direction);
    }
}

/* ---- forward and back -------------------------------------------------------------------------------------------------- */

/* Into the element behind a face, or out of the tissue. */
static void cross_face(const tick_context *tick, int face, vec3 direction) {
    needle_tip *tip = &tick->state->tip;
    int next = tick->model->mesh->neighbours[tip->tet][face];
    if (next < 0) {
        exit_tissue(tick);
        return;
    }
    tip->tet = next;
    tip->nominal = v3_axpy(FACE_CLEARANCE, direction, tip->nominal);
    tip->depth += FACE_CLEARANCE;
    enter_stratum(tick);
    plan_contact(tick, direction);
}

void give_way(const tick_context *tick, vec3 direction) {
    needle_tip *tip = &tick->state->tip;
    if (tip->blocked_by != BLOCKED_BY_BONE) { /* a needle may begin in bone: that is no puncture */
        tick->output->events |= EVENT_PUNCTURED;
        tick->output->membrane = tip->blocked_by;
        old_tracks_puncture(tick, tip->blocked_by);
    }
    tip->blocked_by = NOT_BLOCKED;
    if (!tip->entering) {
        cross_face(tick, tip->face, direction);
    } else { /* the tip is on the inner side already */
        tip->nominal = v3_axpy(FACE_CLEARANCE, direction, tip->nominal);
        tip->depth += FACE_CLEARANCE;
    }
}

/* How far the tip is from going out of the tissue, if that is in the element that it is in, else INFINITY, m. */
static double distance_to_exit(const insertion_model *model, const needle_tip *tip, vec3 direction) {
    double to_face, rising = v3_dot(direction, tip->outward);
    int face = mesh_exit(model->mesh, tip->tet, tip->nominal, tip_way(tip, direction), &to_face);
    if (v3_norm(tip->outward) > 0.0) {
        double to_exit = (model->needle->radius - v3_dot(tip->beside, tip->outward)) / rising;
        return rising > 0.0 && to_exit < to_face ? to_exit : INFINITY;
    }
    bool outer = face >= 0 && model->mesh->neighbours[tip->tet][face] < 0;
    return outer && v3_dot(direction, mesh_face_normal(model->mesh, tip->tet, face)) < -GRAZING ? to_face : INFINITY;
}

/* Does the tip cut with more force than it takes to get through this? */
static bool overcomes(const needle_tip *tip, double resistance) { return resistance <= (1.0 + SAME_FORCE) * tip->end_force; }

/* Returns what is left of the distance where something stops the tip, m. */
static double advance(const tick_context *tick, vec3 direction, double distance) {
    const insertion_model *model = tick->model;
    needle_tip *tip = &tick->state->tip;
    if (isnan(tip->next_contact)) plan_contact(tick, direction);
    for (int step = 0; step < MAX_STEPS && distance > 0.0 && tip->phase == TIP_INSIDE && tip->blocked_by == NOT_BLOCKED; step++) {
        double to_face, to_contact = tip->next_contact - tip->depth;
        vec3 way = tip_way(tip, direction);
        int face = mesh_exit(model->mesh, tip->tet, tip->nominal, way, &to_face);
        if (face < 0) return 0.0;
        double part = fmax(0.0, fmin(distance, fmin(to_face, to_contact)));
        tip->nominal = v3_axpy(part, way, tip->nominal);
        tip->depth += part;
        distance -= part;
        bool grazing = v3_norm(tip->outward) > 0.0;
        if (grazing) graze_on(tick, direction, part);
        if (tip->phase != TIP_INSIDE) return 0.0;
        if (grazing && v3_norm(tip->outward) == 0.0) continue; /* back in the tissue: another element, perhaps */
        if (to_contact <= part) {
            leave_contact(tick);
            plan_another(tick, direction);
        } else if (to_face <= part && model->mesh->neighbours[tip->tet][face] < 0 && grazes(tick, face, direction))
            begin_grazing(tick, face, direction);
        else if (to_face <= part) {
            tip->blocked_by = old_tracks_obstacle(tick, tip->tet, face, model->mesh->neighbours[tip->tet][face], tip->nominal);
            tip->face = face;
            tip->entering = false;
            if (tip->blocked_by != NOT_BLOCKED) continue;
            cross_face(tick, face, way);
            distance = fmax(distance - FACE_CLEARANCE, 0.0);
        }
    }
    return distance;
}

void cut_forward(const tick_context *tick, vec3 direction, double distance) {
    const needle_tip *tip = &tick->state->tip;
    bool pierces = true;
    for (int membranes = 0; membranes < MAX_STEPS && pierces; membranes++) {
        vec3 from = tip->nominal;
        int tet = tip->tet;
        distance = advance(tick, direction, distance);
        old_tracks_cut(tick, tet, from);
        bool stopped = tip->phase == TIP_INSIDE && tip->blocked_by != NOT_BLOCKED;
        double torn = old_tracks_torn(tick, tip->blocked_by, tip->nominal);
        pierces = stopped && overcomes(tip, blocked_resistance(tick->model, tip->tet, tip->follows.open, tip->blocked_by, torn));
        if (pierces) give_way(tick, direction);
        pierces = pierces && tip->phase == TIP_INSIDE;
    }
    if (tip->phase != TIP_INSIDE) return;
    double left = distance_to_exit(tick->model, tip, direction);
    if (isfinite(left)) plan_exit(tick, tip_way(tip, direction), left);
}

void draw_back(const tick_context *tick, double distance) {
    insertion_state *state = tick->state;
    needle_tip *tip = &state->tip;
    tip->blocked_by = NOT_BLOCKED;
    drop_plan(state);
    while (distance > 0.0) {
        const shaft_contact *last = last_contact(state);
        int gap = last_gap(state);
        double entry = tip_entry_depth(state);
        if (last && last->depth < entry) last = NULL; /* in a previous body */
        double length = tip->depth - (last ? last->depth : entry);
        if (distance >= length) {
            distance -= fmax(length, 0.0);
            if (!last && gap >= 0) {
                back_into_gap(tick);
                return;
            }
            if (last) {
                take_up_contact(tick);
                continue;
            }
            leave_tissue(tick);
            return;
        }
        vec3 goal = last ? last->track : gap >= 0 ? state->strata[gap + 1].point : state->entry;
        vec3 beside = last ? last->beside : v3(0, 0, 0);
        goal = v3_sub(goal, beside);
        vec3 target = v3_axpy(distance / length, v3_sub(goal, tip->nominal), tip->nominal);
        set_beside(tip, v3_axpy(distance / length, v3_sub(beside, tip->beside), tip->beside));
        tip->tet = follow_line(tick->model->mesh, tip->tet, &tip->nominal, target);
        tip->depth -= distance;
        leave_strata(state);
        return;
    }
}
