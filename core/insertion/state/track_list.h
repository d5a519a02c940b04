/* The tracks that a needle has cut: polylines in the undeformed tissue, from where the tip went in to where it stopped cutting, with
   the membranes that it punctured. Plain data. */
#ifndef TROCAR_TRACK_LIST_H
#define TROCAR_TRACK_LIST_H

#include <stdbool.h>

#include "base/vec.h"

enum { MAX_TRACKS = 128, MAX_TRACK_POINTS = 1024, NO_MEMBRANE = -1 };

static const double TRACK_SPACING = 4e-3; /* m: distance between neighbouring points of a track, at most, over which its direction is taken. Chosen: 4 m of
                                             tracks have room */

typedef struct {
    vec3 at;                 /* m, nominal */
    int tet;                 /* nominal element */
    int membrane;            /* that was punctured there, or NO_MEMBRANE */
} track_point;

typedef struct {
    int count, point_count;
    int first[MAX_TRACKS];   /* index of each track's first point; a track ends where the next one begins */
    vec3 low[MAX_TRACKS], high[MAX_TRACKS]; /* m, corners of a box around each track */
    track_point points[MAX_TRACK_POINTS];
} track_list;

/* One past the last point of this track. RT */
static inline int track_end(const track_list *list, int track) { return track + 1 < list->count ? list->first[track + 1] : list->point_count; }

/* The tip has cut from one nominal point to another. Extends the newest track if that ends where this begins, else begins a new one.
   Where there is no room, the oldest track is dropped. False: one was. RT */
bool tracks_cut(track_list *list, track_point from, track_point to);

/* The tip has punctured a membrane at this point. As tracks_cut. RT */
bool tracks_puncture(track_list *list, track_point at, int membrane);

/* Appends those tracks of another list that come within `reach` of a nominal point, but not as near as `beyond` (m), as long as there is
   room. RT */
void tracks_copy_near(const track_list *from, vec3 x, double beyond, double reach, track_list *to);

/* Distance of a nominal point from where this membrane was punctured, m; INFINITY: it was not, within `reach`. RT */
double tracks_puncture_distance(const track_list *list, int membrane, vec3 x, double reach);

/* The place of a track that is closest to x. */
typedef struct {
    double distance;         /* m from x; INFINITY: not within reach */
    vec3 point, along;       /* m; unit vector in the direction in which it was cut */
    double ahead, behind;    /* m of track from that place to its end, and to its start */
} track_place;

/* Looks within `reach` only, and only at tracks whose box is. From a point far away it skips as many others as cannot be near: on a straight
   track it looks at some ten points, in the worst case at all of them. RT */
track_place tracks_closest(const track_list *list, int track, vec3 x, double reach);

#endif
