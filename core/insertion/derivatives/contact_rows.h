/* Rows of the contact problem, the points they belong to, and the forces in the points' frames. */
#ifndef TROCAR_CONTACT_ROWS_H
#define TROCAR_CONTACT_ROWS_H

#include "insertion/contact/roll.h"

/* Returns the distance (m) slid since the shaft last stuck, including the last step. */
static inline double slid_distance(const tick_input *tick, const insertion_state *state, const contact_point *point) {
    const shaft_hold *shaft = point_shaft(state, point);
    return shaft->slid + roll_slip_length(shaft->slip, &shaft->roll, tick->model->needle->radius);
}

/* Returns the fraction of the friction that acts along the needle (-1 to 1, signed), for a shaft that slides by `slip` (m) while it turns. */
static inline double part_along(const tick_input *tick, const insertion_state *state, const contact_point *point, double slip) {
    double way = roll_slip_length(slip, &point_shaft(state, point)->roll, tick->model->needle->radius);
    return way > 0.0 ? slip / way : 0.0;
}

typedef struct {
    double at[MAX_POINTS][3]; /* N, force on the body at each point, in the point's frame */
    double face, shaft;       /* N, the tip's forces along the needle: on the end face and on the adjacent shaft */
} point_forces;

static inline point_forces point_forces_of(const insertion_state *state, const contact_points *points) {
    point_forces forces = {.face = 0.0};
    for (int i = 0; i < points->count; i++) {
        vec3 f = m3_apply_transposed(&points->list[i].at.frame, point_force(state, &points->list[i]));
        forces.at[i][0] = f.x, forces.at[i][1] = f.y, forces.at[i][2] = f.z;
    }
    if (!points->tip) return forces;
    const contact_point *tip = &points->list[points->count - 1];
    forces.shaft = state->tip.shaft.traction * (tip->share.to - tip->share.from);
    forces.face = forces.at[points->count - 1][2] - forces.shaft;
    return forces;
}

#endif
