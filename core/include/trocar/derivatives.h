/* Derivatives of a step's results, for controllers, planners and parameter fits. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_DERIVATIVES_H
#define TROCAR_PUBLIC_DERIVATIVES_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A property of a region that results can be differentiated by; see trocar_material. */
typedef enum trocar_property {
    TROCAR_CUTTING_FORCE,      /* N */
    TROCAR_CUTTING_VISCOSITY,  /* N s/m */
    TROCAR_FRICTION_STATIC,    /* N/m */
    TROCAR_FRICTION_KINETIC,   /* N/m */
    TROCAR_FRICTION_VISCOUS,   /* N s/m^2 */
    TROCAR_YOUNGS_MODULUS      /* Pa; not for relaxing or stiffening tissue */
} trocar_property;

typedef struct trocar_parameter {
    int32_t property;        /* trocar_property */
    int32_t region;          /* index of a volume region */
} trocar_parameter;

enum { TROCAR_MAX_PARAMETERS = 58, TROCAR_BASE_VARIABLES = 6 };

/* What to differentiate by, and which targets to track. Variables 0 to 2 displace the base along the world axes (m). Variables 3 to 5 rotate it about the
   world axes through the base point (rad), applied after the given orientation. The parameters, in their own units, follow from 6 on. V is the number of
   variables, T the number of targets. */
typedef struct trocar_derivative_request {
    const trocar_parameter *parameters;
    int parameter_count;     /* at most TROCAR_MAX_PARAMETERS */
    const double *targets;   /* [T][3], m: rest positions of material points in the tissue */
    int target_count;        /* T */
} trocar_derivative_request;

/* Arrays, supplied by the caller, for the derivatives. NULL if a result is not wanted. Each derivative has the unit given below, divided by the variable's
   unit. Vectors are in the world frame. */
typedef struct trocar_derivatives {
    double *wrench;          /* [6][V]: force (N) and torque (N m) on the hand, as in trocar_output */
    double *tip;             /* [3][V]: position (m) of the needle's tip */
    double *direction;       /* [3][V]: unit vector along the needle at its tip */
    double *targets;         /* [T][3][V]: positions (m) of the targets */
    double *range;           /* [6], m and rad: for each of the 6 base variables, the smallest change in either direction at which, by linear extrapolation, a
                                contact would start or stop sliding; INFINITY if none would */
} trocar_derivatives;

/* Steps exactly as trocar_sim_step does, and differentiates the results. Only this step is differentiated: the state before it, and the forces of other
   needles and of the probe, are held fixed. Every contact is assumed to go on sticking or sliding as in this step. Derivatives jump where a contact switches
   (see `range`) and at events (trocar_output.events). They are exact only at an exact equilibrium: the smaller the scene's "contact.tolerance", the closer
   they are to finite differences. Each target costs three solves with the full stiffness matrix, each modulus one. `request` may be NULL.
   Errors as in trocar_sim_step. Also BAD_INPUT, before stepping, if dt exceeds 1 ms, a target is outside the mesh, a parameter is out of range, or moduli are
   still changing; NUMERIC, after stepping, if the result was not finite or has no derivative; and NO_MEMORY. [alone, allocates] */
TROCAR_API trocar_status trocar_sim_differentiate(trocar_sim *sim, int needle, const trocar_pose *base, double dt, const trocar_derivative_request *request,
                                                  trocar_output *output, const trocar_derivatives *derivatives, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
