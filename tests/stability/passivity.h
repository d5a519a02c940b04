/* Time-domain passivity control (Hannaford and Ryu 2002) in a bridge, for comparison with the server's method (docs/real-time.md). The observer adds
   up the work that the commanded forces do on the device; while the device has received more than it gave, the controller brakes it. No clock: the
   periods are equal. */
#ifndef TROCAR_TESTS_PASSIVITY_H
#define TROCAR_TESTS_PASSIVITY_H

#include "base/vec.h"

enum { PASSIVITY_DELAY = 64 }; /* periods, longer than any delay */

typedef struct {
    double period;           /* s */
    int delay;               /* number of periods from a command until a position shows its force, as far as the observer knows; at least 1 */
    double most_damping;     /* N s/m; 0: only observes */
    double max_force;        /* N, largest force of the device */
    vec3 forces[PASSIVITY_DELAY]; /* N, commanded, by number modulo PASSIVITY_DELAY */
    long count;
    vec3 position, velocity; /* m and m/s, filtered */
    double energy, most;     /* J, energy that the device has received, and its maximum */
} passivity;

/* Returns the greatest stable damping (N s/m) for a device of `mass` (kg) behind a delay (s, round trip). */
double passivity_damping(double mass, double delay);

/* Returns the force (N) to command instead of `wanted`, with the device at `position` (m). */
vec3 passivity_next(passivity *p, vec3 position, vec3 wanted);

#endif
