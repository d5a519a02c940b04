/* Derivatives of a step's results, for controllers, planners and parameter fits. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_DERIVATIVES_H
#define TROCAR_PUBLIC_DERIVATIVES_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Property of a region, as in trocar_material. */
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
    int32_t region;          /* index of a region that is a volume */
} trocar_parameter;

enum { TROCAR_MAX_PARAMETERS = 58, TROCAR_BASE_VARIABLES = 6 };

/* What to differentiate. The variables are numbered: 0 to 2, displacement of the base along the world's axes (m); 3 to 5, rotation of the base about the
   world's axes through the base point (rad), applied after the given orientation; from 6 on, the parameters, in their units. V is the number of variables, T
   the number of targets. */
typedef struct trocar_derivative_request {
    const trocar_parameter *parameters;
    int parameter_count;     /* at most TROCAR_MAX_PARAMETERS */
    const double *targets;   /* [T][3], m: material points of the tissue, in the tissue at rest */
    int target_count;        /* T */
} trocar_derivative_request;

/* The caller's arrays for the results. Results whose array is NULL are not computed. A derivative's unit is the unit given below divided by that of the
   variable; vectors are in the world frame. */
typedef struct trocar_derivatives {
    double *wrench;          /* [6][V]: force (N) and torque (N m) on the hand, as in trocar_output */
    double *tip;             /* [3][V]: position (m) of the needle's end */
    double *direction;       /* [3][V]: direction of the needle's end, a unit vector */
    double *targets;         /* [T][3][V]: positions (m) of the targets */
    double *range;           /* [6], m and rad: for each of the 6 variables of the base, the smallest change, up or down, at which a contact would start or stop
                                sliding, by linear extrapolation; INFINITY if none would */
} trocar_derivatives;

/* Computes a step as trocar_sim_step does, with the same results, and the derivatives of its results. The state before the step is kept fixed: only this step
   is differentiated. Contacts keep sticking or sliding as they do in this step; where one switches, derivatives jump (`range`). They also jump at events
   (trocar_output.events), and are exact only for an exact equilibrium: the smaller the scene's "contact.tolerance", the closer they are to finite differences.
   Forces of other needles and of the probe are kept fixed. Each target takes three solves with the full stiffness matrix, and each modulus one. Errors as in
   trocar_sim_step. Before the step, also BAD_INPUT for dt above 1 ms, a target outside the mesh, a parameter out of range, and moduli that are still changing.
   After the step, which has then been carried out, also NUMERIC if its result was not finite or has no derivative. NO_MEMORY. `request` may be NULL.
   [alone, allocates] */
TROCAR_API trocar_status trocar_sim_differentiate(trocar_sim *sim, int needle, const trocar_pose *base, double dt, const trocar_derivative_request *request,
                                                  trocar_output *output, const trocar_derivatives *derivatives, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
