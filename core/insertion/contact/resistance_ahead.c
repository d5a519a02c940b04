#include "insertion/contact/resistance_ahead.h"

#include "insertion/tip/tip_walk.h"
#include "insertion/track/obstacle.h"
#include "insertion/track/old_tracks.h"

/* ---- the stretches ------------------------------------------------------------------------------------------------- */

/* Inserts a stretch into the list, which is sorted by `from`. */
static void add_stretch(resistance_ahead *ahead, stretch_ahead added) {
    int k = ahead->count;
    if (k == MAX_KNOTS) return;
    for (; k > 0 && ahead->stretches[k - 1].from > added.from; k--) ahead->stretches[k] = ahead->stretches[k - 1];
    ahead->stretches[k] = added;
    ahead->count++;
}

/* Adds a stretch of tissue that begins at the nominal point x. Along an open track, the tissue springs back over the tip, so the tip advances farther than the
   hand carries it. Beyond the hand's advance, the stretch has the viscosity of uncut tissue: otherwise nothing would slow the rebound, and the force would drop
   at once when the tip enters the track. */
static void add_tissue(const tick_input *tick, const insertion_state *state, const hand_advance *hand, resistance_ahead *ahead, double from, vec3 x, const open_track *track) {
    const insertion_model *model = tick->model;
    int tet = state->tip.place.tet;
    double whole = model->materials[model->mesh->region[tet]].cutting_viscosity;
    bool springs_back = from >= hand->carried;
    add_stretch(ahead, (stretch_ahead){.from = from, .resistance = cutting_resistance(model, tet, x, track->openness),
                                                       .viscosity = springs_back ? whole : (1.0 - track->openness) * whole, .track = *track});
}

/* Adds the calcifications that the tip enters as its slip goes from `from` to `to`. x: the tip's nominal position at slip `from`. */
static void add_calcifications(const tick_input *tick, const insertion_state *state, const hand_advance *hand, resistance_ahead *ahead, double from, double to, vec3 x,
                               vec3 direction, const open_track *track) {
    const insertion_model *model = tick->model;
    for (int i = 0; i < model->calcification_count; i++) {
        double entry = calcification_entry(&model->calcifications[i], x, direction) + FACE_CLEARANCE; /* just past the boundary, so that this point counts as
                                                                                                         inside */
        if (from + entry < to) add_tissue(tick, state, hand, ahead, from + entry, v3_axpy(entry, direction, x), track);
    }
}

/* Adds the open tracks, one after another, then the uncut tissue beyond them, and the calcifications along all of them. */
static void add_tracks(const tick_input *tick, const insertion_state *state, const hand_advance *hand, const path_step *path, resistance_ahead *ahead, double reach) {
    double carried = hand->carried, from = 0.0;
    vec3 x = state->tip.place.nominal;
    open_track track = state->tip.track;
    while (ahead->count < MAX_KNOTS - 1) {
        vec3 direction = old_tracks_lead(&track, path->cut_direction);
        double end = track.openness > 0.0 ? fmin(track.to_end, reach) : reach;
        add_tissue(tick, state, hand, ahead, from, x, &track);
        add_calcifications(tick, state, hand, ahead, from, end, x, direction, &track);
        if (track.openness == 0.0) return;
        if (from < carried && carried < track.to_end) add_tissue(tick, state, hand, ahead, carried, v3_axpy(carried - from, direction, x), &track);
        if (track.to_end > reach) return;
        x = v3_axpy(track.to_end - from, direction, x);
        from = track.to_end;
        track = old_tracks_ahead(tick, state, path, from);
    }
}

