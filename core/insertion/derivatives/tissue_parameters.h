/* How the contact problem changes with tissue properties, at fixed forces and slips. */
#ifndef TROCAR_TISSUE_PARAMETERS_H
#define TROCAR_TISSUE_PARAMETERS_H

#include "insertion/derivatives/contact_rows.h"

typedef enum { CUTTING_FORCE, CUTTING_VISCOSITY, FRICTION_STATIC, FRICTION_KINETIC, FRICTION_VISCOUS, YOUNGS_MODULUS, PROPERTIES } region_property;

/* A property of a region. */
typedef struct {
    region_property property;
    int region;              /* group index */
} tissue_parameter;

/* Returns the derivative with respect to the property of the force in a row whose point slides along the needle. `piece`: piece of the staircase on which the
   tip slides. */
double resistance_change(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const tissue_parameter *parameter, int row, int piece);

/* Computes the derivatives of all gaps (m / Pa) with respect to a region's Young's modulus. `moved` (m / Pa): derivative of the nominal mesh's displacement at
   each point. Returns false if out of memory. */
bool stiffen(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const point_forces *forces, int region, const vec3 moved[MAX_POINTS],
             double gaps[MAX_UNKNOWNS]);

#endif
