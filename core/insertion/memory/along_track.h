/* How the forces along the track at a point are divided between the shaft and, at the tip, the end face. */
#ifndef TROCAR_ALONG_TRACK_H
#define TROCAR_ALONG_TRACK_H

#include "insertion/state/tick.h"

/* Forces of one point, in the order of the unknowns: two across the needle, then the force along it; at the tip the force on the end face, then the force on
   the adjacent shaft. Part of each force acts on the shaft and the rest on the end face. By reciprocity, the same fractions of their displacements add up to
   the displacement under that force. */
typedef struct {
    int row[4], axis[4], count; /* row in the contact problem; axis in the needle's frame */
    double on_shaft[4], on_face[4];
    double along[4];            /* component of each unit force along the track */
} track_shares;

/* Shares of point i in tissue, for the needle's present shape. RT */
track_shares along_track(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i);

/* Forces on the tissue along the track, N: of the shaft at point i, and of the tip's end face. RT */
double force_on_shaft(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i);
double force_on_face(const insertion_state *state, const contact_points *points, const tissue_step *tissue);

#endif
