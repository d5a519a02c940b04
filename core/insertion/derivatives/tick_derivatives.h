/* Derivatives of a step's results with respect to the pose of the base and to tissue properties. They are forward sensitivities of the equilibrium that the
   step found, assuming that no contact switches between sticking and sliding. See docs/mechanics.md, "Derivatives". */
#ifndef TROCAR_TICK_DERIVATIVES_H
#define TROCAR_TICK_DERIVATIVES_H

#include "insertion/derivatives/tissue_parameters.h"

/* The first six variables are displacements (m) of the base along the world's axes and rotations (rad) about them. */
enum { BASE_VARIABLES = 6, MAX_VARIABLES = 64 };

/* Derivatives with respect to one variable; world frame. */
typedef struct {
    vec3 force, torque;      /* N, N m: on the hand */
    vec3 tip;                /* m: position of the needle's end */
    vec3 direction;          /* direction of the needle's end, a unit vector */
    vec3 load[MAX_POINTS];   /* N: forces that displace the nominal mesh as much as the needle does at each point; 0 for guides */
    double range;            /* m or rad, only for the base's pose: smallest change, in either direction, at which a contact switches between sticking and
                                sliding, extrapolated linearly */
} variable_derivatives;

typedef struct {
    int count;                                              /* number of variables: BASE_VARIABLES plus the parameters */
    tissue_parameter parameters[MAX_VARIABLES - BASE_VARIABLES]; /* in */
    vec3 moved[MAX_VARIABLES - BASE_VARIABLES][MAX_POINTS]; /* in, only for moduli: m / Pa, derivative of the nominal mesh's displacement at each point under
                                                               the present forces */
    variable_derivatives of[MAX_VARIABLES];                 /* out */
} tick_derivatives;

/* Computes the derivatives of the last step, which must have been the only step of its tick. `tick`, `state` and `workspace` must be as that tick left them.
   The state before the tick is held constant. The caller sets the members of `derivatives` marked "in". NO_MEMORY; NUMERIC if the equilibrium has no unique
   derivative. Allocates. */
trocar_status insertion_differentiate(const tick_input *tick, const insertion_state *state, const insertion_workspace *workspace, tick_derivatives *derivatives, trocar_error *why);

#endif
