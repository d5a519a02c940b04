#include "insertion/track/old_tracks.h"

#include "insertion/track/obstacle.h"

static const double FADE = 1.5; /* ratio, above 1: openness falls from 1 at the distance or angle limit to 0 at this multiple of the limit. Chosen by
                                   judgement */
static const double CATCH_UP = 4.0; /* needle diameters: as a tip beside a track travels this far, its distance from the track falls by a factor of e. Chosen by
                                       judgement */
static const double CLOSED = 1e-5; /* m: a tip this close to the end of a track has reached it. Rounding tolerance */

/* Returns 1 up to the limit, falling to 0 at FADE times the limit. */
static double fade(double value, double limit) { return fmin(fmax((FADE - value / limit) / (FADE - 1.0), 0.0), 1.0); }

static double reach_of(const insertion_model *model) { return model->settings.track_reach * 2.0 * model->needle->radius; }

/* ---- recording ----------------------------------------------------------------------------------------------------------- */

static void note_dropped(tick_output *output, bool room) {
    if (!room) output->events |= EVENT_TRACK_DROPPED;
}

void old_tracks_cut(insertion_state *state, tick_output *output, int tet, vec3 from) {
    const needle_tip *tip = &state->tip;
    if (tip->track.openness == 1.0 || v3_norm(v3_sub(tip->place.nominal, from)) == 0.0) return;
    note_dropped(output, tracks_cut(&state->tracks, (track_point){.at = from, .tet = tet}, (track_point){.at = tip->place.nominal, .tet = tip->place.tet}));
}

void old_tracks_puncture(insertion_state *state, tick_output *output, int membrane) {
    const needle_tip *tip = &state->tip;
    note_dropped(output, tracks_puncture(&state->tracks, (track_point){.at = tip->place.nominal, .tet = tip->place.tet}, membrane));
}

/* ---- what is open -------------------------------------------------------------------------------------------------------- */

/* Returns a track list: the needle's own for index 0, then those of the other needles; NULL after the last. */
static const track_list *list_of(const tick_input *tick, const insertion_state *state, int index) {
    if (index == 0) return &state->tracks;
    return index <= tick->other_count ? tick->others[index - 1] : NULL;
}

/* Returns how open this membrane is at x (0 to 1). Openness falls with the distance from the nearest puncture just as a track's falls with the distance from
   the track. */
static double membrane_open(const tick_input *tick, const insertion_state *state, int membrane, vec3 x) {
    double reach = reach_of(tick->model), closest = INFINITY;
    const track_list *list;
    for (int i = 0; (list = list_of(tick, state, i)) && reach > 0.0; i++) closest = fmin(closest, tracks_puncture_distance(list, membrane, x, FADE * reach));
    return isinf(closest) ? 0.0 : fade(closest, reach);
}

int old_tracks_obstacle(const tick_input *tick, const insertion_state *state, int tet, int face, int behind, vec3 x) {
    int found = obstacle(tick->model, tet, face, behind);
    return found >= 0 && membrane_open(tick, state, found, x) == 1.0 ? NOT_BLOCKED : found;
}

double old_tracks_damage(const tick_input *tick, const insertion_state *state, int blocked_by, vec3 x) {
    return blocked_by >= 0 ? membrane_open(tick, state, blocked_by, x) : 0.0;
}

/* A track that the tip may follow. */
typedef struct {
    double openness, distance, to_end;
    vec3 direction;
} candidate;

/* Rates how open this track is to the tip, which may follow it either way. */
static candidate judge(const insertion_model *model, const track_list *list, int track, vec3 x, vec3 direction) {
    double reach = reach_of(model);
    track_place place = tracks_closest(list, track, x, FADE * reach);
    if (isinf(place.distance)) return (candidate){.openness = 0.0};
    bool forward = v3_dot(place.along, direction) >= 0.0;
    vec3 along = v3_scale(forward ? 1.0 : -1.0, place.along);
    double to_end = forward ? place.ahead : place.behind, angle = acos(fmin(v3_dot(along, direction), 1.0));
    if (to_end <= CLOSED) return (candidate){.openness = 0.0};
    vec3 aside = v3_sub(place.point, x);
    aside = v3_axpy(-v3_dot(aside, along), along, aside);
    return (candidate){.openness = fade(place.distance, reach) * fade(angle, model->settings.track_angle), .distance = place.distance, .to_end = to_end,
                       .direction = v3_unit(v3_axpy(1.0 / (CATCH_UP * 2.0 * model->needle->radius), aside, along))};
}

open_track old_tracks_ahead(const tick_input *tick, const insertion_state *state, const path_step *path, double beyond) {
    const needle_tip *tip = &state->tip;
    vec3 direction = path->cut_direction;
    candidate best = {.openness = 0.0, .direction = v3(0, 0, 0)};
    const track_list *list;
    bool searched = tip->place.phase == TIP_INSIDE && tick->model->settings.track_reach > 0.0;
    for (int i = 0; searched && (list = list_of(tick, state, i)); i++)
        for (int track = 0; track < list->count; track++) {
            candidate c = judge(tick->model, list, track, tip->place.nominal, direction);
            if (c.to_end <= beyond) continue;
            if (c.openness > best.openness || (c.openness == best.openness && c.openness > 0.0 && c.distance < best.distance)) best = c;
        }
    open_track found = {.openness = best.openness, .direction = best.direction, .to_end = best.to_end};
    if (found.openness > 0.0) found.tilt = v3_sub(old_tracks_lead(&found, direction), direction);
    return found;
}

/* ---- following ------------------------------------------------------------------------------------------------------------- */

vec3 old_tracks_lead(const open_track *track, vec3 direction) {
    if (track->openness == 0.0) return direction;
    return v3_unit(v3_axpy(track->openness, v3_sub(track->direction, direction), direction));
}

/* A tip guided sideways by u per metre of advance does the work f . u per metre, where f is the lateral force on the needle. The track's wall is frictionless,
   so the hand must do this work; a step then never returns more energy than it received. */
double old_tracks_bound(const open_track *track, vec3 tip_force, vec3 needle, double resistance) {
    if (track->openness == 0.0) return resistance;
    vec3 across = v3_axpy(-v3_dot(tip_force, needle), needle, tip_force);
    return fmax(resistance - v3_dot(across, track->tilt), 0.0);
}
