/* The scene's values, and the reference table of its keys. */
#ifndef TROCAR_SCENE_STRUCT_H
#define TROCAR_SCENE_STRUCT_H

#include "scene/device.h"
#include "scene/simulation_config.h"

#define SCENE_MIN_RATE 250.0   /* Hz, lower limit of rate_hz */
#define SCENE_MAX_RATE 10000.0 /* Hz, upper limit of rate_hz */

typedef struct {
    char path[1024];         /* path of the scene file; relative paths start from its directory; empty if there is no file */
    simulation_config simulation;
    double rate_hz;          /* Hz, rate of the haptic loop */
    int phase_lock;          /* 1: ticks begin when poses arrive */
    char profile[1024];      /* name or path of the device profile; empty if there is none */
    device_limits device;    /* limits that hold at the handle */
    device_mapping mapping;  /* mapping between hand and needle */
    pose start;              /* initial pose of the needle's base, outside the tissue; its position is NAN if none is given */
    double start_depth;      /* m, depth to which scripted motions insert the needle, starting at `start` */
    double patient_to_mesh[16]; /* transform from the patient's coordinates (mm, LPS) to the mesh's (m), row by row; the first entry is NAN if none is given */
} scene;

/* One row of the reference table. The strings are valid for the lifetime of the program. */
typedef struct {
    const char *key;         /* stands for the key of every list entry, for example "regions[].friction.static" */
    const char *unit;        /* empty if the value has no unit */
    const char *accepts;     /* description of the accepted values, for example "a number above 0" or "rod or tetrahedra" */
    const char *doc;
    bool required;
    trocar_key_kind kind;
} scene_key_info;

enum { SCENE_KEYS_MOST = 256 };
int scene_key_count(void);
scene_key_info scene_key_at(int index); /* not thread-safe */

#endif
