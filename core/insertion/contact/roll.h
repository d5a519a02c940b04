/* Roll: friction on a shaft that rotates about its axis, and how far the tip lags behind the base. See docs/mechanics.md, "Roll". */
#ifndef TROCAR_ROLL_H
#define TROCAR_ROLL_H

#include "insertion/state/tick_data.h"

/* Sliding and turning share one friction bound. This is the part available to one of the two. */
typedef struct {
    double bound;                /* N for sliding, N m for turning */
    double viscosity;            /* N/m or N m/rad: how fast the force grows with this slip, because the slip's direction changes */
} shared_bound;

/* Returns the bound on the force along the needle, for a shaft with the total bound `dry` (N) that slid by `slip` (m) while it turned. RT */
shared_bound roll_bound_for_sliding(double dry, double slip, const roll_friction *roll, double radius);

/* Returns the bound on the torque while the force along the needle is `along` (N). RT */
shared_bound roll_bound_for_turning(double dry, double slip, double along, const roll_friction *roll, double radius);

/* Returns how far (m) the shaft's surface has slid, along the needle and around it combined. RT */
double roll_slip_length(double slip, const roll_friction *roll, double radius);

/* Adds the base's rotation about the needle's axis to `base_turn`. The tip does not turn yet. Call this before needle_move_base. RT */
void roll_follow_base(insertion_state *state, quat orientation);

/* Finds torques, rotational slips and the tip's lag. Call this after solving the contact problem of the step. RT */
void roll_solve(const tick_input *tick, insertion_state *state, const contact_points *points, const creep_step *creep);

/* Returns the total torque (N m) of all points on the tissue about the needle's axis. RT */
double roll_torque(const insertion_state *state, const contact_points *points);

/* Returns the derivative of roll_torque with respect to the base's rotation (N m / rad), assuming that no point switches between sticking and sliding. RT */
double roll_stiffness(const tick_input *tick, const insertion_state *state, const contact_points *points, const creep_step *creep);

#endif
