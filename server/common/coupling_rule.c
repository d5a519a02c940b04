#include "common/coupling_rule.h"

#include <math.h>

/* A hand of mass m, held by a spring K and a damper B = 2 K T that both respond after a delay T, is stable if K T^2 / m < 0.53. The delay acts like a damper of
   -K T, and the damper's own response must be slow compared with the delay. At K T^2 / m = 0.25, the hand stays stable even if the delay is 1.4 T, or with any
   further spring in series, provided that the hand itself adds damping of K T / 8. The margin used is 0.125, because the device may be half as heavy as stated.
   */
static const double DELAY_MARGIN = 0.125, DAMPING = 2.0;

double coupling_rule_stiffness(const trocar_device_limits *limits, double delay) {
    return fmin(limits->max_stiffness, DELAY_MARGIN * limits->mass / (delay * delay));
}

double coupling_rule_damping(double stiffness, double delay) { return DAMPING * stiffness * delay; }
