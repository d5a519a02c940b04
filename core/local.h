/* Local compliance: the part of a contact's yielding between the needle's radius and the radius that the mesh resolves.
   See README.md, "Local compliance". */
#ifndef TROCAR_LOCAL_H
#define TROCAR_LOCAL_H

#include "insertion.h"

typedef struct {
    double lateral, axial;   /* m^2/N: divide by the share of length */
} local_compliance;

/* At point x of nominal element `tet`; continuous across elements. */
local_compliance local_at(const insertion_model *model, int tet, vec3 x);

/* Its two factors: of a line force per length in this material and per logarithm, m^2/N, and the logarithm, of the radius that
   the mesh resolves there over the needle's. For a contact that stays where it is and stands for shaft in several regions. */
local_compliance local_line_force(const region_material *material);
local_compliance local_logarithm(const insertion_model *model, int tet, vec3 x);

/* What a contact node yields already by being in the mesh, on average, m/N. */
double local_surplus(const insertion_model *model, int tet, vec3 x);

/* Local compliance of a contact, m/N. stiffness: lengths of its share, each over the line force's compliance there, N/m. */
double local_of_share(double logarithm, double stiffness, double surplus);

/* Of the tip along the needle, m/N, under the force on its end face alone, `depth` (m) below the surface. */
double local_at_tip(const insertion_model *model, int tet, vec3 x, double depth);

/* Fills the model's node_ arrays: means over the elements around each node. NO_MEMORY. */
trocar_status local_create(insertion_model *model, report *why);
void local_free(insertion_model *model);

#endif
