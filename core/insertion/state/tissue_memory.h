/* Memory of relaxing tissue: low-pass filtered forces on it. Plain data; empty for elastic tissue. See docs/mechanics.md, "Relaxation". */
#ifndef TROCAR_TISSUE_MEMORY_H
#define TROCAR_TISSUE_MEMORY_H

#include "insertion/solver/contact_solver.h"
#include "snapshot/snapshot.h"

enum { MAX_SHARES = MAX_CONTACTS + 1 }; /* number of shares including the tip's */

/* Filtered forces on a share of the track. */
typedef struct {
    vec3 load;                   /* N, world frame: sum of all forces on the share */
    double along;                /* N along the track: sum of the forces that shear the tissue along the shaft; excludes the force on the tip's end face */
    double twist;                /* N m, sum of the torques about the needle's axis */
} remembered_forces;

/* Memory of one share of the track, which belongs to an active contact or to the tip. There is one entry per term of the relaxation series: the force, low-pass
   filtered with that term's time constant. */
typedef struct {
    shaft_piece shaft;           /* the piece of shaft that the share covers */
    int tet;                     /* nominal element in which the share's load acts */
    vec3 at;                     /* m, nominal point at which the share's load acts */
    double modulus;              /* Pa, Young's modulus that the remembered forces refer to */
    remembered_forces terms[MAX_RELAXATION];
} share_memory;

typedef struct {
    double time;                 /* s, sum of all time steps so far */
    double since;                /* s, when the memory was last reset; data sent to the worker before then are invalid */
    int count;
    bool tip;                    /* true if the last share is the tip's */
    share_memory shares[MAX_SHARES]; /* shares in the last solve, from base to tip */
    double face[MAX_RELAXATION]; /* N, memory of the force on the tip's end face */
    residual_loads residual;         /* loads that act where the needle no longer is, as of `time` */
    double residual_added;           /* N, sum of the residual loads added since the last request to the worker */
    bool residual_growing;           /* true if residual load was added in this step */
} tissue_memory;

#endif
