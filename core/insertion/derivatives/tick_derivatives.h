/* Derivatives of a step's results with respect to the pose of the base and to properties of the tissue: forward sensitivities of the equilibrium found by the
   step, for a fixed set of sticking and sliding contacts. See docs/mechanics.md, "Derivatives". */
#ifndef TROCAR_TICK_DERIVATIVES_H
#define TROCAR_TICK_DERIVATIVES_H

#include "insertion/derivatives/tissue_parameters.h"

/* Variables: displacement (m) of the base along the world's axes, and rotation (rad) of the base about them. */
enum { BASE_VARIABLES = 6, MAX_VARIABLES = 64 };

/* Derivatives with respect to one variable; world frame. */
typedef struct {
    vec3 force, torque;      /* N, N m: on the hand */
    vec3 tip;                /* m: position of the needle's end */
    vec3 direction;          /* direction of the needle's end, a unit vector */
    vec3 load[MAX_POINTS];   /* N: forces that displace the nominal mesh as much as the needle does at each point; 0 for guides */
    double range;            /* m or rad, only for the pose of the base: smallest change in either direction at which a contact switches between sticking and
                                sliding, by linear extrapolation */
} variable_derivatives;

typedef struct {
    int count;                                              /* number of variables: BASE_VARIABLES plus the number of parameters */
    tissue_parameter parameters[MAX_VARIABLES - BASE_VARIABLES]; /* in */
    vec3 moved[MAX_VARIABLES - BASE_VARIABLES][MAX_POINTS]; /* in, for moduli: m / Pa, derivative of the nominal mesh's displacement at each point under the
                                                               present forces */
    variable_derivatives of[MAX_VARIABLES];                 /* out */
} tick_derivatives;

/* Computes the derivatives of the last step, which must have been the only step of its tick. `tick`, `state` and `workspace`: as they are after that tick.
   The state before the tick is held constant. The caller sets the members of `derivatives` that are marked "in". NO_MEMORY; NUMERIC if the equilibrium has no
   unique derivative. Allocates. */
trocar_status insertion_differentiate(const tick_input *tick, const insertion_state *state, const insertion_workspace *workspace, tick_derivatives *derivatives, trocar_error *why);

#endif
