#include "insertion/laws/along_track.h"

/* Against lateral motion of the tip, the end face and the adjacent shaft act like two springs in parallel. */
track_shares along_track(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i) {
    const contact_point *p = &points->list[i];
    vec3 track = m3_apply_transposed(&p->at.frame, point_track(state, p));
    int count = points->count, along = unknown(count, i, 2);
    bool tip = p->kind == POINT_TIP;
    double sideways = tip ? tissue->sideways_on_shaft : 1.0;
    return (track_shares){{unknown(count, i, 0), unknown(count, i, 1), along, along + 1}, {0, 1, 2, 2}, 3 + tip,
                          {sideways, sideways, !tip, tip}, {1.0 - sideways, 1.0 - sideways, tip, 0.0}, {track.x, track.y, track.z, track.z}};
}

/* Returns the force (N) along the track on the shaft next to the tip: the part of the tip's lateral force that the shaft bears, plus the friction along the
   needle. */
static double on_tip_shaft(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int t) {
    const contact_point *p = &points->list[t];
    const needle_tip *tip = &state->tip;
    vec3 needle = needle_along(&p->at), sideways = v3_axpy(-v3_dot(needle, tip->solved.force), needle, tip->solved.force);
    double friction = tip->shaft.traction * (p->share.to - p->share.from);
    return tissue->sideways_on_shaft * v3_dot(sideways, tip->place.direction) + friction * v3_dot(needle, tip->place.direction);
}

double force_on_shaft(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i) {
    const contact_point *p = &points->list[i];
    return p->kind == POINT_TIP ? on_tip_shaft(state, points, tissue, i) : v3_dot(point_track(state, p), point_force(state, p));
}

double force_on_face(const insertion_state *state, const contact_points *points, const tissue_step *tissue) {
    const needle_tip *tip = &state->tip;
    return v3_dot(tip->place.direction, tip->solved.force) - on_tip_shaft(state, points, tissue, points->count - 1);
}
