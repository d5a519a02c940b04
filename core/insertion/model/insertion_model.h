/* The immutable data of an insertion: mesh, materials, needle, membranes, calcifications, settings. */
#ifndef TROCAR_INSERTION_MODEL_H
#define TROCAR_INSERTION_MODEL_H

#include "insertion/model/guide.h"
#include "needle/needle.h"
#include "tissue/relaxation.h"
#include "tissue/tissue.h"

/* A named surface that resists the tip until it is punctured. */
typedef struct {
    int group;               /* index of the membrane's 2D group in the mesh */
    double puncture_force;   /* N; INFINITY if it can never be punctured */
} membrane;

/* A sphere of tissue that is harder to cut. */
typedef struct {
    vec3 centre;             /* m, in the undeformed tissue */
    double radius;           /* m */
    double cutting_factor;   /* at least 1; multiplies the cutting force of the region around the sphere */
    int line;                /* line in the scene file where the centre is set, for messages; 0 if none */
} calcification;

typedef struct {
    double contact_spacing;      /* m, smallest distance between contact nodes along the track */
    double weakening_distance;   /* m, distance slid over which static friction weakens to kinetic friction */
    double prefetch_distance;    /* m, how far ahead of the tip the requested window of nodes extends */
    double longest_step;         /* s; longer ticks are split into several steps, so that forces do not depend on the tick rate */
    int most_steps;              /* most steps per tick; a tick that would need more takes longer steps */
    double track_reach;          /* needle diameters: an old track is open to the tip up to this distance. 0: tracks close behind the needle */
    double track_angle;          /* rad, largest angle between track and cutting direction at which the track is open */
    int max_passes;              /* most Newton passes per step */
    double tolerance;            /* m, the passes end when the error in the needle's shape is below this */
    double bone_compliance;      /* m/N, how much bone yields under the tip */
    double surface_friction;     /* friction coefficient between the tip and a surface that it has not punctured */
    double gradient_span;        /* m, how far behind and ahead of the tip the tissue's displacement is taken to compute its gradient */
} insertion_settings;

/* Nodal values, node_count of each kind; local compliances are interpolated between them. */
typedef struct {
    double *disc;            /* mean of (3 - 4 nu) / (32 mu (1 - nu)), m^2/N: compliance of a rigid disc deep in the tissue, times its radius */
    double *stiffening;      /* mean stiffening coefficient of the regions */
    double *softness;        /* mean of 1 / mu, m^2/N */
    double *punch;           /* mean of (1 - 2 nu) / (4 mu ln(3 - 4 nu)), m^2/N: compliance of a rigid disc bonded to a free surface, times its radius */
    double *bone;            /* 1 on bone, which stops a tip that comes from the tissue; 0 elsewhere */
} nodal_compliances;

typedef struct {
    const mesh *mesh;
    const tissue *tissue;
    const region_material *materials;  /* materials, by group index */
    const needle_model *needle;
    const membrane *membranes;
    int membrane_count;
    const calcification *calcifications;
    int calcification_count;
    const guide *guides;
    int guide_count;
    insertion_settings settings;
    creep_series creep;          /* creep series, the same for all regions */
    bool stiffens;               /* true if the tissue of any region stiffens; set by local_create */
    nodal_compliances local;     /* set by local_create */
    nodal_compliances next;      /* while moduli change, the values that `local` is heading for; otherwise the same as `local` */
    double weight;               /* weight of `next` in the interpolation, from 0 to 1 */
} insertion_model;

#endif
