/* Local compliance: the part of a contact's yielding between the needle's radius and the radius that the mesh resolves.
   See README.md, "Local compliance". */
#ifndef TROCAR_LOCAL_H
#define TROCAR_LOCAL_H

#include "insertion.h"

typedef struct {
    double lateral, axial;   /* m^2/N: divide by the share of length */
    double point;            /* m/N: at the tip, along the axis */
} local_compliance;

/* At point x of nominal element `tet`; continuous across elements. */
local_compliance local_at(const insertion_model *model, int tet, vec3 x);

#endif
