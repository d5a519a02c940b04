/* How a change of moduli proceeds: the weight of the new compliance at each point of the change. Pure functions. See docs/training/changes.md. */
#ifndef TROCAR_STIFFNESS_RAMP_H
#define TROCAR_STIFFNESS_RAMP_H

#include "scene/simulation_config.h"

/* In every direction, the new compliance is between 1 - stiffer and 1 + softer times the old one. */
typedef struct {
    double softer, stiffer;
    double crossing;         /* below this weight, the compliance that changes fastest relative to its value is that of softening tissue; above it, that of
                                stiffening tissue */
    double first, whole;     /* ln of the factor by which the fastest-changing compliance changes up to `crossing`, and over the whole change */
} stiffness_ramp;

/* Returns the ramp for a change between the moduli of two configurations of the same mesh. */
stiffness_ramp ramp_between(const simulation_config *from, const simulation_config *to);

/* Returns the weight (0 to 1) of the new compliance when a given part (0 to 1) of the change is complete. With this weight, the largest relative rate of change
   of the compliance is constant. RT */
double ramp_weight(const stiffness_ramp *r, double part);

/* Returns the largest part of the change per tick that changes no compliance by more than 2 %. RT */
double ramp_step(const stiffness_ramp *r);

#endif
