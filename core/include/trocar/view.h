/* Views: read access to the visible state of a simulation or a picture. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_VIEW_H
#define TROCAR_PUBLIC_VIEW_H

#include "trocar/needle.h"
#include "trocar/probe.h"
#include "trocar/seeds.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A view of a simulation or a picture. It belongs to that object, is valid as long as the object exists, and always shows its current state. Use a
   simulation's view only in its ticking thread, and a picture's only in the thread that currently has the picture. Functions that fill an array write at
   most `room` entries and return the total number of entries, or 0 if `needle` is out of range. */
typedef struct trocar_view trocar_view;
TROCAR_API const trocar_view *trocar_sim_view(const trocar_sim *sim); /* [any, RT] */

/* Returns the simulated time in s since the simulation was created: the sum of all `dt`. When several needles tick in turn for the same time step, time
   advances only once. [tick, RT] */
TROCAR_API double trocar_view_time(const trocar_view *view);

/* ---- needles ---- */

/* Returns the pose of the base. For a held needle, this is the last commanded pose plus the spring's deflection (trocar_sim_set_base_compliance); for a
   resting needle, its current pose. [tick, RT] */
TROCAR_API trocar_pose trocar_view_base(const trocar_view *view, int needle);

/* Writes the positions of the needle's joints, from base to tip, as 3 coordinates (m) each; at most TROCAR_MAX_JOINTS joints. [tick, RT] */
TROCAR_API int trocar_view_centreline(const trocar_view *view, int needle, double *joints, int room);

/* Returns how far the tip is rotated about the needle's axis relative to the base, in rad; negative if it lags while the base turns forward. [tick, RT] */
TROCAR_API double trocar_view_tip_lead(const trocar_view *view, int needle);

/* Returns the needle's elastic energy in J. [tick, RT] */
TROCAR_API double trocar_view_needle_energy(const trocar_view *view, int needle);

/* Writes the active contacts with tissue and guides, sorted from base to tip; if the tip is in the tissue, it is the last one. At most TROCAR_MAX_POINTS.
   [tick, RT] */
TROCAR_API int trocar_view_contacts(const trocar_view *view, int needle, trocar_contact *contacts, int room);

/* Writes the tissue contacts that are not active yet, sorted from base to tip. All are ADDING, except that the last may be PLANNED; for a planned contact,
   `position` is its position in the tissue at rest, and `arc` is the needle's length. [tick, RT] */
TROCAR_API int trocar_view_pending_contacts(const trocar_view *view, int needle, trocar_contact *contacts, int room);

/* Returns which hole of this guide the needle passes through, as column + columns * row (counted from 0), or TROCAR_NO_HOLE or TROCAR_MISSED_HOLE.
   [tick, RT] */
TROCAR_API int trocar_view_hole(const trocar_view *view, int needle, int guide);

/* Writes the tracks that this needle has cut since its last reset; at most TROCAR_MAX_TRACK_POINTS points. [tick, RT] */
TROCAR_API int trocar_view_tracks(const trocar_view *view, int needle, trocar_track_point *points, int room);

/* ---- seeds, probe, tissue ---- */

/* Writes the seeds in the tissue, in the order they were deposited; at most TROCAR_MAX_SEEDS. [tick, RT] */
TROCAR_API int trocar_view_seeds(const trocar_view *view, trocar_seed *seeds, int room);

/* Returns how many seeds have been dropped but are still in the needle. [tick, RT] */
TROCAR_API int trocar_view_pending_seeds(const trocar_view *view, int needle);

/* Returns the probe's state in the last solution. [tick, RT] */
TROCAR_API trocar_probe trocar_view_probe(const trocar_view *view);

/* Computes the displacements [node_count][3] (m) of the mesh nodes by one solve with the full stiffness matrix. This takes milliseconds to tenths of a
   second. The first call allocates memory. NO_MEMORY. [tick, allocates] */
TROCAR_API trocar_status trocar_view_displacements(const trocar_view *view, double *displacements, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
