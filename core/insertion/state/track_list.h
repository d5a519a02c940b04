/* The tracks that a needle has cut, and the membranes it has punctured along them. A track is a polyline in the undeformed tissue, from where the tip entered
   to the end of the cut. Plain data. */
#ifndef TROCAR_TRACK_LIST_H
#define TROCAR_TRACK_LIST_H

#include <stdbool.h>

#include "base/vec.h"

enum { MAX_TRACKS = 128, MAX_TRACK_POINTS = 1024, NO_MEMBRANE = -1 };

static const double TRACK_SPACING = 4e-3; /* m: largest distance between adjacent points of a track, and the length over which its direction is averaged.
                                             Chosen: gives the list room for 4 m of tracks */

typedef struct {
    vec3 at;                 /* m, nominal */
    int tet;                 /* nominal element */
    int membrane;            /* membrane punctured here, or NO_MEMBRANE */
} track_point;

typedef struct {
    int count, point_count;
    int first[MAX_TRACKS];   /* index of each track's first point; each track ends where the next begins */
    vec3 low[MAX_TRACKS], high[MAX_TRACKS]; /* m, opposite corners of each track's bounding box */
    track_point points[MAX_TRACK_POINTS];
} track_list;

/* Returns the index one past the track's last point. RT */
static inline int track_end(const track_list *list, int track) { return track + 1 < list->count ? list->first[track + 1] : list->point_count; }

/* Records a cut between two nominal points. It extends the newest track if it begins at that track's end; otherwise it begins a new track. If there is no room,
   drops the oldest track and returns false. RT */
bool tracks_cut(track_list *list, track_point from, track_point to);

/* Records that a membrane was punctured at this point. Returns the same as tracks_cut. RT */
bool tracks_puncture(track_list *list, track_point at, int membrane);

/* Appends the tracks of another list whose distance from a nominal point is more than `beyond` and at most `reach` (m), as far as there is room. RT */
void tracks_copy_near(const track_list *from, vec3 x, double beyond, double reach, track_list *to);

/* Returns the distance (m) from a nominal point to the nearest puncture of this membrane, or INFINITY if there is none within `reach`. RT */
double tracks_puncture_distance(const track_list *list, int membrane, vec3 x, double reach);

/* The point of a track closest to a given point x. */
typedef struct {
    double distance;         /* m, distance from x; INFINITY if no point is within reach */
    vec3 point, along;       /* point, m: the closest point; along: unit vector in the direction of the cut */
    double ahead, behind;    /* m, length of the track from the point forward to its end and back to its start */
} track_place;

/* Finds the closest point within `reach`. Skips the whole track if its bounding box is farther away, and otherwise skips points that cannot be near: about ten
   points of a straight track are examined, in the worst case all. RT */
track_place tracks_closest(const track_list *list, int track, vec3 x, double reach);

#endif