/* Adds the membranes and bone that the tip would meet along the stretches. A tip that grazes an outer face meets none. */
static void add_stops(const tick_input *tick, const insertion_state *state, const path_step *path, resistance_ahead *ahead, double reach) {
    const mesh *m = tick->model->mesh;
    const needle_tip *tip = &state->tip;
    const resistance_ahead tissue = *ahead;
    vec3 x = tip->place.nominal;
    double slip = 0.0, chord;
    if (v3_norm(tip->place.graze_normal) > 0.0) return;
    for (int step = 0, k = 0, tet = tip->place.tet; step < MAX_STEPS && tet >= 0 && slip < reach; step++) {
        const open_track *track = &tissue.stretches[k].track;
        vec3 direction = old_tracks_lead(track, path->cut_direction);
        double end = k + 1 < tissue.count ? tissue.stretches[k + 1].from : INFINITY;
        int face = mesh_exit(m, tet, x, direction, &chord);
        if (face < 0) return;
        if (slip + chord > end) {
            x = v3_axpy(end - slip, direction, x);
            slip = end;
            k++;
            continue;
        }
        slip += chord;
        x = v3_axpy(chord, direction, x);
        int behind = m->neighbours[tet][face], blocked_by = old_tracks_obstacle(tick, state, tet, face, behind, x);
        if (blocked_by != NOT_BLOCKED && slip <= reach) {
            double resistance = blocked_resistance(tick->model, tet, x, track->openness, blocked_by, old_tracks_damage(tick, state, blocked_by, x));
            add_stretch(ahead, (stretch_ahead){.from = slip + FACE_CLEARANCE /* just past the face, so that the tip reaches it */, .resistance = resistance, .stops = true, .track = *track});
        }
        x = v3_axpy(FACE_CLEARANCE, direction, x);
        tet = behind;
    }
}

/* Returns how far (m) the tip would advance if no force opposed it: the hand's advance plus the full rebound of the tissue. */
static double most_slip(const insertion_state *state, const contact_points *points) {
    const contact_point *p = &points->list[points->count - 1];
    return fmax(v3_dot(needle_along(&p->at), v3_sub(v3_sub(p->at.position, state->base_shift), p->target)), 0.0);
}

void resistance_ahead_find(const tick_input *tick, const insertion_state *state, const hand_advance *hand, const path_step *path, const contact_points *points,
                           resistance_ahead *ahead) {
    const needle_tip *tip = &state->tip;
    ahead->count = 0;
    if (tip->barrier.blocked_by != NOT_BLOCKED) {
        add_stretch(ahead, (stretch_ahead){.resistance = tip_resistance(tick->model, tip), .stops = true, .track = tip->track});
        return;
    }
    double reach = most_slip(state, points);
    add_tracks(tick, state, hand, path, ahead, reach);
    add_stops(tick, state, path, ahead, reach);
}

/* ---- the staircase ------------------------------------------------------------------------------------------------- */

static void add_knot(resistance_ahead *ahead, staircase *climb, double at, double level, double slope, int stretch) {
    if (climb->count == MAX_KNOTS) return;
    climb->at[climb->count] = at;
    climb->level[climb->count] = level;
    climb->slope[climb->count] = slope;
    ahead->of_knot[climb->count++] = stretch;
}

/* The staircase is the largest resistance met so far, which makes it monotone: the force that punctures a membrane persists until the tissue's resistance
   exceeds it. The membrane itself is punctured in the next step. */
void resistance_ahead_climb(const tick_input *tick, const insertion_state *state, const contact_points *points, resistance_ahead *ahead, double work_of_hold,
                            staircase *climb) {
    vec3 force = state->tip.solved.force, needle = needle_along(&points->list[points->count - 1].at);
    double tissue = 0.0, slope = 0.0; /* resistance of the tissue (N) and its slope (N/m) */
    double cutting = 0.0;             /* N, resistance of the tissue without viscosity */
    double held = 0.0;                /* N, resistance of the obstacles */
    double at = 0.0;                  /* m, slip reached */
    climb->count = 0;
    climb->back = 0.0;
    for (int k = 0; k < ahead->count && isfinite(held); k++) {
        const stretch_ahead *s = &ahead->stretches[k];
        double end = k + 1 < ahead->count ? ahead->stretches[k + 1].from : INFINITY;
        tissue += slope * (s->from - at);
        at = s->from;
        if (s->stops) {
            held = fmax(held, s->resistance);
        } else {
            double resistance = old_tracks_bound(&s->track, force, needle, s->resistance) + work_of_hold;
            tissue += fmax(resistance - cutting, 0.0);
            cutting = fmax(cutting, resistance);
            slope = s->viscosity / tick->dt;
        }
        add_knot(ahead, climb, at, fmax(tissue, held), tissue >= held ? slope : 0.0, k);
        double equal = at + (held - tissue) / slope; /* m, slip at which the tissue's resistance reaches the obstacle's */
        if (tissue < held && equal < end) add_knot(ahead, climb, equal, held, slope, k);
    }
}

open_track resistance_ahead_track(const resistance_ahead *ahead, const contact_problem *problem) {
    int piece = problem->knot > 0 && problem->state[problem->climber] != SLIP_FORWARD ? problem->knot - 1 : problem->knot;
    return ahead->stretches[ahead->of_knot[piece]].track;
}
