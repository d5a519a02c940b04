#include "insertion/tip/path_stage.h"

#include "insertion/guide/guides.h"
#include "insertion/laws/creep.h"
#include "insertion/tip/prefetch.h"
#include "insertion/tip/tip.h"
#include "insertion/track/old_tracks.h"

static const double SAME_PLACE = 1e-7; /* m: accuracy with which the surface's displacement is found. Rounding tolerance */
enum { MOST_LOOKS = 5 }; /* iterations: most in the search for the displaced surface. Cost limit */

/* ---- in the air ---------------------------------------------------------------------------------------------------- */

/* Returns the displacement of the surface just ahead of or behind the end of a needle in the air, due to other bodies and the tissue's memory. The mesh
   represents the tissue at rest, so the needle's axis meets the displaced surface where the axis, shifted back by the displacement there, meets the mesh. While
   the displacement is unknown, returns its last known value. */
static vec3 surface_displacement(const tick_input *tick, const insertion_state *state, const creep_step *creep, vec3 end, vec3 axis) {
    const mesh *m = tick->model->mesh;
    vec3 u = isnan(state->surface.x) ? v3(0, 0, 0) : state->surface, reach = v3_scale(tick->model->needle->given.length, axis), before;
    int handles[4];
    double weights[4];
    if (creep_free_is_zero(tick, state)) return v3(0, 0, 0);
    for (int i = 0; i < MOST_LOOKS; i++) {
        vec3 middle = v3_sub(end, u);
        surface_hit hit = mesh_enter(m, v3_sub(middle, reach), v3_add(middle, reach));
        if (!hit.hit) return v3(0, 0, 0);
        if (!snapshot_covers(tick->snapshot, m->tets[hit.tet], handles)) break;
        mesh_barycentric(m, hit.tet, hit.point, weights);
        before = u;
        u = v3_add(creep_free_at(tick, state, creep, handles, weights), creep_unresolved_at_entry(tick, state, creep));
        if (v3_norm(v3_sub(u, before)) < SAME_PLACE) break;
    }
    return u;
}

/* Lets the tip touch the surface when its nominal position `now` (m) is already in the tissue. This happens if other needles have moved the tissue over the
   tip, or if the displacement they cause has only just become known. The search starts one diameter behind the tip and keeps doubling the distance, up to two
   needle lengths. */
static void touch_above(const tick_input *tick, insertion_state *state, tick_output *output, vec3 now, vec3 axis) {
    const insertion_model *model = tick->model;
    for (double back = model->needle->given.outer_diameter; back < 2.0 * model->needle->given.length; back *= 2.0) {
        vec3 behind = v3_axpy(-back, axis, now);
        if (tip_is_below(model, behind, now)) {
            tip_touch(tick, state, output, behind, now);
            return;
        }
    }
}

/* Starts an insertion when the tip touches the outer surface. A needle that the hand draws out of a dent does not touch it. Nor does one whose end has slid
   over an edge: it is past the tissue, although its axis still cuts the corner. */
static void look_for_surface(const tick_input *tick, insertion_state *state, const hand_advance *hand, const creep_step *creep, tick_output *output) {
    const insertion_model *model = tick->model;
    vec3 known = state->surface, axis = q_axis(tick->base.pose.orientation), end = state->needle.joints[model->needle->given.segments];
    vec3 advance = v3_sub(needle_straight_end(model->needle, tick->base.pose), hand->straight_before);
    state->surface = surface_displacement(tick, state, creep, end, axis);
    if (isnan(known.x)) known = state->surface;
    vec3 now = v3_sub(end, state->surface), rise = v3_sub(state->surface, known);
    if (!tip_touch(tick, state, output, v3_sub(hand->end_before, known), now) && v3_dot(v3_sub(advance, rise), axis) > 0.0) touch_above(tick, state, output, now, axis);
}

/* ---- in the tissue ------------------------------------------------------------------------------------------------- */

static void advance_tip(const tick_input *tick, insertion_state *state, const creep_step *creep, tick_output *output, vec3 gradient) {
    needle_tip *tip = &state->tip;
    if (!isfinite(tip->solved.slip)) tip->shaft.origin = NAN; /* makes insertion_is_finite fail, which restarts the insertion; otherwise the tip would cut
                                                                 through the whole tissue */
    tip_move(tick, state, creep, output, tip_cut_direction(tick, state, gradient));
    if (tip->place.phase == TIP_INSIDE && tip->place.depth == 0.0) tip_glide_on_surface(tick, state, output);
}

void path_follow(const tick_input *tick, insertion_state *state, const hand_advance *hand, path_step *path, const creep_step *creep, tick_output *output, vec3 gradient) {
    needle_tip *tip = &state->tip;
    if (tip->place.phase == TIP_FREE) look_for_surface(tick, state, hand, creep, output);
    else advance_tip(tick, state, creep, output, gradient);
    path->cut_direction = tip_cut_direction(tick, state, gradient);
    tip->barrier.membrane_damage = tip->place.phase == TIP_INSIDE ? old_tracks_damage(tick, state, tip->barrier.blocked_by, tip->place.nominal) : 0.0;
    tip->track = old_tracks_ahead(tick, state, path, 0.0);
    guides_follow(tick, state, output);
}
