/* The tracks that a needle has cut: polylines in the undeformed tissue, from the tip's entry to the end of the cut, with the membranes that it punctured.
   Plain data. */
#ifndef TROCAR_TRACK_LIST_H
#define TROCAR_TRACK_LIST_H

#include <stdbool.h>

#include "base/vec.h"

enum { MAX_TRACKS = 128, MAX_TRACK_POINTS = 1024, NO_MEMBRANE = -1 };

static const double TRACK_SPACING = 4e-3; /* m: largest distance between adjacent points of a track, over which its direction is averaged. Chosen: the list has
                                             room for 4 m of tracks */

typedef struct {
    vec3 at;                 /* m, nominal */
    int tet;                 /* nominal element */
    int membrane;            /* membrane punctured at this point, or NO_MEMBRANE */
} track_point;

typedef struct {
    int count, point_count;
    int first[MAX_TRACKS];   /* index of each track's first point; a track ends where the next one begins */
    vec3 low[MAX_TRACKS], high[MAX_TRACKS]; /* m, corners of a box around each track */
    track_point points[MAX_TRACK_POINTS];
} track_list;

/* One past the last point of this track. RT */
static inline int track_end(const track_list *list, int track) { return track + 1 < list->count ? list->first[track + 1] : list->point_count; }

/* Records a cut from one nominal point to another. Extends the newest track if the cut begins at its end, otherwise begins a new track. If there is no room,
   the oldest track is dropped and the function returns false. RT */
bool tracks_cut(track_list *list, track_point from, track_point to);

/* Records the puncture of a membrane at this point. Returns as tracks_cut does. RT */
bool tracks_puncture(track_list *list, track_point at, int membrane);

/* Appends the tracks of another list whose distance from a nominal point is between `beyond` and `reach` (m), as long as there is room. RT */
void tracks_copy_near(const track_list *from, vec3 x, double beyond, double reach, track_list *to);

/* Distance of a nominal point from the nearest puncture of this membrane, m; INFINITY if there is none within `reach`. RT */
double tracks_puncture_distance(const track_list *list, int membrane, vec3 x, double reach);

/* The point of a track that is closest to x. */
typedef struct {
    double distance;         /* m from x; INFINITY: none within reach */
    vec3 point, along;       /* m; unit vector in the direction of the cut */
    double ahead, behind;    /* m of track from the point to its end and to its start */
} track_place;

/* Searches within `reach` only, and only tracks whose bounding box is within reach. From a distant point, the search skips the points that cannot be near:
   about ten points are examined on a straight track, and all of them in the worst case. RT */
track_place tracks_closest(const track_list *list, int track, vec3 x, double reach);

#endif
