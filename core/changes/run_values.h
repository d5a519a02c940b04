/* The parameters that may change during a run, and how they change over a given time. See docs/training/changes.md. */
#ifndef TROCAR_RUN_VALUES_H
#define TROCAR_RUN_VALUES_H

#include "model/model_parts.h"

/* Structs with parameters that may change (the scene key table says which). Their other members are copies of the model's. */
typedef struct {
    region_material materials[MESH_MAX_GROUPS];
    membrane membranes[MAX_MEMBRANES];
    membrane_material sheets[MAX_MEMBRANES]; /* stiffnesses of the membranes. As with the moduli, these are the values last set; elasticity.c moves towards them
                                                gradually */
    calcification calcifications[MAX_CALCIFICATIONS];
    guide guides[MAX_GUIDES];
} run_values;

/* A set of values in use, and the constants of an insertion that uses them. Do not move it in memory: `model` points to `now`. During a change, every value is
   a linear function of simulated time. */
typedef struct {
    insertion_model model;
    run_values now, from, to; /* `from` and `to`: values at the beginning and the end of the last change. The materials' moduli in `now` belong to elasticity.c,
                                 which changes them together with the tissue's compliance */
    double duration;         /* s, duration of the last change; 0 before the first */
    double part;             /* from 0 to 1, how much of the last change is complete */
    double time;             /* s, simulated time to which `now` belongs */
} values_in_use;

/* Copies the values of a model. */
void run_values_of(const model_parts *parts, run_values *values);

/* Copies from a configuration the values that may change. The configuration's entries must have the same names as the model's. */
void run_values_bind(const model_parts *parts, const simulation_config *config, run_values *values);

/* Does the reverse: writes the values to the model's configuration. */
void run_values_unbind(const model_parts *parts, const run_values *values, simulation_config *config);

/* Initialises the set with the model's values. */
void values_begin(const model_parts *parts, values_in_use *v);

/* Begins, at `time` (s), a change from the values now in use to others. RT */
void values_change(values_in_use *v, const run_values *to, double time, double duration);

/* Advances the values to a later time (s), but in each call by at most a small fraction of the change, so that the force does not jump after a late tick. RT */
void values_follow(values_in_use *v, double time);

/* Switches to other values at once, except for the materials' moduli. RT */
void values_set(values_in_use *v, const run_values *to);

#endif
