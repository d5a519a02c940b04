#include "insertion/state/track_list.h"

#include <math.h>
#include <string.h>

static const double JOINED = 1e-4; /* m: a new cut that begins this close to the end of the newest track extends that track. Rounding tolerance */

/* ---- recording ----------------------------------------------------------------------------------------------------------- */

static void drop_oldest(track_list *list) {
    int gone = track_end(list, 0);
    list->point_count -= gone;
    list->count--;
    memmove(list->points, list->points + gone, (size_t)list->point_count * sizeof *list->points);
    for (int i = 0; i < list->count; i++) list->first[i] = list->first[i + 1] - gone;
    memmove(list->low, list->low + 1, (size_t)list->count * sizeof *list->low);
    memmove(list->high, list->high + 1, (size_t)list->count * sizeof *list->high);
}

static vec3 least(vec3 a, vec3 b) { return v3(fmin(a.x, b.x), fmin(a.y, b.y), fmin(a.z, b.z)); }
static vec3 greatest(vec3 a, vec3 b) { return v3(fmax(a.x, b.x), fmax(a.y, b.y), fmax(a.z, b.z)); }

/* Enlarges the newest track's bounding box to contain x. */
static void enclose(track_list *list, vec3 x) {
    int track = list->count - 1;
    bool new = list->point_count == list->first[track];
    list->low[track] = new ? x : least(list->low[track], x);
    list->high[track] = new ? x : greatest(list->high[track], x);
}

static bool is_near_box(const track_list *list, int track, vec3 x, double reach) {
    vec3 low = list->low[track], high = list->high[track];
    return x.x >= low.x - reach && x.x <= high.x + reach && x.y >= low.y - reach && x.y <= high.y + reach && x.z >= low.z - reach
        && x.z <= high.z + reach;
}

/* Appends a point to the newest track, dropping the oldest if the list is full. If there is only one track, it starts anew at this point. */
static bool append(track_list *list, track_point point) {
    bool room = list->point_count < MAX_TRACK_POINTS;
    if (!room) drop_oldest(list);
    if (list->count == 0) list->first[list->count++] = 0;
    enclose(list, point.at);
    list->points[list->point_count++] = point;
    return room;
}

static bool begin(track_list *list, track_point point) {
    bool room = list->count < MAX_TRACKS;
    if (!room) drop_oldest(list);
    list->first[list->count++] = list->point_count;
    return append(list, point) && room;
}

/* Returns the newest track's last point, or NULL. */
static track_point *newest_point(track_list *list) { return list->count > 0 ? &list->points[list->point_count - 1] : NULL; }

static bool is_joined(track_list *list, vec3 x) {
    const track_point *last = newest_point(list);
    return last && v3_norm(v3_sub(x, last->at)) <= JOINED;
}

/* Extends the newest track to `to`. Moves the last point there if that stays within the spacing of the point before it; otherwise appends points. */
static bool extend(track_list *list, track_point to) {
    int points = list->point_count - list->first[list->count - 1];
    track_point *last = newest_point(list);
    if (points > 1 && last->membrane == NO_MEMBRANE && v3_norm(v3_sub(to.at, last[-1].at)) <= TRACK_SPACING) {
        *last = to;
        enclose(list, to.at);
        return true;
    }
    vec3 from = last->at, way = v3_sub(to.at, from);
    int pieces = (int)fmin(fmax(1.0, ceil(v3_norm(way) / TRACK_SPACING)), MAX_TRACK_POINTS - 1);
    bool room = true;
    for (int i = 1; i <= pieces; i++)
        room &= append(list, (track_point){i < pieces ? v3_axpy((double)i / pieces, way, from) : to.at, to.tet, NO_MEMBRANE});
    return room;
}

bool tracks_cut(track_list *list, track_point from, track_point to) {
    from.membrane = to.membrane = NO_MEMBRANE;
    bool room = is_joined(list, from.at) || begin(list, from);
    return extend(list, to) && room;
}

bool tracks_puncture(track_list *list, track_point at, int membrane) {
    at.membrane = membrane;
    if (!is_joined(list, at.at)) return begin(list, at);
    track_point *last = newest_point(list);
    if (last->membrane != NO_MEMBRANE) return append(list, at);
    last->membrane = membrane;
    return true;
}

/* ---- searching ----------------------------------------------------------------------------------------------------------- */

