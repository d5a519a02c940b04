#include "insertion/tip/tip.h"

#include "insertion/model/local_compliance.h"
#include "insertion/state/strata.h"
#include "insertion/tip/next_body.h"
#include "insertion/tip/tip_walk.h"
#include "insertion/track/contact_nodes.h"
#include "insertion/track/old_tracks.h"

static const double MOST_SHEAR = 0.7; /* shear strain, below 1: if the tissue along the track is sheared by more than this, the tip's direction ignores the
                                         shear. Chosen: far beyond small strains */
static const double GLIDE_REACH = 2e-3; /* m: a sliding tip looks for the surface this far above and below itself. Chosen by judgement */
static const double LIFTED = 1e-6; /* m: a tip farther than this from the surface has left it. Rounding tolerance: accuracy of the surface's displacement */

/* ---- on the surface ---------------------------------------------------------------------------------------------------- */

bool tip_touch(const tick_input *tick, insertion_state *state, tick_output *output, vec3 from, vec3 to) {
    surface_hit hit = mesh_enter(tick->model->mesh, from, to);
    if (!hit.hit) return false;
    state->tip = (needle_tip){.place = {.phase = TIP_INSIDE, .tet = hit.tet, .nominal = hit.point, .direction = v3_unit(needle_direction(tick, state))},
                              .barrier = {.face = hit.face, .blocked_by = old_tracks_obstacle(tick, state, hit.tet, hit.face, hit.tet, hit.point), .entering = true},
                              .known.tet = -1, .next_contact = NAN, .shaft = shaft_at_rest(tick->model, 0.0), .filtered_push = FULL_GRIP};
    state->tip_lead = 0.0;
    state->entry = hit.point;
    state->stratum_count = 0;
    enter_stratum(tick, state, output);
    output->events |= EVENT_TOUCHED;
    return true;
}

bool tip_is_below(const insertion_model *model, vec3 from, vec3 to) {
    surface_hit hit = mesh_enter(model->mesh, from, to);
    int tet;
    return hit.hit && reaches(model->mesh, hit, to, &tet);
}

/* Moves the tip's material point along the outer surface by the tangential vector `shift` (m). `inward`: unit normal of the surface, into the tissue. */
static void tip_glide(const tick_input *tick, insertion_state *state, tick_output *output, vec3 inward, vec3 shift) {
    const insertion_model *model = tick->model;
    needle_tip *tip = &state->tip;
    vec3 goal = v3_add(tip->place.nominal, shift);
    surface_hit hit = mesh_enter(model->mesh, v3_axpy(-GLIDE_REACH, inward, goal), v3_axpy(GLIDE_REACH, inward, goal));
    if (!hit.hit) { /* past the edge: the tip has left if a straight needle would be past the tissue; otherwise it would meet the surface again */
        vec3 axis = q_axis(state->needle.base.orientation);
        vec3 end = needle_straight_end(model->needle, state->needle.base);
        if (!tip_is_below(model, v3_axpy(-GLIDE_REACH, axis, end), end)) withdraw_tip(state, output);
        return;
    }
    tip->place.tet = hit.tet;
    tip->barrier.face = hit.face;
    tip->place.nominal = state->entry = hit.point;
    state->stratum_count = 0;
    enter_stratum(tick, state, output);
    tip->barrier.blocked_by = old_tracks_obstacle(tick, state, hit.tet, hit.face, hit.tet, hit.point);
    tip->barrier.entering = true;
}

/* The tip slides half the distance that would bring the force back into the friction cone. Sliding the full distance could overshoot and lift a lightly
   pressing needle off the surface. */
void tip_glide_on_surface(const tick_input *tick, insertion_state *state, tick_output *output) {
    const insertion_model *model = tick->model;
    const needle_tip *tip = &state->tip;
    vec3 inward = mesh_face_normal(model->mesh, tip->place.tet, tip->barrier.face);
    double normal_force = v3_dot(tip->solved.force, inward);
    vec3 tangential = v3_axpy(-normal_force, inward, tip->solved.force);
    double excess = v3_norm(tangential) - model->settings.surface_friction * fmax(normal_force, 0.0);
    if (excess <= 0.0) return;
    if (!tip->resolution.known) return;
    double compliance = 0.5 * local_at_tip(model, tip->place.tet, tip->place.nominal, 0.0, tip->filtered_push, tip->resolution.field.point);
    tip_glide(tick, state, output, inward, v3_scale(excess * compliance / v3_norm(tangential), tangential));
}

/* ---- in the tissue ----------------------------------------------------------------------------------------------------- */

void tip_puncture(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output) {
    needle_tip *tip = &state->tip;
    if (tip->place.phase != TIP_INSIDE || tip->barrier.blocked_by == NOT_BLOCKED || tip->solved.slip <= 0.0) return;
    tip->solved.slip = 0.0;
    puncture_barrier(tick, state, creep, output, v3_unit(needle_direction(tick, state)));
    if (tip->place.phase == TIP_BEYOND) enter_touching_body(tick, state, output, v3_unit(needle_direction(tick, state)));
}

