/* Time-domain passivity control (Hannaford and Ryu 2002) in a bridge, for comparison with the server's method (docs/real-time.md). The observer adds up the
   work that the commanded forces do on the device. While the device has received more energy than it has returned, the controller brakes it. No clock is
   needed, because all periods are equal. */
#ifndef TROCAR_TESTS_PASSIVITY_H
#define TROCAR_TESTS_PASSIVITY_H

#include "base/vec.h"

enum { PASSIVITY_DELAY = 64 }; /* in periods; more than any delay */

typedef struct {
    double period;           /* s */
    int delay;               /* periods, as assumed by the observer, from a command until a position shows the effect of its force; at least 1 */
    double most_damping;     /* N s/m, maximum damping; with 0, the energy is only observed */
    double max_force;        /* N, the device's maximum force */
    vec3 forces[PASSIVITY_DELAY]; /* N, commanded forces, indexed by their number modulo PASSIVITY_DELAY */
    long count;
    vec3 position, velocity; /* m and m/s, last position and filtered velocity */
    double energy, most;     /* J; energy: received by the device; most: its maximum */
} passivity;

/* Returns the largest stable damping (N s/m) for a device with this `mass` (kg) and round-trip delay (s). */
double passivity_damping(double mass, double delay);

/* Returns the force (N) to command instead of `wanted`, with the device at `position` (m). */
vec3 passivity_next(passivity *p, vec3 position, vec3 wanted);

#endif
