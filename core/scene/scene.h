/* The scene: what to simulate, as a YAML file or the caller of the library says it. Every key is one row of a table (scene.c),
   which reading, setting, printing and the reference table of the documentation share. */
#ifndef TROCAR_SCENE_H
#define TROCAR_SCENE_H

#include "scene/device.h"
#include "insertion/simulation.h"

#define SCENE_MIN_RATE 250.0   /* Hz, limits on rate_hz */
#define SCENE_MAX_RATE 10000.0 /* Hz */

typedef struct {
    char path[1024];         /* of the scene file, empty without one: relative paths start from its directory */
    simulation_config simulation;
    double rate_hz;          /* of the haptic loop */
    char profile[MESH_NAME]; /* of the device, empty: none */
    device_limits device;
} scene;

/* A scene without mesh, regions or fixed groups; every other value is its default. */
void scene_defaults(scene *s);

/* Reads a scene file over the defaults. BAD_INPUT with file, line and key for an unknown, missing or repeated key and for a
   value of the wrong kind or out of range. Names are compared with the mesh's later, by simulation_create. */
trocar_status scene_load(const char *path, scene *s, report *why);

/* Sets one key from YAML text: "needle.length" to "0.15", "fixed" to "[back, below]". Entries of a list are chosen by index or
   by name, as in "regions[0].poisson_ratio" or "regions[prostate].friction.static"; a new name appends an entry. BAD_INPUT
   leaves the scene as it was. */
trocar_status scene_set(scene *s, const char *key, const char *value, report *why);

/* Prints the value of a key as YAML. BAD_INPUT when there is no such key or no such entry, or when `size` bytes are too few. */
trocar_status scene_get(const scene *s, const char *key, char *value, size_t size, report *why);

/* Checks what needs more than one key: mandatory ones, and values that must fit each other. */
trocar_status scene_check(const scene *s, report *why);

/* One row of the reference table. The strings live as long as the program. */
typedef struct {
    const char *key;         /* "regions[].friction.static": one for each entry of the list */
    const char *unit;        /* "" where there is none */
    const char *accepts;     /* "a number above 0", "rod or tetrahedra" */
    const char *doc;
    bool required;
} scene_key_info;

int scene_key_count(void);
scene_key_info scene_key_at(int index);

#endif
