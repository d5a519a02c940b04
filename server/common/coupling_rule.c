#include "common/coupling_rule.h"

#include <math.h>

/* A hand of mass m on a spring K and a damper B = 2 K T, both of which respond after a delay T, is stable for K T^2 / m < 0.53: the delay acts as a
   damper of -K T, and the damper itself must be slow compared with the delay. At K T^2 / m = 0.25, the hand is stable even with a delay of 1.4 T or
   any other spring in series, provided that the hand itself adds a damping of K T / 8. The margin is 0.125, because the device may be half as heavy as
   stated. */
static const double DELAY_MARGIN = 0.125, DAMPING = 2.0;

double coupling_rule_stiffness(const trocar_device_limits *limits, double delay) {
    return fmin(limits->max_stiffness, DELAY_MARGIN * limits->mass / (delay * delay));
}

double coupling_rule_damping(double stiffness, double delay) { return DAMPING * stiffness * delay; }
