/* The scene's values, and the reference table of its keys. */
#ifndef TROCAR_SCENE_STRUCT_H
#define TROCAR_SCENE_STRUCT_H

#include "insertion/simulation.h"
#include "scene/device.h"

#define SCENE_MIN_RATE 250.0   /* Hz, lower limit of rate_hz */
#define SCENE_MAX_RATE 10000.0 /* Hz, upper limit of rate_hz */

typedef struct {
    char path[1024];         /* path of the scene file, empty if there is none: relative paths start from its directory */
    simulation_config simulation;
    double rate_hz;          /* rate of the haptic loop */
    int phase_lock;          /* 1: ticks begin when poses arrive */
    char profile[MESH_NAME]; /* name of the device profile; empty: none */
    device_limits device;
    pose start;              /* initial pose of the needle's base, outside the tissue; NAN position: none */
    double start_depth;      /* m, depth to which scripted motions insert the needle from `start` */
    int only_one;            /* value of keys that accept only one value: 0 */
    double patient_to_mesh[16]; /* row by row, from the patient's mm (LPS) to the mesh's m; the first entry is NAN if there is none */
} scene;

/* One row of the reference table. The strings live as long as the program. */
typedef struct {
    const char *key;         /* for all list entries, such as "regions[].friction.static" */
    const char *unit;        /* "" if the value has no unit */
    const char *accepts;     /* accepted values, such as "a number above 0" or "rod or tetrahedra" */
    const char *doc;
    bool required;
    trocar_key_kind kind;
} scene_key_info;

enum { SCENE_KEYS_MOST = 256 };
int scene_key_count(void);
scene_key_info scene_key_at(int index); /* not thread-safe */

#endif