/* Returns how many points the search can skip after one at this distance from x: neither they nor the segments between them can be within reach. */
static int skippable(double distance, double reach) { return (int)fmax(0.0, (distance - reach) / TRACK_SPACING); }

double tracks_puncture_distance(const track_list *list, int membrane, vec3 x, double reach) {
    double closest = INFINITY;
    for (int track = 0; track < list->count; track++) {
        if (!is_near_box(list, track, x, reach)) continue;
        for (int i = list->first[track]; i < track_end(list, track); i++) {
            double distance = v3_norm(v3_sub(x, list->points[i].at));
            if (distance <= reach && list->points[i].membrane == membrane) closest = fmin(closest, distance);
            int skipped = skippable(distance, reach);
            if (skipped > 0) i += skipped - 1;
        }
    }
    return closest;
}

static double length_between(const track_list *list, int from, int to) {
    double sum = 0.0;
    for (int i = from; i < to; i++) sum += v3_norm(v3_sub(list->points[i + 1].at, list->points[i].at));
    return sum;
}

/* Follows the track for `way` (m) from `from` through the points `next`, `next` + `step`, ..., but not past the point `last`. Returns where it ends up. */
static vec3 walk(const track_list *list, vec3 from, int next, int step, int last, double way) {
    for (;; next += step) {
        vec3 to = list->points[next].at, piece = v3_sub(to, from);
        double length = v3_norm(piece);
        if (length >= way) return v3_axpy(way / length, piece, from);
        if (next == last) return to;
        way -= length;
        from = to;
    }
}

/* Returns the track's direction at x, on this segment. The needle cut a smooth curve, but the polyline's direction jumps at each point, so the direction is
   averaged over one point spacing around x. */
static vec3 direction_at(const track_list *list, int begin, int last, int segment, vec3 x) {
    vec3 ahead = walk(list, x, segment + 1, 1, last, 0.5 * TRACK_SPACING), behind = walk(list, x, segment, -1, begin, 0.5 * TRACK_SPACING);
    vec3 chord = v3_sub(ahead, behind);
    if (v3_norm(chord) == 0.0) chord = v3_sub(list->points[segment + 1].at, list->points[segment].at);
    return v3_unit(chord);
}

track_place tracks_closest(const track_list *list, int track, vec3 x, double reach) {
    track_place best = {.distance = INFINITY};
    int begin = list->first[track], last = track_end(list, track) - 1, segment = -1;
    double part = 0.0;
    if (!is_near_box(list, track, x, reach)) return best;
    for (int i = begin; i < last;) {
        int skipped = skippable(v3_norm(v3_sub(x, list->points[i].at)), reach);
        if (skipped > 0) {
            i += skipped;
            continue;
        }
        vec3 from = list->points[i].at, way = v3_sub(list->points[i + 1].at, from);
        double square = v3_dot(way, way), t = square > 0.0 ? fmin(fmax(v3_dot(v3_sub(x, from), way) / square, 0.0), 1.0) : 0.0;
        vec3 point = v3_axpy(t, way, from);
        double distance = v3_norm(v3_sub(x, point));
        if (distance <= reach && distance < best.distance && square > 0.0) {
            best = (track_place){.distance = distance, .point = point};
            segment = i;
            part = t;
        }
        i++;
    }
    if (segment < 0) return best;
    best.along = direction_at(list, begin, last, segment, best.point);
    double length = length_between(list, segment, segment + 1);
    best.ahead = (1.0 - part) * length + length_between(list, segment + 1, last);
    best.behind = part * length + length_between(list, begin, segment);
    return best;
}

void tracks_copy_near(const track_list *from, vec3 x, double beyond, double reach, track_list *to) {
    for (int track = 0; track < from->count; track++) {
        int points = track_end(from, track) - from->first[track];
        double distance = tracks_closest(from, track, x, reach).distance;
        if (isinf(distance) || distance <= beyond || to->count == MAX_TRACKS || to->point_count + points > MAX_TRACK_POINTS) continue;
        to->first[to->count] = to->point_count;
        to->low[to->count] = from->low[track];
        to->high[to->count++] = from->high[track];
        memcpy(&to->points[to->point_count], &from->points[from->first[track]], (size_t)points * sizeof *to->points);
        to->point_count += points;
    }
}
