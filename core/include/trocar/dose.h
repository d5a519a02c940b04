/* Dose of brachytherapy seeds, from the line-source formula of AAPM TG-43U1 (Rivard et al., Med. Phys. 31, 2004; see docs/dose.md). The formula treats the
   patient as water and ignores shielding between seeds. Doses are in Gy, dose rates in Gy/h, air-kerma strengths in U (1 U = 1 cGy cm^2/h). Nothing here
   needs a scene or a model. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_DOSE_H
#define TROCAR_PUBLIC_DOSE_H

#include "trocar/scene.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- sources ---- */

/* The TG-43 data for one type of seed. Immutable. */
typedef struct trocar_dose_source trocar_dose_source;

/* Loads the TG-43U1 consensus data for "I-125 6711" or "Pd-103 200". BAD_INPUT for any other name; NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_dose_source_create(const char *name, trocar_dose_source **source, trocar_error *error);

/* Loads TG-43 data from a YAML file; docs/dose.md lists its keys. BAD_INPUT, naming file, line and remedy; NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_dose_source_load(const char *path, trocar_dose_source **source, trocar_error *error);
TROCAR_API void trocar_dose_source_free(trocar_dose_source *source); /* call it only after freeing all doses that use the source. [any] */

typedef struct trocar_dose_source_data {
    char name[64];
    double dose_rate_constant;   /* Lambda, cGy/(h U) */
    double active_length;        /* m, length of the line source */
    double capsule_length, capsule_diameter; /* m, outer dimensions */
    double half_life;            /* s */
} trocar_dose_source_data;
TROCAR_API trocar_dose_source_data trocar_dose_source_get(const trocar_dose_source *source); /* [any, RT] */

/* Returns the ratio, in h, of the dose delivered in the first `hours` to the initial dose rate. If `hours` is INFINITY (a permanent implant), this is the
   half-life divided by ln 2; if negative, NAN. [any, RT] */
TROCAR_API double trocar_dose_hours(const trocar_dose_source *source, double hours);

typedef struct trocar_dose_seed {
    double position[3];          /* m, centre of the seed */
    double direction[3];         /* vector along the seed's axis, of any length except 0 */
    double strength;             /* U, air-kerma strength at the time of implantation; above 0 and at most 1000 */
} trocar_dose_seed;

/* Computes the total dose rate (Gy/h) from `seed_count` seeds at each of `count` points [count][3] (m). Takes 25 ns per point and seed. BAD_INPUT, writing
   nothing, if a seed or point is not finite or has a coordinate beyond 1000 m, or if a strength or direction is invalid. [any, RT] */
TROCAR_API trocar_status trocar_dose_rates(const trocar_dose_source *source, const trocar_dose_seed *seeds, int seed_count, const double *points,
                                           int64_t count, double *rates, trocar_error *error);

/* ---- dose of an implant ---- */

/* The dose of a permanent implant at many points. Doses are integer multiples of TROCAR_DOSE_QUANTUM, so sums are exact and don't depend on the order in
   which seeds are added and removed. */
typedef struct trocar_dose trocar_dose;
#define TROCAR_DOSE_QUANTUM 5.8207660913467407e-11 /* Gy: 2^-34 */
#define TROCAR_MAX_SEED_DOSE 131072.0                  /* Gy, largest dose that one seed contributes to a point: 2^17 */
enum { TROCAR_MAX_DOSE_SEEDS = 4095 };

/* Voxel (i, j, k), counted from 0, has the index (i counts[1] + j) counts[2] + k; its centre is at origin + spacing (i, j, k). */
typedef struct trocar_dose_grid {
    double origin[3];            /* m, centre of voxel (0, 0, 0) */
    double spacing;              /* m, greater than 0 */
    int32_t counts[3];           /* voxel counts along x, y and z; each is at least 1, and their product is at most 2^28 */
} trocar_dose_grid;

/* Create a dose that is initially zero, on a grid (8 bytes per voxel) or at up to 2^28 points [count][3] (m; 32 bytes per point). The source must outlive
   the dose. BAD_INPUT for an invalid grid or point; NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_dose_create(const trocar_dose_source *source, const trocar_dose_grid *grid, trocar_dose **dose, trocar_error *error);
TROCAR_API trocar_status trocar_dose_create_points(const trocar_dose_source *source, const double *points, int64_t count, trocar_dose **dose,
                                                   trocar_error *error);
TROCAR_API void trocar_dose_free(trocar_dose *dose); /* [one] */

