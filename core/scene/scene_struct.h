/* The scene's values, and the reference table of its keys. */
#ifndef TROCAR_SCENE_STRUCT_H
#define TROCAR_SCENE_STRUCT_H

#include "insertion/simulation.h"
#include "scene/device.h"

#define SCENE_MIN_RATE 250.0   /* Hz, limits on rate_hz */
#define SCENE_MAX_RATE 10000.0 /* Hz */

typedef struct {
    char path[1024];         /* of the scene file, empty if there is none: relative paths start from its directory */
    simulation_config simulation;
    double rate_hz;          /* of the haptic loop */
    int phase_lock;          /* 1: ticks begin when poses come */
    char profile[MESH_NAME]; /* name of the device profile; empty: none */
    device_limits device;
    pose start;              /* of the needle's base, outside the tissue; its position is NAN: none */
    double start_depth;      /* m that scripted motions insert the needle from there */
    int only_one;            /* of keys that have one value left: 0 */
    double patient_to_mesh[16]; /* row by row, patient's mm (LPS) to the mesh's m; the first is NAN: none */
} scene;

/* One row of the reference table. The strings live as long as the program. */
typedef struct {
    const char *key;         /* "regions[].friction.static": one for each list entry */
    const char *unit;        /* "" if there is none */
    const char *accepts;     /* "a number above 0", "rod or tetrahedra" */
    const char *doc;
    bool required;
    trocar_key_kind kind;
} scene_key_info;

enum { SCENE_KEYS_MOST = 256 };
int scene_key_count(void);
scene_key_info scene_key_at(int index); /* one thread at a time */

#endif
