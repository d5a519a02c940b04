/* How the forces at a point divide between the shaft and (at the tip) the end face, and their components along the track. */
#ifndef TROCAR_ALONG_TRACK_H
#define TROCAR_ALONG_TRACK_H

#include "insertion/state/tick_data.h"

/* The forces at one point, in the order of the unknowns: two across the needle, then one along it (at the tip: on the end face, then on the adjacent shaft).
   Part of each acts on the shaft and the rest on the end face. By reciprocity, the displacement that belongs to each force is the sum of those of shaft and end
   face, weighted by the same fractions. */
typedef struct {
    int row[4], axis[4], count; /* rows of these forces in the contact problem, and their axes in the needle's frame */
    double on_shaft[4], on_face[4];
    double along[4];            /* component along the track of a unit force */
} track_shares;

/* Returns this division for point i in the tissue and the needle's current shape. RT */
track_shares along_track(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i);

/* Return the force (N) along the track that the shaft at point i, or the tip's end face, exerts on the tissue. RT */
double force_on_shaft(const insertion_state *state, const contact_points *points, const tissue_step *tissue, int i);
double force_on_face(const insertion_state *state, const contact_points *points, const tissue_step *tissue);

#endif
