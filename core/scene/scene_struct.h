/* The values of a scene, and the rows of the reference table. */
#ifndef TROCAR_SCENE_STRUCT_H
#define TROCAR_SCENE_STRUCT_H

#include "scene/device.h"
#include "scene/simulation_config.h"

#define SCENE_MIN_RATE 250.0   /* Hz, lower limit of rate_hz */
#define SCENE_MAX_RATE 10000.0 /* Hz, upper limit of rate_hz */

typedef struct {
    char path[1024];         /* path of the scene file, whose directory relative paths start from; empty if there is no file */
    simulation_config simulation;
    double rate_hz;          /* Hz, rate of the haptic loop */
    int phase_lock;          /* 1 to make ticks begin when poses arrive */
    char profile[1024];      /* name or path of the device profile; empty if none */
    device_limits device;    /* limits at the handle */
    device_mapping mapping;  /* mapping between hand and needle */
    pose start;              /* initial pose of the needle's base, outside the tissue; the position is NAN if not given */
    double start_depth;      /* m, insertion depth of scripted motions, which start at `start` */
    double patient_to_mesh[16]; /* transform from patient coordinates (mm, LPS) to mesh coordinates (m), row-major; the first entry is NAN if not given */
} scene;

/* One row of the reference table. The strings are never freed. */
typedef struct {
    const char *key;         /* the key in generic form, for example "regions[].friction.static" for all entries of the list */
    const char *unit;        /* empty if the value has no unit */
    const char *accepts;     /* what values are allowed, for example "a number above 0" or "rod or tetrahedra" */
    const char *doc;
    bool required;
    trocar_key_kind kind;
} scene_key_info;

enum { SCENE_KEYS_MOST = 256 };
int scene_key_count(void);
scene_key_info scene_key_at(int index); /* not thread-safe */

#endif
