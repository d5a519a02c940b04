/* How stiff and how damped the virtual coupling may be in a loop with a given delay. Used by the server and by the device profile check. */
#ifndef TROCAR_COUPLING_RULE_H
#define TROCAR_COUPLING_RULE_H

#include "trocar.h"

/* Returns the stiffness (N/m) at which the loop is stable with a total delay of `delay` (s), but no more than limits->max_stiffness. RT */
double coupling_rule_stiffness(const trocar_device_limits *limits, double delay);

/* Returns the damping (N s/m) that goes with this stiffness. RT */
double coupling_rule_damping(double stiffness, double delay);

#endif
