/* The ultrasound probe: a rounded cylinder that presses a surface without friction. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_PROBE_H
#define TROCAR_PUBLIC_PROBE_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The scene's keys "probe.": a cylinder along its local +z, from its base, where the hand holds it, to its tip at z = length. */
typedef struct trocar_probe_shape {
    double radius;           /* m */
    double tip_radius;       /* m, of the rounded edge at its end */
    double length;           /* m, from base to tip */
    int32_t surface;         /* index of the region, a surface, that the probe presses */
    int32_t reserved;        /* 0 */
} trocar_probe_shape;
TROCAR_API int trocar_model_probe(const trocar_model *model, trocar_probe_shape *shape);  /* 1, or 0 if the scene has no probe. [any, RT] */
TROCAR_API int trocar_model_probe_start(const trocar_model *model, trocar_pose *start);   /* "probe.start.": 1, or 0 if there is none. [any, RT] */

/* Moves the probe; the newest pose counts. The worker solves for it, in lockstep the next step. BAD_INPUT, without effect, for a pose as in reset, and if
   the scene has no probe. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_set_probe(trocar_sim *sim, const trocar_pose *base, trocar_error *error);

enum { TROCAR_MAX_PRESSED = 256 };

/* The probe as last solved: trocar_view_probe. */
typedef struct trocar_probe {
    trocar_pose base;
    double force[3];         /* N, world frame: exerted by the probe on the hand */
    double torque[3];        /* N m, world frame, about the base point */
    int32_t contacts;        /* points of the surface that it presses, nodes and middles of edges; at most TROCAR_MAX_PRESSED */
    int32_t placed;          /* 0: the scene has no probe, or no acceptable pose has been given yet; everything except `stopped` is 0 then */
    int32_t stopped;         /* 1: the tissue keeps it from the last pose given, and it stays at `base`: its force would exceed the scene's
                                probe.max_force, or it jumped and its axis would lie in the tissue */
    int32_t reserved;        /* 0 */
} trocar_probe;

#ifdef __cplusplus
}
#endif
#endif
