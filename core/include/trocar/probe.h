/* The ultrasound probe: a frictionless cylinder with a rounded end that presses on a surface. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_PROBE_H
#define TROCAR_PUBLIC_PROBE_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The probe's shape, from the scene's "probe." keys: a cylinder along local +z, from the base, where the hand holds it, to the tip at z = length. */
typedef struct trocar_probe_shape {
    double radius;           /* m */
    double tip_radius;       /* m, radius of the rounded edge at the end */
    double length;           /* m, from base to tip */
    int32_t surface;         /* index of the surface (a region of dimension 2) that the probe presses on */
    int32_t reserved;        /* 0 */
} trocar_probe_shape;
TROCAR_API int trocar_model_probe(const trocar_model *model, trocar_probe_shape *shape);  /* returns 1, or 0 if the scene has no probe. [any, RT] */
TROCAR_API int trocar_model_probe_start(const trocar_model *model, trocar_pose *start);   /* initial pose from "probe.start."; returns 1, or 0 if the scene
                                                                                             gives none. [any, RT] */

/* Moves the probe. The worker (in lockstep, the next step) solves for the newest pose and skips older ones. BAD_INPUT, changing nothing, for a pose that
   trocar_sim_reset would reject, or if the scene has no probe. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_set_probe(trocar_sim *sim, const trocar_pose *base, trocar_error *error);

enum { TROCAR_MAX_PRESSED = 256 };

/* The probe's state in the last solution, as returned by trocar_view_probe. */
typedef struct trocar_probe {
    trocar_pose base;
    double force[3];         /* N, world frame: force that the probe exerts on the hand */
    double torque[3];        /* N m, world frame: torque on the hand about the base point */
    int32_t contacts;        /* number of surface points (nodes and edge midpoints) that the probe presses on; at most TROCAR_MAX_PRESSED */
    int32_t placed;          /* 0 if the scene has no probe, or no acceptable pose has been given yet; everything except `stopped` is then 0 */
    int32_t stopped;         /* 1 if the probe stays at `base` instead of following the commanded pose, because its force would exceed the scene's
                                probe.max_force, or because the pose jumped and would put the probe's axis in the tissue; stays 1 until the probe has
                                caught up with the commanded pose */
    int32_t reserved;        /* 0 */
} trocar_probe;

#ifdef __cplusplus
}
#endif
#endif
