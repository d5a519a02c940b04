/* The scene file: what a server or a replay simulates. All its keys are in the table of README.md. */
#ifndef TROCAR_SCENE_H
#define TROCAR_SCENE_H

#include "guard.h"
#include "simulation.h"

/* Limits on rate_hz, also for those who replace it. */
#define SCENE_MIN_RATE 250.0   /* Hz */
#define SCENE_MAX_RATE 10000.0 /* Hz */

typedef struct {
    char path[1024];         /* of the scene file */
    simulation_config simulation;
    double rate_hz;          /* of the haptic loop */
    guard_limits guard;
} scene;

/* Reads a scene file; what it leaves out has the value of simulation_defaults, region_defaults or guard_defaults.
   BAD_INPUT with file, line and key for whatever the schema or a range refuses. Names are compared with the mesh's
   later, by simulation_create. */
trocar_status scene_load(const char *path, scene *s, report *why);

#endif