/* Adds a seed. Takes 25 ns per point. `id` (may be NULL) receives a number that identifies the seed and is never reused. BAD_INPUT, changing nothing, if the
   seed is invalid or there are already TROCAR_MAX_DOSE_SEEDS seeds; NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_dose_add(trocar_dose *dose, const trocar_dose_seed *seed, int32_t *id, trocar_error *error);

/* Remove a seed, or change its position, direction and strength. BAD_INPUT, changing nothing, for an unknown id or an invalid seed. [one, RT] */
TROCAR_API trocar_status trocar_dose_remove(trocar_dose *dose, int32_t id, trocar_error *error);
TROCAR_API trocar_status trocar_dose_move(trocar_dose *dose, int32_t id, const trocar_dose_seed *seed, trocar_error *error);

/* Moves every point to its rest position plus its displacement [count][3] (m), or back to its rest position if `displacements` is NULL. Seeds do not move.
   BAD_INPUT, changing nothing, if a displacement is not finite or would move a point beyond 1000 m; NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_dose_displace(trocar_dose *dose, const double *displacements, trocar_error *error);

TROCAR_API int64_t trocar_dose_point_count(const trocar_dose *dose);         /* [one, RT] */
TROCAR_API int trocar_dose_seed_count(const trocar_dose *dose);              /* [one, RT] */
TROCAR_API void trocar_dose_values(const trocar_dose *dose, double *values); /* writes the doses of all points, in Gy. [one, RT] */

/* ---- structures ---- */

/* The voxels whose centres are inside an organ at rest. The coordinates of the centres are (n + 1/2) spacing for integer n. Immutable. */
typedef struct trocar_structure trocar_structure;

/* Finds the voxels inside surface number `surface`, or inside all triangles if the mesh has no triangle_surface. `spacing` in m. BAD_INPUT if the surface
   is open (the message names an edge), has no triangles or contains no voxel, if an index is out of range, or if the surface's bounding box has more than
   2^28 voxels; NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_structure_from_surface(const trocar_mesh *mesh, int surface, double spacing, trocar_structure **structure,
                                                       trocar_error *error);

/* Finds the voxels inside the tetrahedra of region number `region`, or inside all tetrahedra if the mesh has no tet_region. Errors as for
   trocar_structure_from_surface. [any, allocates] */
TROCAR_API trocar_status trocar_structure_from_region(const trocar_mesh *mesh, int region, double spacing, trocar_structure **structure,
                                                      trocar_error *error);
TROCAR_API void trocar_structure_free(trocar_structure *structure);                   /* [any] */
TROCAR_API int64_t trocar_structure_count(const trocar_structure *structure);         /* number of voxels, at least 1. [any, RT] */
TROCAR_API const double *trocar_structure_points(const trocar_structure *structure);  /* [count][3], m, voxel centres. [any, RT] */
TROCAR_API double trocar_structure_voxel(const trocar_structure *structure);          /* m^3, volume of a voxel. [any, RT] */

/* Interpolates nodal displacements (from trocar_view_displacements) to the voxel centres, giving the `displacements` [count][3] that trocar_dose_displace
   needs. BAD_INPUT for a structure made from a surface. [any, RT] */
TROCAR_API trocar_status trocar_structure_displacements(const trocar_structure *structure, const double *nodal, double *displacements,
                                                        trocar_error *error);

/* ---- dose-volume histograms ---- */

/* Sorts the doses of equal-sized voxels in place, in descending order, as the functions below require. BAD_INPUT if there are none or one is not finite.
   [any, RT] */
TROCAR_API trocar_status trocar_dvh_sort(double *doses, int64_t count, trocar_error *error);

/* Returns the largest dose (Gy) that at least this fraction (0 to 1) of the volume receives, interpolated linearly. A fraction of 0.9 gives D90. [any, RT] */
TROCAR_API double trocar_dvh_dose(const double *doses, int64_t count, double fraction);

/* Returns the fraction of the volume that receives at least `dose` (Gy). The prescribed dose gives V100; 1.5 times that dose gives V150. [any, RT] */
TROCAR_API double trocar_dvh_volume(const double *doses, int64_t count, double dose);

typedef struct trocar_dvh_summary {
    double volume_cm3;           /* cm^3 */
    double mean, minimum, maximum; /* Gy */
    double d10, d30, d80, d90;   /* Gy */
    double v100, v150, v200;     /* fractions of the volume that receive at least 100, 150 and 200 % of the prescription */
    double v100_cm3;             /* cm^3 */
} trocar_dvh_summary;

/* Computes the usual dose-volume metrics; voxel_volume in m^3, prescription in Gy. [any, RT] */
TROCAR_API trocar_dvh_summary trocar_dvh_summarise(const double *doses, int64_t count, double voxel_volume, double prescription);

#ifdef __cplusplus
}
#endif
#endif
