/* The virtual coupling's stiffness and damping for a loop with a given delay, used by the server and by the device profile check. */
#ifndef TROCAR_COUPLING_RULE_H
#define TROCAR_COUPLING_RULE_H

#include "trocar.h"

/* Returns the stiffness (N/m) at which the loop stays stable with a total delay of `delay` (s): at most limits->max_stiffness. RT */
double coupling_rule_stiffness(const trocar_device_limits *limits, double delay);

/* Returns the damping (N s/m) that belongs to this stiffness. RT */
double coupling_rule_damping(double stiffness, double delay);

#endif
