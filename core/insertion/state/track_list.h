/* The tracks that a needle has cut: polylines in the undeformed tissue, from the tip's entry to the end of the cut, with the membranes that were
   punctured. Plain data. */
#ifndef TROCAR_TRACK_LIST_H
#define TROCAR_TRACK_LIST_H

#include <stdbool.h>

#include "base/vec.h"

enum { MAX_TRACKS = 128, MAX_TRACK_POINTS = 1024, NO_MEMBRANE = -1 };

static const double TRACK_SPACING = 4e-3; /* m: largest distance between adjacent points of a track; also the length over which its direction is averaged.
                                             Chosen: the list has room for 4 m of tracks */

typedef struct {
    vec3 at;                 /* m, nominal */
    int tet;                 /* nominal element */
    int membrane;            /* membrane punctured at this point, or NO_MEMBRANE */
} track_point;

typedef struct {
    int count, point_count;
    int first[MAX_TRACKS];   /* index of each track's first point; a track ends where the next one begins */
    vec3 low[MAX_TRACKS], high[MAX_TRACKS]; /* m, opposite corners of a bounding box of each track */
    track_point points[MAX_TRACK_POINTS];
} track_list;

/* Index one past the track's last point. RT */
static inline int track_end(const track_list *list, int track) { return track + 1 < list->count ? list->first[track + 1] : list->point_count; }

/* Records a cut from one nominal point to another. If the cut begins at the end of the newest track, it extends that track; otherwise it begins a new one.
   If there is no room, the oldest track is dropped and the function returns false. RT */
bool tracks_cut(track_list *list, track_point from, track_point to);

/* Records the puncture of a membrane at this point. The return value is the same as that of tracks_cut. RT */
bool tracks_puncture(track_list *list, track_point at, int membrane);

/* Appends those tracks of another list whose distance from a nominal point is between `beyond` and `reach` (m), until the list is full. RT */
void tracks_copy_near(const track_list *from, vec3 x, double beyond, double reach, track_list *to);

/* Distance (m) from a nominal point to the nearest puncture of this membrane; INFINITY if there is none within `reach`. RT */
double tracks_puncture_distance(const track_list *list, int membrane, vec3 x, double reach);

/* The point on a track that is closest to a given point x. */
typedef struct {
    double distance;         /* m, distance from x; INFINITY if no point is within reach */
    vec3 point, along;       /* point, m: the closest point; along: unit vector along the cut */
    double ahead, behind;    /* m, length of the track from the point to its end and back to its start */
} track_place;

/* Finds the closest point within `reach`; tracks whose bounding box is farther away are not searched. From a distant point, the search skips the points
   that cannot be near: on a straight track it examines about ten points, and in the worst case all. RT */
track_place tracks_closest(const track_list *list, int track, vec3 x, double reach);

#endif
