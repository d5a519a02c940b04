/* What relaxing tissue remembers of the forces on it: plain data, empty for elastic tissue. See docs/mechanics.md, "Relaxation". */
#ifndef TROCAR_TISSUE_MEMORY_H
#define TROCAR_TISSUE_MEMORY_H

#include "insertion/state/contact.h"
#include "snapshot/snapshot.h"

enum { MAX_SHARES = MAX_CONTACTS + 1 }; /* the tip's as well */

/* What is remembered of the forces on a share of the track. */
typedef struct {
    vec3 load;                   /* N, world frame: of all forces on the tissue */
    double along;                /* N along the track, of those that shear the tissue along the shaft: not of that on the tip's end face */
    double twist;                /* N m, of the torques about the needle's axis */
} remembered_forces;

/* Of one share of the track: that of an active contact, or of the tip. A term's memory is the forces, low-pass filtered with its time. */
typedef struct {
    double from, to;             /* m of depth */
    int tet;                     /* nominal element in which its load acts, */
    vec3 at;                     /* m, nominal: and where */
    remembered_forces terms[MAX_RELAXATION];
} share_memory;

typedef struct {
    double time;                 /* s, of all steps so far */
    double since;                /* s, when all was forgotten last: what the worker was told before does not count */
    int count;
    bool tip;                    /* the last of these is the tip's */
    share_memory shares[MAX_SHARES]; /* of the last solve, from base to tip */
    double face[MAX_RELAXATION]; /* N, of the force on the tip's end face */
    left_loads residual;         /* loads that nothing holds any more, at `time` */
    double residual_added;           /* N, added to them since they were last sent to the worker */
    bool residual_growing;           /* some was added in this step */
} tissue_memory;

#endif