/* Returns the unit direction d in the undeformed tissue whose image in the deformed tissue, d + gradient, points along `direction`. If the tissue is deformed
   beyond the range of linear elasticity, returns `direction` itself. Ignores compression along the needle; the slip of the next step corrects the resulting
   error. */
static vec3 pull_back(vec3 gradient, vec3 direction) {
    direction = v3_unit(direction);
    vec3 sideways = v3_axpy(-v3_dot(gradient, direction), direction, gradient);
    double square = v3_dot(sideways, sideways);
    if (!(square < MOST_SHEAR * MOST_SHEAR)) return direction;
    return v3_axpy(sqrt(1.0 - square), direction, v3_scale(-1.0, sideways));
}

vec3 tip_cut_direction(const tick_input *tick, const insertion_state *state, vec3 track_gradient) { return pull_back(track_gradient, needle_direction(tick, state)); }

/* Updates the direction of the track at the tip, a running mean over about one needle diameter. `way`: the segment just cut or retraced, in the direction of
   cutting. */
static void follow_track(const insertion_model *model, needle_tip *tip, vec3 way) {
    double length = v3_norm(way);
    if (length == 0.0) return;
    vec3 change = v3_sub(v3_scale(1.0 / length, way), tip->place.direction);
    tip->place.direction = v3_unit(v3_axpy(-expm1(-0.5 * length / model->needle->radius), change, tip->place.direction));
}

/* True if a needle that is bent, and pushes with no axial force, still touches the surface: if it were straight, its end would be in the tissue. */
static bool stays_on_surface(const tick_input *tick, const insertion_state *state) {
    const needle_tip *tip = &state->tip;
    if (tip->place.depth > 0.0) return false;
    vec3 axis = q_axis(tick->base.pose.orientation), displaced = v3_sub(tip->dent.rest, tip_position(&tip->place));
    vec3 end = v3_axpy(LIFTED, axis, needle_straight_end(tick->model->needle, tick->base.pose));
    int tet;
    return reaches(tick->model->mesh, (surface_hit){.hit = true, .tet = tip->place.tet, .point = tip->place.nominal}, v3_sub(end, displaced), &tet);
}

void tip_move(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 cut_direction) {
    const insertion_model *model = tick->model;
    needle_tip *tip = &state->tip;
    if (tip->place.phase == TIP_BEYOND) reenter_tissue(tick, state, creep, output);
    if (tip->place.phase == TIP_BEYOND) enter_body_ahead(tick, state, creep, output);
    if (tip->place.phase != TIP_INSIDE) return;
    vec3 before = tip_position(&tip->place);
    if (tip->solved.slip > 0.0) {
        vec3 direction = old_tracks_lead(&tip->track, cut_direction);
        cut_forward(tick, state, creep, output, direction, tip->track.openness > 0.0 ? fmin(tip->solved.slip, tip->track.to_end) : tip->solved.slip);
        follow_track(model, tip, v3_sub(tip_position(&tip->place), before));
        if (tip->place.phase == TIP_BEYOND) enter_touching_body(tick, state, output, direction);
    } else if (tip->solved.slip < 0.0 && !stays_on_surface(tick, state)) {
        draw_back(tick, state, output, -tip->solved.slip);
        follow_track(model, tip, v3_sub(before, tip_position(&tip->place)));
    }
    tip->solved.slip = 0.0;
}

/* Makes the tissue around a straight needle unstrained, so that its contacts hold the shaft where it is. */
static void rest_shaft(const insertion_model *model, insertion_state *state) {
    const vec3 *joints = state->needle.joints;
    vec3 base = joints[0], axis = v3_unit(v3_sub(joints[model->needle->given.segments], base));
    state->tip.shaft = shaft_at_rest(model, state->tip.place.depth);
    for (int k = 0; k < state->refined.count; k++) {
        shaft_contact *contact = &state->contacts[state->refined.order[k]];
        contact->shaft = shaft_at_rest(model, state->tip.place.depth);
        contact->shaft.origin = v3_dot(v3_sub(contact->track, base), axis) - contact->depth;
    }
}

void tip_engage(const insertion_model *model, insertion_state *state) {
    tick_output ignored = {0}, *output = &ignored;
    const tick_input given = {.model = model}, *tick = &given;
    vec3 base = state->needle.joints[0], end = state->needle.joints[model->needle->given.segments];
    if (!tip_touch(tick, state, output, base, end)) return;
    vec3 direction = v3_unit(v3_sub(end, base));
    double whole = v3_norm(v3_sub(end, state->entry));
    for (int step = 0; step < MAX_STEPS && state->tip.place.phase == TIP_INSIDE && state->tip.place.depth < whole; step++) {
        /* the needle is already through the barrier */
        if (state->tip.barrier.blocked_by != NOT_BLOCKED) puncture_barrier(tick, state, NULL, output, v3_unit(needle_direction(tick, state)));
        cut_forward(tick, state, NULL, output, direction, whole - state->tip.place.depth);
        if (state->tip.place.phase != TIP_BEYOND) continue;
        vec3 left = state->tip.place.nominal;
        entrance at = next_body(tick, state, left, end);
        enter_next(tick, state, output, &at, v3_dot(v3_sub(at.point, left), direction));
    }
    rest_shaft(model, state);
}
