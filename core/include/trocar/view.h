/* Read access to the visible state of a simulation, or of a picture of it. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_VIEW_H
#define TROCAR_PUBLIC_VIEW_H

#include "trocar/needle.h"
#include "trocar/probe.h"
#include "trocar/seeds.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A view of a simulation or a picture. It belongs to that object, is valid as long as the object exists, and always shows the object's current state. The view
   of a picture may be used by the thread that currently has the picture; that of a simulation, by its ticking thread. Functions that fill an array write at
   most `room` entries and return the total number of entries; this is 0 for a needle out of range. */
typedef struct trocar_view trocar_view;
TROCAR_API const trocar_view *trocar_sim_view(const trocar_sim *sim); /* [any, RT] */

/* Returns the simulated time in s since the creation of the simulation: the sum of `dt`. If several needles tick one after another for the same time step, the
   time advances only once. [tick, RT] */
TROCAR_API double trocar_view_time(const trocar_view *view);

/* ---- needles ---- */

/* Returns the pose of the base. Held needle: the last pose given, displaced by the deflection of the spring (trocar_sim_set_base_compliance). Resting
   needle: its current pose. [tick, RT] */
TROCAR_API trocar_pose trocar_view_base(const trocar_view *view, int needle);

/* Writes the positions of the needle's joints from base to tip, 3 coordinates (m) each; at most TROCAR_MAX_JOINTS joints. [tick, RT] */
TROCAR_API int trocar_view_centreline(const trocar_view *view, int needle, double *joints, int room);

/* Returns the tip's rotation about the needle's axis minus that of the base, in rad; negative if the tip lags behind while the base is rotated forward.
   [tick, RT] */
TROCAR_API double trocar_view_tip_lead(const trocar_view *view, int needle);

/* Returns the elastic energy of the bent needle, in J. [tick, RT] */
TROCAR_API double trocar_view_needle_energy(const trocar_view *view, int needle);

/* Writes the active contacts with tissue and guides, sorted from base to tip; if the tip is in the tissue, it is the last one. At most TROCAR_MAX_POINTS.
   [tick, RT] */
TROCAR_API int trocar_view_contacts(const trocar_view *view, int needle, trocar_contact *contacts, int room);

/* Writes the tissue contacts that are not active yet, sorted from base to tip. They are ADDING, except that the last one may be PLANNED. For a planned
   contact, `position` is its position in the tissue at rest, and `arc` is the needle's length. [tick, RT] */
TROCAR_API int trocar_view_pending_contacts(const trocar_view *view, int needle, trocar_contact *contacts, int room);

/* Returns the hole of this guide through which the needle passes, as column + columns * row (counted from 0); otherwise TROCAR_NO_HOLE or TROCAR_MISSED_HOLE.
   [tick, RT] */
TROCAR_API int trocar_view_hole(const trocar_view *view, int needle, int guide);

/* Writes the tracks that this needle has cut since its last reset; at most TROCAR_MAX_TRACK_POINTS points. [tick, RT] */
TROCAR_API int trocar_view_tracks(const trocar_view *view, int needle, trocar_track_point *points, int room);

/* ---- seeds, probe, tissue ---- */

/* Writes the seeds in the tissue, in the order in which they were deposited; at most TROCAR_MAX_SEEDS. [tick, RT] */
TROCAR_API int trocar_view_seeds(const trocar_view *view, trocar_seed *seeds, int room);

/* Returns the number of seeds that have been dropped but are still in the needle. [tick, RT] */
TROCAR_API int trocar_view_pending_seeds(const trocar_view *view, int needle);

/* Returns the state of the probe in the last solution. [tick, RT] */
TROCAR_API trocar_probe trocar_view_probe(const trocar_view *view);

/* Computes the displacements [node_count][3] (m) of the mesh's nodes by one solve with the full stiffness matrix, which takes milliseconds to tenths of
   a second. Allocates memory in the first call. NO_MEMORY. [tick, allocates] */
TROCAR_API trocar_status trocar_view_displacements(const trocar_view *view, double *displacements, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
