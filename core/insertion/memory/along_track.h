/* How the tissue at a point shares out the forces along the track: between the shaft there and, at the tip, its end face. */
#ifndef TROCAR_ALONG_TRACK_H
#define TROCAR_ALONG_TRACK_H

#include "insertion/state/tick.h"

/* A point's forces, in the order of the unknowns: two across the needle, then along it; at the tip that of the end face, then that of the shaft next to it.
   Each acts with a part on the shaft and with the rest on the end face; by reciprocity, those parts of their displacements are what it yields. */
typedef struct {
    int row[4], axis[4], count; /* in the contact problem; in the needle's frame */
    double on_shaft[4], on_face[4];
    double along[4];            /* of each force, along the track */
} track_shares;

/* Of point i in tissue, with the needle's present shape. RT */
track_shares along_track(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i);

/* Along the track on the tissue, N: of the shaft at point i, and of the tip's end face. RT */
double force_on_shaft(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i);
double force_on_face(const insertion_state *state, const contact_points *points, const tissue_step *tissue);

#endif
