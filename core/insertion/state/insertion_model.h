/* What an insertion takes as given: mesh, materials, needle, membranes and settings. Constant during a run. */
#ifndef TROCAR_INSERTION_MODEL_H
#define TROCAR_INSERTION_MODEL_H

#include "insertion/state/guide.h"
#include "needle/needle.h"
#include "tissue/relaxation.h"
#include "tissue/tissue.h"

/* A named surface that resists the tip until it is punctured. */
typedef struct {
    int group;               /* of the mesh, dimension 2 */
    double puncture_force;   /* N; INFINITY: never */
} membrane;

typedef struct {
    double contact_spacing;      /* m, least distance between contact nodes along the track */
    double weakening_distance;   /* m of sliding over which static friction falls to kinetic */
    double prefetch_distance;    /* m of path ahead of the tip that the window covers */
    double longest_step;         /* s, a longer tick is taken in several steps: forces do not depend on the rate */
    int most_steps;              /* a tick takes at most so many steps; in a longer tick, the steps are longer */
    double track_reach;          /* diameters of the needle, distance up to which an old track is open to the tip; 0: tissue closes behind it */
    double track_angle;          /* rad between track and direction of cutting, up to which it is open */
    int max_passes;              /* Newton passes a step, at most */
    double tolerance;            /* m, error of the needle's shape at which the passes stop */
    double bone_compliance;      /* m/N, of bone under the tip */
    double surface_friction;     /* friction coefficient of the tip on a surface that it has not punctured */
    double gradient_span;        /* m before and behind the tip, between which the tissue's displacement gradient is taken */
} insertion_settings;

typedef struct {
    const mesh *mesh;
    const tissue *tissue;
    const region_material *materials;  /* by group index */
    const needle_model *needle;
    const membrane *membranes;
    int membrane_count;
    const guide *guides;
    int guide_count;
    insertion_settings settings;
    creep_series creep;          /* of all regions alike */
    bool stiffens;               /* some region does; set by local_create */
    double *node_disc;           /* node_count: mean of (3 - 4 nu) / (32 mu (1 - nu)), m^2/N: rigid disc in the depth, times its radius */
    double *node_stiffening;     /* node_count: mean of the regions' stiffening */
    double *node_softness;       /* node_count: mean of 1 / mu, m^2/N */
    double *node_punch;          /* node_count: mean of (1 - 2 nu) / (4 mu ln(3 - 4 nu)), m^2/N: the same bonded to a free surface */
    double *node_bone;           /* node_count: 1 on bone, where a tip that comes from the tissue is stopped as by bone, else 0 */
} insertion_model;

#endif
