/* New values for a running simulation, given by scene keys. See docs/training/changes.md. */
#ifndef TROCAR_CHANGE_H
#define TROCAR_CHANGE_H

#include "changes/run_values.h"
#include "scene/scene.h"
#include "trocar.h"

typedef struct {
    const model_parts *parts;
    scene values;            /* `simulation` is the model's configuration with the changed values; the other members have their defaults */
    run_values bound;        /* the changed values in the form that a simulation uses */
} change_values;

/* Initialises a change with the values in use or, if `in_use` is NULL, with the model's. */
void change_begin(const model_parts *parts, const run_values *in_use, change_values *change);

/* These functions are described in trocar/change.h. */
trocar_status change_set(change_values *change, const char *lines, trocar_error *why);
int change_count(const change_values *change);
int change_at(const change_values *change, int index, char key[TROCAR_CHANGE_KEY], double *value);

#endif
