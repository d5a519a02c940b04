#include "insertion/tip/tip_walk.h"

#include "insertion/state/strata.h"
#include "insertion/tip/known_tissue.h"
#include "insertion/track/contact_nodes.h"
#include "insertion/track/obstacle.h"
#include "insertion/track/old_tracks.h"

static const double GRAZING = 0.2; /* dimensionless: a tip that meets an outer face at an angle whose sine is below this moves along the face. Chosen: 11
                                      degrees */
static const double GRAZING_DEPTH = 1e-5; /* m: how far `nominal` is below the face that the tip grazes. Rounding tolerance */
static const double SAME_FORCE = 1e-6; /* fraction: the tip overcomes a resistance that exceeds its cutting force by no more than this. Rounding tolerance */

int follow_line(const mesh *m, int tet, vec3 *from, vec3 target) {
    for (int step = 0; step < MAX_STEPS; step++) {
        vec3 rest = v3_sub(target, *from);
        double fraction;
        int face = mesh_exit(m, tet, *from, rest, &fraction);
        if (face < 0 || fraction >= 1.0 || mesh_bonded(m, tet, face) < 0) break;
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

/* Records that the tip has left the tissue while part of the shaft is still in it. */
static void go_beyond(const tick_input *tick, insertion_state *state) {
    needle_tip *tip = &state->tip;
    tip->place.phase = TIP_BEYOND;
    tip->solved.force = tip->dent.damping = v3(0, 0, 0);
    tip->dent.size = tip->dent.offset = 0.0;
    tip->solved.slip = tip->shaft.slip = 0.0;
    tip->barrier.blocked_by = NOT_BLOCKED;
    tip->place.end = state->needle.joints[tick->model->needle->given.segments];
}

static void exit_tissue(const tick_input *tick, insertion_state *state, tick_output *output) {
    if (wants_contact_at_exit(tick, state, state->tip.place.depth)) place_contact(tick, state, output);
    drop_plan(state);
    go_beyond(tick, state);
    output->events |= EVENT_EXITED;
}

/* Moves the tip back out of this body into the gap before it, to the point where it left the previous body. */
static void back_into_gap(const tick_input *tick, insertion_state *state, tick_output *output) {
    int gap = last_gap(state);
    const stratum *left = &state->strata[gap];
    state->tip.place.depth = left->depth;
    state->tip.place.tet = left->tet;
    state->tip.place.nominal = left->point;
    set_beside(&state->tip, v3(0, 0, 0));
    state->stratum_count = gap;
    go_beyond(tick, state);
    output->events |= EVENT_EXITED;
}

void withdraw_tip(insertion_state *state, tick_output *output) {
    state->request.piece_count = 0; /* the next insertion must not depend on this one's lines */
    state->tip = tip_in_air();
    state->surface = v3(NAN, NAN, NAN);
    output->events |= EVENT_WITHDRAWN;
}

/* ---- along an outer face ----------------------------------------------------------------------------------------------

   When a needle's axis has left the tissue, part of the needle is still in it. So a tip that reaches an outer face at a small angle continues along the face
   until its axis is one radius outside. Meanwhile, a point just inside the face represents the tip in the mesh. */

/* True if the tip, having reached an outer face, continues along it: it meets the face at a small angle, and there is neither a membrane on the face nor other
   tissue behind it. */
static bool grazes(const tick_input *tick, const insertion_state *state, int face, vec3 direction) {
    const insertion_model *model = tick->model;
    const needle_tip *tip = &state->tip;
    vec3 inward = mesh_face_normal(model->mesh, tip->place.tet, face);
    if (v3_dot(direction, inward) < -GRAZING || old_tracks_obstacle(tick, state, tip->place.tet, face, -1, tip->place.nominal) != NOT_BLOCKED) return false;
    return !mesh_enter(model->mesh, tip->place.nominal, v3_axpy(-model->needle->radius, inward, tip->place.nominal)).hit;
}

static void begin_grazing(const tick_input *tick, insertion_state *state, tick_output *output, int face, vec3 direction) {
    needle_tip *tip = &state->tip;
    vec3 inward = mesh_face_normal(tick->model->mesh, tip->place.tet, face);
    tip->place.tet = follow_line(tick->model->mesh, tip->place.tet, &tip->place.nominal, v3_axpy(GRAZING_DEPTH, inward, tip->place.nominal));
    tip->place.beside = v3_axpy(-GRAZING_DEPTH, inward, tip->place.beside);
    tip->place.graze_normal = v3_scale(-1.0, inward);
    plan_contact(tick, state, output, direction);
}

/* Completes a motion of the tip by `part` along `direction`. The caller has already moved `nominal` along the grazed face; this changes the tip's offset from
   it. The tip may return into the tissue or leave the face. */
static void graze_on(const tick_input *tick, insertion_state *state, tick_output *output, vec3 direction, double part) {
    needle_tip *tip = &state->tip;
    tip->place.beside = v3_axpy(part * v3_dot(direction, tip->place.graze_normal), tip->place.graze_normal, tip->place.beside);
    double out = v3_dot(tip->place.beside, tip->place.graze_normal);
    if (out > tick->model->needle->radius) {
        exit_tissue(tick, state, output);
    } else if (out < 0.0) {
        tip->place.tet = follow_line(tick->model->mesh, tip->place.tet, &tip->place.nominal, tip_position(&tip->place));
        tip->place.beside = tip->place.graze_normal = v3(0, 0, 0);
        plan_contact(tick, state, output, direction);
    }
}

/* ---- forward and back -------------------------------------------------------------------------------------------------- */

/* Returns the point at rest, in element `next` or close to it, of the tissue that now lies at the tip across a face along which the tissue slides. If the
   snapshot does not cover both sides, ignores how far they have slid. */
static vec3 point_across(const tick_input *tick, const insertion_state *state, const creep_step *creep, int next) {
    const mesh *m = tick->model->mesh;
    const tip_place *place = &state->tip.place;
    int here[4], there[4];
    double weights[4];
    if (!creep || !snapshot_covers(tick->snapshot, m->tets[place->tet], here) || !snapshot_covers(tick->snapshot, m->tets[next], there)) return place->nominal;
    mesh_barycentric(m, place->tet, place->nominal, weights);
    vec3 displaced = v3_add(place->nominal, displacement_at(tick, state, creep, here, weights));
    mesh_barycentric(m, next, place->nominal, weights);
    return v3_sub(displaced, displacement_at(tick, state, creep, there, weights));
}

/* Moves the tip to the other side of a face along which the tissue slides. The track continues in the tissue that lies at the tip now, which may have been
   elsewhere at rest. */
static void change_sides(const tick_input *tick, insertion_state *state, const creep_step *creep, int next) {
    const mesh *m = tick->model->mesh;
    tip_place *place = &state->tip.place;
    vec3 across = point_across(tick, state, creep, next);
    double weights[4], sum = 0.0;
    place->tet = follow_line(m, next, &place->nominal, across);
    mesh_barycentric(m, place->tet, across, weights);
    for (int c = 0; c < 4; c++) sum += weights[c] = fmax(weights[c], 0.0); /* where the surface is curved, the point may lie outside */
    for (int c = 0; c < 4; c++) weights[c] /= sum;
    place->nominal = mesh_point(m, place->tet, weights);
    state->tip.solved.friction = STICK; /* on this side, the tip has not dented the tissue yet, so there is no rebound to be damped */
    state->tip.dent.offset = 0.0;
    state->tip.dent.damping = v3(0, 0, 0);
}

/* Crosses a face: the tip enters the element behind it or leaves the tissue. */
static void cross_face(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, int face, vec3 direction) {
    needle_tip *tip = &state->tip;
    int next = tick->model->mesh->neighbours[tip->place.tet][face], before = state->stratum_count;
    const tip_place left = tip->place;
    if (next < 0) {
        exit_tissue(tick, state, output);
        return;
    }
    bool slides = mesh_slides(tick->model->mesh, left.tet, face);
    if (slides) change_sides(tick, state, creep, next);
    else tip->place.tet = next;
    tip->place.nominal = v3_axpy(FACE_CLEARANCE, direction, tip->place.nominal);
    tip->place.depth += FACE_CLEARANCE;
    enter_stratum(tick, state, output);
    if (slides && state->stratum_count > before) {
        state->strata[before].slides = true;
        state->strata[before].left_tet = left.tet;
        state->strata[before].left = left.nominal;
    }
    plan_contact(tick, state, output, direction);
}

void puncture_barrier(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 direction) {
    needle_tip *tip = &state->tip;
    if (tip->barrier.blocked_by != BLOCKED_BY_BONE) { /* a needle may start in bone, which is not a puncture */
        output->events |= EVENT_PUNCTURED;
        output->membrane = tip->barrier.blocked_by;
        old_tracks_puncture(state, output, tip->barrier.blocked_by);
    }
    tip->barrier.blocked_by = NOT_BLOCKED;
    if (!tip->barrier.entering) {
        cross_face(tick, state, creep, output, tip->barrier.face, direction);
    } else { /* the tip is already on the inner side of the face */
        tip->place.nominal = v3_axpy(FACE_CLEARANCE, direction, tip->place.nominal);
        tip->place.depth += FACE_CLEARANCE;
    }
}

/* Returns the distance (m) from the tip to where it would leave the tissue through its current element; INFINITY if it would not. */
static double distance_to_exit(const insertion_model *model, const needle_tip *tip, vec3 direction) {
    double to_face, rising = v3_dot(direction, tip->place.graze_normal);
    int face = mesh_exit(model->mesh, tip->place.tet, tip->place.nominal, tip_way(&tip->place, direction), &to_face);
    if (v3_norm(tip->place.graze_normal) > 0.0) {
        double to_exit = (model->needle->radius - v3_dot(tip->place.beside, tip->place.graze_normal)) / rising;
        return rising > 0.0 && to_exit < to_face ? to_exit : INFINITY;
    }
    bool outer = face >= 0 && model->mesh->neighbours[tip->place.tet][face] < 0;
    return outer && v3_dot(direction, mesh_face_normal(model->mesh, tip->place.tet, face)) < -GRAZING ? to_face : INFINITY;
}

/* True if the tip's cutting force is large enough for this resistance. */
static bool overcomes(const needle_tip *tip, double resistance) { return resistance <= (1.0 + SAME_FORCE) * tip->solved.end_force; }

/* Decides what happens at a face: the tip moves along an outer face, is blocked, or crosses it. Returns true if it has crossed. */
static bool meet_face(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, int face, vec3 direction) {
    needle_tip *tip = &state->tip;
    int behind = tick->model->mesh->neighbours[tip->place.tet][face];
    vec3 way = tip_way(&tip->place, direction);
    if (behind < 0 && grazes(tick, state, face, direction)) {
        begin_grazing(tick, state, output, face, direction);
        return false;
    }
    tip->barrier.blocked_by = old_tracks_obstacle(tick, state, tip->place.tet, face, behind, tip->place.nominal);
    tip->barrier.face = face;
    tip->barrier.entering = false;
    if (tip->barrier.blocked_by != NOT_BLOCKED) return false;
    cross_face(tick, state, creep, output, face, way);
    return true;
}

/* Cuts up to the next face or contact node. Returns the distance left, m. */
static double advance_once(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 direction, double distance) {
    needle_tip *tip = &state->tip;
    double to_face, to_contact = tip->next_contact - tip->place.depth;
    vec3 way = tip_way(&tip->place, direction);
    int face = mesh_exit(tick->model->mesh, tip->place.tet, tip->place.nominal, way, &to_face);
    if (face < 0) return 0.0;
    double part = fmax(0.0, fmin(distance, fmin(to_face, to_contact))), left = distance - part;
    bool grazing = v3_norm(tip->place.graze_normal) > 0.0;
    tip->place.nominal = v3_axpy(part, way, tip->place.nominal);
    tip->place.depth += part;
    if (grazing) graze_on(tick, state, output, direction, part);
    if (tip->place.phase != TIP_INSIDE) return 0.0;
    if (grazing && v3_norm(tip->place.graze_normal) == 0.0) return left; /* the tip is back in the tissue, perhaps in another element */
    if (to_contact <= part) {
        place_contact(tick, state, output);
        plan_another(tick, state, output, direction);
    } else if (to_face <= part && meet_face(tick, state, creep, output, face, direction)) {
        left = fmax(left - FACE_CLEARANCE, 0.0);
    }
    return left;
}

/* Advances until the distance is covered or an obstacle stops the tip. Returns the distance left, m. */
static double advance(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 direction, double distance) {
    const needle_tip *tip = &state->tip;
    if (isnan(tip->next_contact)) plan_contact(tick, state, output, direction);
    for (int step = 0; step < MAX_STEPS && distance > 0.0 && tip->place.phase == TIP_INSIDE && tip->barrier.blocked_by == NOT_BLOCKED; step++)
        distance = advance_once(tick, state, creep, output, direction, distance);
    return distance;
}

void cut_forward(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 direction, double distance) {
    const needle_tip *tip = &state->tip;
    bool pierces = true;
    for (int membranes = 0; membranes < MAX_STEPS && pierces; membranes++) {
        vec3 from = tip->place.nominal;
        int tet = tip->place.tet;
        distance = advance(tick, state, creep, output, direction, distance);
        old_tracks_cut(state, output, tet, from);
        bool stopped = tip->place.phase == TIP_INSIDE && tip->barrier.blocked_by != NOT_BLOCKED;
        double damage = old_tracks_damage(tick, state, tip->barrier.blocked_by, tip->place.nominal);
        pierces = stopped && overcomes(tip, blocked_resistance(tick->model, tip->place.tet, tip->place.nominal, tip->track.openness, tip->barrier.blocked_by, damage));
        if (pierces) puncture_barrier(tick, state, creep, output, direction);
        pierces = pierces && tip->place.phase == TIP_INSIDE;
    }
    if (tip->place.phase != TIP_INSIDE) return;
    double left = distance_to_exit(tick->model, tip, direction);
    if (isfinite(left)) plan_exit(tick, state, output, tip_way(&tip->place, direction), left);
}

/* The track behind the tip, back to the last contact, to a surface on which the tissue slides or, if neither is in this body, to where the tip entered it. */
typedef struct {
    const shaft_contact *contact; /* NULL if the way does not end at a contact */
    int surface;             /* index of the stratum that begins at the surface where the way ends, or -1 */
    int gap;                 /* index of the gap before this body, or -1 */
    double length;           /* m */
} way_back;

static way_back find_way_back(const insertion_state *state) {
    const shaft_contact *last = last_contact(state);
    double depth = state->tip.place.depth, entry = tip_entry_depth(state);
    int surface = last_sliding(state, depth);
    if (last && last->depth < entry) last = NULL; /* the last contact is in a previous body */
    double end = last ? last->depth : entry;
    if (surface >= 0 && state->strata[surface].depth > end) return (way_back){NULL, surface, -1, depth - state->strata[surface].depth};
    return (way_back){last, -1, last_gap(state), depth - end};
}

/* Moves the tip back by `distance`, which must be less than way->length. */
static void go_back(const mesh *m, insertion_state *state, const way_back *way, double distance) {
    needle_tip *tip = &state->tip;
    vec3 goal = way->contact ? way->contact->track : way->surface >= 0 ? state->strata[way->surface].point : way->gap >= 0 ? state->strata[way->gap + 1].point : state->entry;
    vec3 beside = way->contact ? way->contact->beside : v3(0, 0, 0);
    goal = v3_sub(goal, beside);
    vec3 target = v3_axpy(distance / way->length, v3_sub(goal, tip->place.nominal), tip->place.nominal);
    set_beside(tip, v3_axpy(distance / way->length, v3_sub(beside, tip->place.beside), tip->place.beside));
    tip->place.tet = follow_line(m, tip->place.tet, &tip->place.nominal, target);
    tip->place.depth -= distance;
    drop_strata_ahead(state);
}

/* Moves the tip back across a surface on which the tissue slides, to where the track left the other side. */
static void return_across(insertion_state *state, const stratum *surface) {
    tip_place *place = &state->tip.place;
    place->tet = surface->left_tet;
    place->nominal = surface->left;
    place->depth = surface->depth - FACE_CLEARANCE;
    set_beside(&state->tip, v3(0, 0, 0));
    drop_strata_ahead(state);
}

void draw_back(const tick_input *tick, insertion_state *state, tick_output *output, double distance) {
    state->tip.barrier.blocked_by = NOT_BLOCKED;
    drop_plan(state);
    way_back way = find_way_back(state);
    for (; distance > 0.0 && distance >= way.length && (way.contact || way.surface >= 0); way = find_way_back(state)) {
        distance -= fmax(way.length, 0.0);
        if (way.contact) return_to_contact(tick, state, output);
        else return_across(state, &state->strata[way.surface]);
    }
    if (!(distance > 0.0)) return;
    if (distance < way.length) go_back(tick->model->mesh, state, &way, distance);
    else if (way.gap >= 0) back_into_gap(tick, state, output);
    else withdraw_tip(state, output);
}
