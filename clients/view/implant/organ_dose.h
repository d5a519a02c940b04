/* The dose in an organ in four states: as planned, at present, with the needles out, and once the gland's swelling has gone. */
#ifndef TROCAR_ORGAN_DOSE_H
#define TROCAR_ORGAN_DOSE_H

#include <stdbool.h>

#include "base/error.h"
#include "trocar.h"

typedef enum {
    DOSE_PLANNED,            /* planned seeds, undeformed tissue */
    DOSE_NOW,                /* seeds and voxels in the deformed tissue */
    DOSE_NEEDLES_OUT,        /* seeds and voxels in the undeformed tissue */
    DOSE_SWELLING_GONE,      /* like DOSE_NEEDLES_OUT, but with the gland and its seeds shrunk uniformly about the gland's centre */
    DOSE_STATES
} dose_state;

enum { DVH_POINTS = 101 };   /* points of a dose-volume histogram, for doses from 0 to DVH_TOP */
#define DVH_TOP 3.0          /* highest dose in a histogram, as a multiple of the prescription */

typedef struct {
    bool known;
    trocar_dvh_summary summary;
    double curve[DVH_POINTS]; /* fraction of the volume that gets at least the dose of each point */
} organ_result;

/* How a gland shrinks: lengths are multiplied by `scale` about the centre. */
typedef struct { double centre[3], scale; } shrinkage;

typedef struct {
    const char *name;        /* name of the organ's region */
    bool is_target, shrinks; /* `shrinks`: the organ shrinks with the gland */
    trocar_structure *structure;
    double low[3], high[3];  /* m, box in the undeformed tissue; voxels outside it do not count */
    double *points, *doses;  /* scratch */
    organ_result results[DOSE_STATES];
} organ;

/* Divides a region of `mesh` into 1 mm voxels. Needs the mesh only during this call. Returns the errors of trocar_structure_from_region. */
trocar_status organ_create(organ *o, const trocar_model *m, const trocar_mesh *mesh, int region, trocar_error *why);
void organ_free(organ *o);

/* Computes the mean of the voxel centres. */
void organ_centre(const organ *o, double centre[3]);

/* From now on, counts only voxels inside the bounding box of another organ. For the urethra, of which only the prostatic part is judged. */
void organ_limit(organ *o, const organ *other);

/* True if a point of the undeformed tissue lies in the organ, to within one voxel. */
bool organ_contains(const organ *o, const double point[3]);

/* Computes the results for one state. `seeds` are the seeds at their positions in that state. `nodal`, used for DOSE_NOW, are the displacements [nodes][3], or
   NULL for undeformed tissue. `shrunk` is used for DOSE_SWELLING_GONE. */
void organ_compute(organ *o, dose_state state, const trocar_dose_source *source, const trocar_dose_seed *seeds, int count, double prescription,
                   const double *nodal, const shrinkage *shrunk);

void shrink(const shrinkage *s, const double from[3], double to[3]);

#endif
