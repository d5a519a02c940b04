/* Local compliance: the part of a contact's yielding between the needle's radius and the radius that the mesh resolves.
   See docs/mechanics.md, "Local compliance". */
#ifndef TROCAR_LOCAL_COMPLIANCE_H
#define TROCAR_LOCAL_COMPLIANCE_H

#include "base/lame.h"
#include "insertion/state/insertion_model.h"
#include "linalg/plane_tensor.h"
#include "tissue/resolved_radius.h"

/* A quantity for forces across the needle, and for those along it. */
typedef struct {
    double lateral, axial;
} lateral_axial;

/* The local compliance of a line force, m^2/N (divide by the length that it stands for), has two factors: that of its material
   per logarithm, m^2/N, by Kelvin's line force in plane strain and by anti-plane shear: here its inverse, N/m^2, */
static inline lateral_axial local_line_stiffness(const region_material *material) { /* RT */
    double nu = material->poisson_ratio, axial = 2.0 * M_PI * shear_modulus(material->youngs_modulus, nu);
    return (lateral_axial){axial * 4.0 * (1.0 - nu) / (3.0 - 4.0 * nu), axial};
}

/* and the logarithm, of the radius that the mesh resolves there over the needle's; across it a mean, */
lateral_axial local_logarithm(const insertion_model *model, const resolved_field *resolved); /* RT */

/* or for each direction across, for an endless needle; not limited below. RT */
plane_tensor local_logarithm_across(const insertion_model *model, const resolved_field *resolved, vec3 direction);

/* That for shaft whose tip is `ahead` (m) of it; positive definite. RT */
plane_tensor local_logarithm_behind_tip(plane_tensor endless, const line_end *end, double ahead);

/* What meshes resolve in an element of this size, as a rule, where it has not been measured. RT */
resolved_field local_resolution_guess(const insertion_model *model, int tet);

/* The tip's end face, a disc `depth` (m) below the surface that it is pushed on with `push` (N). RT */
typedef struct {
    double compliance;       /* m/N, of the disc and all the tissue around it */
    double angle;            /* steradians that the tissue fills around it */
    double softness;         /* m^2/N, 1 / mu; 0 at bone */
    double stiffening;
} local_disc;
local_disc local_disc_at_tip(const insertion_model *model, int tet, vec3 x, double depth, double push);

/* Local compliance of the tip along the needle, m/N, under the force on that face alone. `point`: resolved_field.point there. RT */
double local_at_tip(const insertion_model *model, int tet, vec3 x, double depth, double push, double point);

/* Speed of shear waves, m/s. RT */
double local_wave_speed(const insertion_model *model, int tet, vec3 x);

/* Fills the node_ arrays of a model that is otherwise set: means over the elements around each node. NO_MEMORY. */
trocar_status local_create(insertion_model *model, report *why);
void local_free(insertion_model *model);

#endif
