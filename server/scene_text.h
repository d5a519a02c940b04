/* The scene file as it is written: every value a text, NULL where it is absent. scene.c gives it meaning. */
#ifndef TROCAR_SCENE_TEXT_H
#define TROCAR_SCENE_TEXT_H

#include <stddef.h>

#include "yaml_lines.h"

typedef struct { char *static_limit, *kinetic, *viscous; } friction_text;

typedef struct {
    char *name, *youngs_modulus, *poisson_ratio, *cutting_force, *cutting_viscosity;
    friction_text friction;
} region_text;

typedef struct { char *name, *puncture_force; } membrane_text;

typedef struct {
    char *model, *length, *outer_diameter, *inner_diameter, *youngs_modulus, *poisson_ratio, *bevel_slope, *segments;
} needle_text;

typedef struct {
    char *placement, *spacing, *resolution, *weakening_distance, *prefetch_distance, *max_passes, *tolerance;
} contact_text;

typedef struct {
    char *profile, *max_stiffness, *max_force, *max_torque, *max_force_rate, *max_torque_rate, *max_speed, *max_turn_rate, *hold_time, *ramp_time;
} device_text;

typedef struct {
    char **from, **to, *radius;
    unsigned from_count, to_count;
} corridor_text;

typedef struct {
    char **regions;
    unsigned regions_count;
    corridor_text corridor;
} region_of_interest_text;

typedef struct {
    char *mesh, *mesh_unit, *rate_hz, *remeshing, *inverse, *cache, *volumetric_strain;
    region_text *regions;
    membrane_text *membranes;
    char **fixed;
    unsigned regions_count, membranes_count, fixed_count;
    needle_text needle;
    contact_text contact;
    device_text device;
    region_of_interest_text region_of_interest;
} scene_text;

/* Reads YAML by the schema. BAD_INPUT, with `name`, line and key, for an unknown, missing or repeated key and for a
   value of the wrong shape. `lines` belongs to the same text. */
trocar_status scene_text_read(const char *name, const char *yaml, size_t length, yaml_lines *lines, scene_text **text,
                              report *why);
void scene_text_free(scene_text *text);

#endif
