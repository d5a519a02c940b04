/* Memory of relaxing tissue: the forces on it. Plain data, empty for elastic tissue. See docs/mechanics.md, "Relaxation". */
#ifndef TROCAR_TISSUE_MEMORY_H
#define TROCAR_TISSUE_MEMORY_H

#include "insertion/state/contact.h"
#include "snapshot/snapshot.h"

enum { MAX_SHARES = MAX_CONTACTS + 1 }; /* includes the tip's share */

/* Filtered forces on a share of the track. */
typedef struct {
    vec3 load;                   /* N, world frame: sum of all forces on the tissue */
    double along;                /* N along the track: sum of the forces that shear the tissue along the shaft, without the force on the tip's end face */
    double twist;                /* N m, sum of the torques about the needle's axis */
} remembered_forces;

/* Memory of one share of the track, of an active contact or the tip. A term's memory is the force, low-pass filtered with its time constant. */
typedef struct {
    double from, to;             /* m of depth */
    int tet;                     /* nominal element in which its load acts */
    vec3 at;                     /* m, nominal point at which its load acts */
    remembered_forces terms[MAX_RELAXATION];
} share_memory;

typedef struct {
    double time;                 /* s, sum of all steps so far */
    double since;                /* s, time of the last reset of the memory; data sent to the worker before that are void */
    int count;
    bool tip;                    /* the last share is the tip's */
    share_memory shares[MAX_SHARES]; /* shares of the last solve, from base to tip */
    double face[MAX_RELAXATION]; /* N, memory of the force on the tip's end face */
    residual_loads residual;         /* loads that the needle no longer holds, at `time` */
    double residual_added;           /* N, residual load added since the last request to the worker */
    bool residual_growing;           /* residual load was added in this step */
} tissue_memory;

#endif
