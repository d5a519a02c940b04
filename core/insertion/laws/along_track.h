/* How the forces along the track at a point are divided between the shaft and (only at the tip) the end face. */
#ifndef TROCAR_ALONG_TRACK_H
#define TROCAR_ALONG_TRACK_H

#include "insertion/state/tick_data.h"

/* Forces of one point, in the order of the unknowns: the two across the needle, then the one along it (at the tip: the force on the end face, then that on
   the adjacent shaft). Part of each force acts on the shaft and the rest on the end face. By reciprocity, the point's displacement under each force is the
   sum of the displacements of shaft and end face, weighted by the same fractions. */
typedef struct {
    int row[4], axis[4], count; /* rows of these forces in the contact problem, and their axes in the needle's frame */
    double on_shaft[4], on_face[4];
    double along[4];            /* component along the track of each unit force */
} track_shares;

/* Returns the shares for point i in the tissue, for the needle's current shape. RT */
track_shares along_track(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i);

/* Forces (N) along the track that the shaft at point i and the tip's end face exert on the tissue. RT */
double force_on_shaft(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i);
double force_on_face(const insertion_state *state, const contact_points *points, const tissue_step *tissue);

#endif
