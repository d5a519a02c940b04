/* The immutable data of an insertion: mesh, materials, needle, membranes, calcifications and settings. */
#ifndef TROCAR_INSERTION_MODEL_H
#define TROCAR_INSERTION_MODEL_H

#include "insertion/model/guide.h"
#include "needle/needle.h"
#include "tissue/relaxation.h"
#include "tissue/tissue.h"

/* A named surface that resists the tip until it is punctured. */
typedef struct {
    int group;               /* group of the mesh with dimension 2 */
    double puncture_force;   /* N; INFINITY if the surface can never be punctured */
} membrane;

/* A ball within which the tissue is harder to cut. */
typedef struct {
    vec3 centre;             /* m, in the undeformed tissue */
    double radius;           /* m */
    double cutting_factor;   /* at least 1; multiplies the cutting force of the region in which the ball lies */
    int line;                /* line of the centre in the scene file, for messages; 0 if none */
} calcification;

typedef struct {
    double contact_spacing;      /* m, smallest distance between contact nodes along the track */
    double weakening_distance;   /* m, sliding distance over which static friction falls to kinetic friction */
    double prefetch_distance;    /* m, length of the path ahead of the tip that the requested window of nodes covers */
    double longest_step;         /* s; longer ticks are divided into several steps, so that forces do not depend on the tick rate */
    int most_steps;              /* maximum number of steps per tick; a tick that would need more takes longer steps */
    double track_reach;          /* needle diameters, distance up to which an old track is open to the tip; 0: tracks close behind the needle */
    double track_angle;          /* rad, largest angle between track and cutting direction at which the track is open */
    int max_passes;              /* maximum number of Newton passes per step */
    double tolerance;            /* m, error in the needle's shape below which the passes end */
    double bone_compliance;      /* m/N, compliance of bone under the tip */
    double surface_friction;     /* friction coefficient between the tip and a surface that it has not punctured */
    double gradient_span;        /* m, distance behind and ahead of the tip over which the gradient of the tissue's displacement is computed */
} insertion_settings;

/* Nodal values, node_count of each kind, from which local compliances are interpolated. */
typedef struct {
    double *disc;            /* mean of (3 - 4 nu) / (32 mu (1 - nu)), m^2/N: compliance of a rigid disc at depth, times its radius */
    double *stiffening;      /* mean stiffening coefficient of the regions */
    double *softness;        /* mean of 1 / mu, m^2/N */
    double *punch;           /* mean of (1 - 2 nu) / (4 mu ln(3 - 4 nu)), m^2/N: compliance of a rigid disc bonded to a free surface, times its radius */
    double *bone;            /* 1 on bone, which stops a tip that comes from the tissue; 0 elsewhere in the mesh */
} nodal_compliances;

typedef struct {
    const mesh *mesh;
    const tissue *tissue;
    const region_material *materials;  /* materials by group index */
    const needle_model *needle;
    const membrane *membranes;
    int membrane_count;
    const calcification *calcifications;
    int calcification_count;
    const guide *guides;
    int guide_count;
    insertion_settings settings;
    creep_series creep;          /* creep series, the same for all regions */
    bool stiffens;               /* true if any region stiffens; set by local_create */
    nodal_compliances local;     /* set by local_create */
    nodal_compliances next;      /* while moduli change, the values toward which `local` moves; otherwise the same as `local` */
    double weight;               /* weight of `next` in the interpolation, from 0 to 1 */
} insertion_model;

#endif
