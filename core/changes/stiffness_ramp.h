/* The course of a change of moduli: the weight of the new compliance. Pure functions. See docs/training/changes.md. */
#ifndef TROCAR_STIFFNESS_RAMP_H
#define TROCAR_STIFFNESS_RAMP_H

#include "scene/simulation_config.h"

/* In every direction, the new compliance is between 1 - stiffer and 1 + softer times the old one. */
typedef struct {
    double softer, stiffer;
    double crossing;         /* weight below which softening tissue has the largest relative rate of change; above it, stiffening tissue */
    double first, whole;     /* logarithms of the factors by which the fastest-changing compliance changes up to `crossing`, and in the whole change */
} stiffness_ramp;

/* Begins a change between the moduli of two configurations of the same mesh. */
stiffness_ramp ramp_between(const simulation_config *from, const simulation_config *to);

/* The weight, from 0 to 1, after a part (from 0 to 1) of the change. It makes the largest relative rate of change of the compliance constant. RT */
double ramp_weight(const stiffness_ramp *r, double part);

/* Largest part of the change per tick, so that no compliance changes by more than 2 %. RT */
double ramp_step(const stiffness_ramp *r);

#endif
