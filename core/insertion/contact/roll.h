/* Roll: friction between tissue and a shaft that rotates about its axis, and the angle by which the tip lags the base. See docs/mechanics.md, "Roll". */
#ifndef TROCAR_ROLL_H
#define TROCAR_ROLL_H

#include "insertion/state/tick_data.h"

/* The part of a common friction bound that is available to one motion, sliding or turning. */
typedef struct {
    double bound;                /* N for sliding, N m for turning */
    double viscosity;            /* N/m or N m/rad: rate at which the force grows with the slip, because the direction of the slip changes */
} shared_bound;

/* Bound on the force along the needle, for a shaft with the total bound `dry` (N) that slid by `slip` (m) while it turned. RT */
shared_bound roll_bound_for_sliding(double dry, double slip, const roll_friction *roll, double radius);

/* Bound on the torque, while the force along the needle is `along` (N). RT */
shared_bound roll_bound_for_turning(double dry, double slip, double along, const roll_friction *roll, double radius);

/* Distance (m) that the shaft's surface has slid, along the needle and around it. RT */
double roll_slip_length(double slip, const roll_friction *roll, double radius);

/* Adds the base's rotation about the needle's axis; the tip does not follow yet. To be called before needle_move_base. RT */
void roll_follow_base(insertion_state *state, quat orientation);

/* Solves for the shaft's rotation after the contact problem of this step: torques, rotational slips and the tip's lag. RT */
void roll_solve(const tick_input *tick, insertion_state *state, const contact_points *points, const creep_step *creep);

/* Torque (N m) about the needle's axis that all points together exert on the tissue. RT */
double roll_torque(const insertion_state *state, const contact_points *points);

/* Derivative of roll_torque with respect to the base's rotation (N m / rad), as long as no point switches between sticking and sliding. RT */
double roll_stiffness(const tick_input *tick, const insertion_state *state, const contact_points *points, const creep_step *creep);

#endif
