/* A needle as clients receive it: nodes joined by straight segments. */
#ifndef TROCAR_TESTS_NEEDLE_LINE_H
#define TROCAR_TESTS_NEEDLE_LINE_H

#include <math.h>

/* Returns a position's distance (m) from the chord between nodes at this arc length (m from the base), or INFINITY beyond the needle's end. Between nodes,
   the needle itself deviates from the chord by a few µm. */
static inline double distance_from_needle(const double (*nodes)[3], int count, double arc, const double position[3]) {
    for (int s = 0; s + 1 < count; s++) {
        double along[3], length = 0.0, distance = 0.0;
        for (int k = 0; k < 3; k++) along[k] = nodes[s + 1][k] - nodes[s][k], length += along[k] * along[k];
        length = sqrt(length);
        if (arc > length + 1e-9) { arc -= length; continue; }
        for (int k = 0; k < 3; k++) distance += pow(nodes[s][k] + along[k] * arc / length - position[k], 2);
        return sqrt(distance);
    }
    return INFINITY;
}

#endif
