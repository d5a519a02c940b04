/* Roll: friction of the shaft against rotation about its axis, and the lag of the tip behind the base. See docs/mechanics.md, "Roll". */
#ifndef TROCAR_ROLL_H
#define TROCAR_ROLL_H

#include "insertion/state/tick.h"

/* The share of one component, sliding or turning, in a common friction bound. */
typedef struct {
    double bound;                /* N or N m */
    double viscosity;            /* N/m or N m/rad: growth of the force with slip, as the direction of slip turns */
} shared_bound;

/* Bound for sliding along the needle; `dry` is the total bound, N, of a shaft that slid by `slip` (m) while it turned. RT */
shared_bound roll_bound_for_sliding(double dry, double slip, const roll_friction *roll, double radius);

/* Bound for turning; the force along the needle is `along`, N. RT */
shared_bound roll_bound_for_turning(double dry, double slip, double along, const roll_friction *roll, double radius);

/* Distance slid by the shaft's surface, m. RT */
double roll_slip_length(double slip, const roll_friction *roll, double radius);

/* Adds the base's rotation about the needle's axis, which the tip does not follow yet. Call before needle_move_base. RT */
void roll_follow_base(insertion_state *state, quat orientation);

/* Solves for the shaft's rotation after the contact problem of this step: torques, slips and the tip's lag. RT */
void roll_solve(const tick_input *tick, insertion_state *state, const contact_points *points, const creep_step *creep);

/* Sum of the torques of all points on the tissue about the needle's axis, N m. RT */
double roll_torque(const insertion_state *state, const contact_points *points);

#endif
