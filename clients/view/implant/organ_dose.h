/* The dose in an organ in four states: as planned, at present, with the needles out, and after the gland's swelling has subsided. */
#ifndef TROCAR_ORGAN_DOSE_H
#define TROCAR_ORGAN_DOSE_H

#include <stdbool.h>

#include "base/error.h"
#include "trocar.h"

typedef enum {
    DOSE_PLANNED,            /* dose of the plan's seeds, in the tissue at rest */
    DOSE_NOW,                /* dose for seeds and voxels in the displaced tissue */
    DOSE_NEEDLES_OUT,        /* dose for seeds and voxels in the tissue at rest */
    DOSE_SWELLING_GONE,      /* same as DOSE_NEEDLES_OUT, but after the gland and its seeds have shrunk uniformly about the gland's centre */
    DOSE_STATES
} dose_state;

enum { DVH_POINTS = 101 };   /* number of points of a dose-volume histogram, for doses from 0 to DVH_TOP */
#define DVH_TOP 3.0          /* upper end of a histogram's doses, as a multiple of the prescription */

typedef struct {
    bool known;
    trocar_dvh_summary summary;
    double curve[DVH_POINTS]; /* fraction of the volume that receives at least the dose of each point */
} organ_result;

/* Shrinkage of a gland: lengths are multiplied by `scale`, and the centre stays fixed. */
typedef struct { double centre[3], scale; } shrinkage;

typedef struct {
    const char *name;        /* name of the region that represents the organ */
    bool is_target, shrinks; /* `shrinks` is true if the organ shrinks together with the gland */
    trocar_structure *structure;
    double *points, *doses;  /* scratch */
    organ_result results[DOSE_STATES];
} organ;

/* Divides a region of `mesh` into voxels of 1 mm; the mesh is needed for this call only. Errors as in trocar_structure_from_region. */
trocar_status organ_create(organ *o, const trocar_model *m, const trocar_mesh *mesh, int region, trocar_error *why);
void organ_free(organ *o);

/* Computes the mean position of the voxels' centres. */
void organ_centre(const organ *o, double centre[3]);

/* True if a point at rest lies in the organ, with an accuracy of one voxel. */
bool organ_contains(const organ *o, const double point[3]);

/* Computes the results of one state. `nodal`, for DOSE_NOW, are the displacements [nodes][3], or NULL for tissue at rest; `shrunk` is for
   DOSE_SWELLING_GONE. Seeds must be given at their positions in that state. */
void organ_compute(organ *o, dose_state state, const trocar_dose_source *source, const trocar_dose_seed *seeds, int count, double prescription,
                   const double *nodal, const shrinkage *shrunk);

void shrink(const shrinkage *s, const double from[3], double to[3]);

#endif
