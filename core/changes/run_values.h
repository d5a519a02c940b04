/* The parameters that may change during a run, and their change over a stated time. See docs/training/changes.md. */
#ifndef TROCAR_RUN_VALUES_H
#define TROCAR_RUN_VALUES_H

#include "model/model_parts.h"

/* Values of all parameters of which some may change (the table of scene keys says which); the others are copies. */
typedef struct {
    region_material materials[MESH_MAX_GROUPS];
    membrane membranes[MAX_MEMBRANES];
    membrane_material sheets[MAX_MEMBRANES]; /* of the membranes; like the moduli, these are the last values set, to which elasticity.c moves */
    calcification calcifications[MAX_CALCIFICATIONS];
    guide guides[MAX_GUIDES];
} run_values;

/* A set of values in use, and the constants of an insertion with them. Does not move in memory, because `model` points to `now`. During a change, every value
   moves linearly in simulated time. */
typedef struct {
    insertion_model model;
    run_values now, from, to; /* `from` and `to`: at the beginning and at the end of the last change */
    double duration;         /* s, of the last change; 0 before the first */
    double part;             /* from 0 to 1, how much of it is complete */
    double time;             /* s, simulated time for which `now` holds */
} values_in_use;

/* Copies the values of a model. */
void run_values_of(const model_parts *parts, run_values *values);

/* Takes over those values of a configuration that may change. The names of the configuration's entries must be those of the model. */
void run_values_bind(const model_parts *parts, const simulation_config *config, run_values *values);

/* The reverse: writes the values into the configuration of the model. */
void run_values_unbind(const model_parts *parts, const run_values *values, simulation_config *config);

/* Sets the model's own values. */
void values_begin(const model_parts *parts, values_in_use *v);

/* Begins, at `time` (s), a change from the values now in use to others. RT */
void values_change(values_in_use *v, const run_values *to, double time, double duration);

/* Moves the values on to a later time (s). However long that takes, they move by a small part of the change at most, because after a late tick the force must
   not jump. RT */
void values_follow(values_in_use *v, double time);

/* Uses other values at once. RT */
void values_set(values_in_use *v, const run_values *to);

#endif
