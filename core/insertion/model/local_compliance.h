/* Local compliance: the part of a contact's compliance due to the displacement field between the needle's radius and the radius that the mesh resolves. See
   docs/mechanics.md, "Local compliance". */
#ifndef TROCAR_LOCAL_COMPLIANCE_H
#define TROCAR_LOCAL_COMPLIANCE_H

#include "base/lame.h"
#include "insertion/model/insertion_model.h"
#include "linalg/plane_tensor.h"
#include "tissue/resolved_radius.h"

/* One value for forces across the needle, one for forces along it. */
typedef struct {
    double lateral, axial;
} lateral_axial;

/* The local compliance to a line force (m^2/N; divide by the length of shaft that the point stands for) is a material factor times a logarithm. The material
   factor, m^2/N, follows from Kelvin's line force in plane strain (across the needle) and from anti-plane shear (along it). This function returns its inverse,
   N/m^2. */
static inline lateral_axial local_line_stiffness(const region_material *material) { /* RT */
    double nu = material->poisson_ratio, axial = 2.0 * M_PI * shear_modulus(material->youngs_modulus, nu);
    return (lateral_axial){axial * 4.0 * (1.0 - nu) / (3.0 - 4.0 * nu), axial};
}

/* Returns ln(resolved radius / needle radius); across the needle, averaged over the directions. */
lateral_axial local_logarithm(const insertion_model *model, const resolved_field *resolved); /* RT */

/* Returns ln(resolved radius / needle radius) for each direction across an infinitely long needle. No lower limit is applied. RT */
plane_tensor local_logarithm_across(const insertion_model *model, const resolved_field *resolved, vec3 direction);

/* Returns ln(resolved radius / needle radius) across a needle whose tip is `ahead` (m) in front of the point; positive definite. RT */
plane_tensor local_logarithm_behind_tip(plane_tensor endless, const line_end *end, double ahead);

/* Returns the typical resolution of an element of this size, to use until it has been measured. RT */
resolved_field local_resolution_guess(const insertion_model *model, int tet);

/* The tip's end face, modelled as a disc `depth` (m) below the surface that is pushed with `push` (N). RT */
typedef struct {
    double compliance;       /* m/N, compliance of the disc due to all tissue around it */
    double angle;            /* solid angle of the tissue around the disc, steradians */
    double softness;         /* m^2/N, 1 / mu of the tissue; 0 on bone */
    double stiffening;
} local_disc;
local_disc local_disc_at_tip(const insertion_model *model, int tet, vec3 x, double depth, double push);

/* Returns the local compliance (m/N) along the needle at the tip to a force on the end face alone. `point` is resolved_field.point at the tip. RT */
double local_at_tip(const insertion_model *model, int tet, vec3 x, double depth, double push, double point);

/* Returns the speed of shear waves, m/s. RT */
double local_wave_speed(const insertion_model *model, int tet, vec3 x);

/* Allocates `local` for a model whose other members are set, and fills it with averages over the elements around each node. Sets `next` to `local`, `weight` to
   0, and `stiffens`. NO_MEMORY. */
trocar_status local_create(insertion_model *model, trocar_error *why);
void local_free(insertion_model *model);

#endif
