/* What can be seen of a simulation, or of a picture of it. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_VIEW_H
#define TROCAR_PUBLIC_VIEW_H

#include "trocar/needle.h"
#include "trocar/probe.h"
#include "trocar/seeds.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A simulation or a picture, to look at. It belongs to that object, lives as long, and always shows its present state. A picture's view may be used by
   the thread that has the picture, a simulation's by its ticking thread. Functions that fill an array write at most `room` entries and return how many
   there are; for a needle out of range that is 0. */
typedef struct trocar_view trocar_view;
TROCAR_API const trocar_view *trocar_sim_view(const trocar_sim *sim); /* [any, RT] */

/* Simulated time, s, since the creation of the simulation: the sum of `dt`. Needles that tick one after another count once. [tick, RT] */
TROCAR_API double trocar_view_time(const trocar_view *view);

/* ---- needles ---- */

/* The base's pose: the last pose given, moved by the deflection of trocar_sim_set_base_compliance; of a resting needle, its current pose. [tick, RT] */
TROCAR_API trocar_pose trocar_view_base(const trocar_view *view, int needle);

/* Joints of the needle from base to tip, 3 numbers each, m; at most TROCAR_MAX_JOINTS joints. [tick, RT] */
TROCAR_API int trocar_view_centreline(const trocar_view *view, int needle, double *joints, int room);

/* Rotation of the tip about the needle's axis minus that of the base, rad; negative if the tip lags behind a base turned forward. [tick, RT] */
TROCAR_API double trocar_view_tip_lead(const trocar_view *view, int needle);

/* Elastic energy of the bent needle, J. [tick, RT] */
TROCAR_API double trocar_view_needle_energy(const trocar_view *view, int needle);

/* Active contacts with tissue and guides, from base to tip, the tip last if it is in the tissue; at most TROCAR_MAX_POINTS. [tick, RT] */
TROCAR_API int trocar_view_contacts(const trocar_view *view, int needle, trocar_contact *contacts, int room);

/* Tissue contacts that are not active yet, from base to tip: ADDING, or PLANNED, of which there is at most one, the last. A planned one's position is its
   place in the tissue at rest, and its arc the needle's length. [tick, RT] */
TROCAR_API int trocar_view_pending_contacts(const trocar_view *view, int needle, trocar_contact *contacts, int room);

/* The hole of a guide that the needle is in: column + columns * row, from 0; or TROCAR_NO_HOLE or TROCAR_MISSED_HOLE. [tick, RT] */
TROCAR_API int trocar_view_hole(const trocar_view *view, int needle, int guide);

/* The tracks that this needle has cut since its last reset; at most TROCAR_MAX_TRACK_POINTS points. [tick, RT] */
TROCAR_API int trocar_view_tracks(const trocar_view *view, int needle, trocar_track_point *points, int room);

/* ---- seeds, probe, tissue ---- */

/* The seeds in the tissue, in the order in which they were left; at most TROCAR_MAX_SEEDS. [tick, RT] */
TROCAR_API int trocar_view_seeds(const trocar_view *view, trocar_seed *seeds, int room);

/* The number of seeds that were dropped but are still in the needle. [tick, RT] */
TROCAR_API int trocar_view_pending_seeds(const trocar_view *view, int needle);

/* The probe as last solved. [tick, RT] */
TROCAR_API trocar_probe trocar_view_probe(const trocar_view *view);

/* Displacements of the mesh's nodes, 3 node_count, m: one solve with the whole matrix, milliseconds to tenths of a second. Allocates the first time.
   NO_MEMORY. [tick, allocates] */
TROCAR_API trocar_status trocar_view_displacements(const trocar_view *view, double *displacements, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
