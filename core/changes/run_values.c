#include "changes/run_values.h"

#include <string.h>

void run_values_of(const model_parts *parts, run_values *values) {
    memcpy(values->materials, parts->materials, sizeof values->materials);
    memcpy(values->membranes, parts->membranes, sizeof values->membranes);
    for (int i = 0; i < parts->config.membrane_count; i++) values->sheets[i] = parts->config.membranes[i].material;
    memcpy(values->calcifications, parts->config.calcifications, sizeof values->calcifications);
    memcpy(values->guides, parts->guides, sizeof values->guides);
}

/* Copies one parameter from a configuration to the values in use, or back. */
typedef void (*copier)(double *of_config, double *in_use);

static void for_each_value(const model_parts *parts, simulation_config *config, run_values *values, copier copy) {
    for (int i = 0; i < config->region_count; i++) {
        region_material *given = &config->regions[i].material, *used = &values->materials[mesh_find_group(&parts->mesh, config->regions[i].name, 3)];
        copy(&given->youngs_modulus, &used->youngs_modulus);
        copy(&given->stiffening, &used->stiffening);
        copy(&given->cutting_force, &used->cutting_force);
        copy(&given->cutting_viscosity, &used->cutting_viscosity);
        copy(&given->spreading_force, &used->spreading_force);
        copy(&given->friction_static, &used->friction_static);
        copy(&given->friction_kinetic, &used->friction_kinetic);
        copy(&given->friction_viscous, &used->friction_viscous);
    }
    for (int i = 0; i < config->membrane_count; i++) {
        copy(&config->membranes[i].puncture_force, &values->membranes[i].puncture_force);
        copy(&config->membranes[i].material.stiffness, &values->sheets[i].stiffness);
    }
    for (int i = 0; i < config->calcification_count; i++) copy(&config->calcifications[i].cutting_factor, &values->calcifications[i].cutting_factor);
    for (int i = 0; i < config->guide_count; i++) {
        copy(&config->guides[i].stiffness, &values->guides[i].stiffness);
        copy(&config->guides[i].friction, &values->guides[i].friction);
    }
}

static void to_use(double *of_config, double *in_use) { *in_use = *of_config; }
static void to_config(double *of_config, double *in_use) { *of_config = *in_use; }

void run_values_bind(const model_parts *parts, const simulation_config *config, run_values *values) {
    for_each_value(parts, (simulation_config *)config, values, to_use); /* cast away const: to_use does not write to the configuration */
}

void run_values_unbind(const model_parts *parts, const run_values *values, simulation_config *config) {
    for_each_value(parts, config, (run_values *)values, to_config);
}

void values_begin(const model_parts *parts, values_in_use *v) {
    run_values_of(parts, &v->now);
    v->from = v->to = v->now;
    v->duration = v->time = 0.0;
    v->part = 1.0;
    v->model = parts->insertion;
    v->model.materials = v->now.materials;
    v->model.membranes = v->now.membranes;
    v->model.calcifications = v->now.calcifications;
    v->model.guides = v->now.guides;
}

void values_change(values_in_use *v, const run_values *to, double time, double duration) {
    v->from = v->now;
    v->to = *to;
    v->duration = duration;
    v->part = 0.0;
    v->time = time;
}

/* Switches to the change's final values, except for the materials' moduli. */
static void settle(values_in_use *v) {
    region_material before[MESH_MAX_GROUPS];
    memcpy(before, v->now.materials, sizeof before);
    v->now = v->to;
    for (int g = 0; g < MESH_MAX_GROUPS; g++) {
        v->now.materials[g].youngs_modulus = before[g].youngs_modulus;
        v->now.materials[g].stiffening = before[g].stiffening;
    }
}

void values_set(values_in_use *v, const run_values *to) {
    v->from = v->to = *to;
    settle(v);
}

/* Interpolates linearly, so that a linear condition that holds at both ends also holds in between: for example, that kinetic friction does not exceed static
   friction. */
static void move(values_in_use *v) {
    const run_values *a = &v->from, *b = &v->to;
    double part = v->part;
    for (int i = 0; i < MESH_MAX_GROUPS; i++) {
        const region_material *from = &a->materials[i], *to = &b->materials[i];
        region_material *m = &v->now.materials[i];
        m->cutting_force = value_between(from->cutting_force, to->cutting_force, part);
        m->cutting_viscosity = value_between(from->cutting_viscosity, to->cutting_viscosity, part);
        m->spreading_force = value_between(from->spreading_force, to->spreading_force, part);
        m->friction_static = value_between(from->friction_static, to->friction_static, part);
        m->friction_kinetic = value_between(from->friction_kinetic, to->friction_kinetic, part);
        m->friction_viscous = value_between(from->friction_viscous, to->friction_viscous, part);
    }
    for (int i = 0; i < v->model.membrane_count; i++) v->now.membranes[i].puncture_force = value_between(a->membranes[i].puncture_force, b->membranes[i].puncture_force, part);
    for (int i = 0; i < v->model.calcification_count; i++)
        v->now.calcifications[i].cutting_factor = value_between(a->calcifications[i].cutting_factor, b->calcifications[i].cutting_factor, part);
    for (int i = 0; i < v->model.guide_count; i++) {
        v->now.guides[i].stiffness = value_between(a->guides[i].stiffness, b->guides[i].stiffness, part);
        v->now.guides[i].friction = value_between(a->guides[i].friction, b->guides[i].friction, part);
    }
}

static const double WHOLE = 1.0 - 1e-9; /* fraction above which a change counts as complete. Rounding tolerance */

void values_follow(values_in_use *v, double time) {
    static const double MOST = 0.02; /* largest fraction of a change per tick. Chosen: twice what a 1 ms tick contributes to the shortest change */
    if (v->part == 1.0) return;
    v->part += smaller_of((time - v->time) / v->duration, MOST);
    v->time = time;
    if (v->part > WHOLE) v->part = 1.0;
    if (v->part < 1.0) move(v);
    else settle(v);
}
