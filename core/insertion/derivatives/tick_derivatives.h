/* Derivatives of a step's results with respect to the pose of the base: forward sensitivities of the equilibrium that the step has found, for a fixed set of
   sticking and sliding contacts. See docs/mechanics.md, "Derivatives". */
#ifndef TROCAR_TICK_DERIVATIVES_H
#define TROCAR_TICK_DERIVATIVES_H

#include "insertion/state/tick_data.h"

/* Variables: displacement (m) of the base along the world's axes, and rotation (rad) of the base about them. */
enum { BASE_VARIABLES = 6 };

/* Derivatives with respect to one variable, per m or rad; world frame. */
typedef struct {
    vec3 force, torque;      /* N, N m: on the hand */
    vec3 tip;                /* m: position of the needle's end */
    vec3 direction;          /* direction of the needle's end, a unit vector */
    vec3 load[MAX_POINTS];   /* N: forces that displace the nominal mesh as much as the needle does at each point; 0 for guides */
    double range;            /* m or rad: smallest change of the variable, up or down, at which a contact switches, extrapolated linearly; INFINITY if none does */
} variable_derivatives;

typedef struct {
    int count;
    variable_derivatives of[BASE_VARIABLES];
} tick_derivatives;

/* Computes the derivatives of the last step, which must have been the only step of its tick. `tick`, `state` and `workspace` are those of that tick, after
   it. The state before the tick is kept fixed. NO_MEMORY; NUMERIC if the equilibrium has no unique derivative. Allocates. */
trocar_status insertion_differentiate(const tick_input *tick, const insertion_state *state, const insertion_workspace *workspace, tick_derivatives *derivatives, report *why);

#endif
