/* Roll: friction of the shaft against turning about its axis, and how far the tip lags behind the base. See docs/mechanics.md, "Roll". */
#ifndef TROCAR_ROLL_H
#define TROCAR_ROLL_H

#include "insertion/state/tick.h"

/* What a bound that is shared by sliding and turning leaves to one of them. */
typedef struct {
    double bound;                /* N or N m */
    double viscosity;            /* N/m or N m/rad: how the force grows with the slip, as the direction of slip turns */
} shared_bound;

/* For sliding along the needle: `dry` N in all, of a shaft that slid by `slip` (m) while it turned. RT */
shared_bound roll_bound_for_sliding(double dry, double slip, const roll_friction *roll, double radius);

/* For turning: the force along the needle is `along`, N. RT */
shared_bound roll_bound_for_turning(double dry, double slip, double along, const roll_friction *roll, double radius);

/* Length of the way that the shaft's surface has slid, m. RT */
double roll_slip_length(double slip, const roll_friction *roll, double radius);

/* The base turns with its pose: adds its turn about the needle's axis, which the tip does not follow yet. Before needle_move_base. RT */
void roll_follow_base(insertion_state *state, quat orientation);

/* Turns the shaft: torques, slip and the tip's lag after the solve of this step. RT */
void roll_solve(const tick_input *tick, insertion_state *state, const contact_points *points, const creep_step *creep);

/* Sum of the torques of all points on the tissue, N m, about the needle's axis. RT */
double roll_torque(const insertion_state *state, const contact_points *points);

#endif
