/* Scenes: what to simulate. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_SCENE_H
#define TROCAR_PUBLIC_SCENE_H

#include "trocar/errors.h"
#include "trocar/pose.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The contents of a scene file; the reference of scene keys lists its keys. */
typedef struct trocar_scene trocar_scene;

/* ---- creation ---- */

/* Creates an empty scene with the defaults of all keys; set mesh, regions and fixed. NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_scene_create(trocar_scene **scene, trocar_error *error);

/* Reads a YAML file. BAD_INPUT with file, line and key. [any, allocates] */
TROCAR_API trocar_status trocar_scene_load(const char *path, trocar_scene **scene, trocar_error *error);

/* Creates an independent copy, including a mesh in memory. NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_scene_copy(const trocar_scene *scene, trocar_scene **copy, trocar_error *error);
TROCAR_API void trocar_scene_free(trocar_scene *scene);

/* ---- keys ---- */

/* Sets a key to a value written as in YAML: ("needle.length", "0.15"), ("fixed", "[back, below]"). A list entry is named by index or name:
   "regions[prostate].friction.static"; an unknown name appends an entry. BAD_INPUT leaves the scene unchanged. [one, allocates] */
TROCAR_API trocar_status trocar_scene_set(trocar_scene *scene, const char *key, const char *value, trocar_error *error);
TROCAR_API trocar_status trocar_scene_set_number(trocar_scene *scene, const char *key, double value, trocar_error *error);

/* Writes the value of a key as in YAML, ended by 0. BAD_INPUT if there is no such key or entry, or if `size` is too small. [one] */
TROCAR_API trocar_status trocar_scene_get(const trocar_scene *scene, const char *key, char *value, size_t size, trocar_error *error);
TROCAR_API trocar_status trocar_scene_get_number(const trocar_scene *scene, const char *key, double *value, trocar_error *error);

/* The number of entries of "regions", "membranes", "guides", "fixed" or "relaxation"; -1 for another key. [one] */
TROCAR_API int trocar_scene_count(const trocar_scene *scene, const char *list);

/* The path from which the scene was loaded, as given; "" if it was not loaded. Valid as long as the scene. [one] */
TROCAR_API const char *trocar_scene_path(const trocar_scene *scene);

/* Limits of the key "rate_hz", Hz. */
#define TROCAR_MIN_RATE 250.0
#define TROCAR_MAX_RATE 10000.0

/* Limits of the haptic device: the keys "device.", for hosts that enforce them. */
typedef struct trocar_device_limits {
    double max_stiffness;    /* N/m, of the virtual coupling; INFINITY: no coupling, the needle follows rigidly */
    double max_force;        /* N */
    double max_torque;       /* N m */
    double max_force_rate;   /* N/s */
    double max_torque_rate;  /* N m/s */
    double max_speed;        /* m/s, of the base point */
    double max_turn_rate;    /* rad/s */
    double hold_time;        /* s without a pose before the wrench is ramped down */
    double ramp_time;        /* s from the full wrench to none, and back */
    double mass;             /* kg, of device and hand at the handle; the virtual coupling allows for half of it */
    double delay;            /* s, round trip between bridge and device: from a force until positions show its effect */
} trocar_device_limits;
TROCAR_API trocar_device_limits trocar_scene_device(const trocar_scene *scene); /* [one] */

/* The pose of the first needle's base before the insertion: the keys "needle.start.". Returns 1 and the pose, or 0 if there is none. [one] */
TROCAR_API int trocar_scene_start(const trocar_scene *scene, trocar_pose *start);

/* Transform from the patient's coordinates to the mesh's, as trocar_model_patient_to_mesh. Returns 1 and the matrix, or 0 if there is none. [one] */
TROCAR_API int trocar_scene_patient_to_mesh(const trocar_scene *scene, double matrix[16]);

/* ---- a mesh in memory ---- */

/* A tetrahedral mesh. Tetrahedra may have either orientation. */
typedef struct trocar_mesh {
    int32_t node_count, tet_count;
    const double *nodes;             /* 3 node_count, m */
    const int32_t *tets;             /* 4 tet_count, node indices from 0 */
    const int32_t *tet_region;       /* tet_count: index into `regions`; NULL: all are in region 0 */
    int32_t region_count;
    const char *const *regions;      /* names */
    int32_t triangle_count;          /* triangles of named surfaces: faces of tetrahedra */
    const int32_t *triangles;        /* 3 triangle_count */
    const int32_t *triangle_surface; /* triangle_count: index into `surfaces` */
    int32_t surface_count;
    const char *const *surfaces;     /* names: for membranes and `fixed` */
} trocar_mesh;

/* Takes the mesh from arrays, which are copied, instead of a file. BAD_INPUT for indices out of range and the like; trocar_model_create checks the
   mesh itself. [one, allocates] */
TROCAR_API trocar_status trocar_scene_set_mesh(trocar_scene *scene, const trocar_mesh *mesh, trocar_error *error);

/* ---- the table of keys ---- */

/* How a key's value is written. */
typedef enum trocar_key_kind {
    TROCAR_KEY_NUMBER = 0,
    TROCAR_KEY_TEXT = 1,     /* a word, name or path */
    TROCAR_KEY_NUMBERS = 2,  /* a list of numbers */
    TROCAR_KEY_NAMES = 3     /* a list of names */
} trocar_key_kind;

/* One row of the reference table of keys. The strings live as long as the program. */
typedef struct trocar_key {
    const char *key;         /* "regions[].friction.static": one for each list entry */
    const char *unit;        /* "" if there is none */
    const char *accepts;     /* "a number above 0" */
    const char *default_value; /* "" if there is none */
    const char *doc;
    int required;
    int32_t kind;            /* trocar_key_kind */
} trocar_key;
TROCAR_API int trocar_key_count(void);            /* [any, RT] */
TROCAR_API trocar_key trocar_key_at(int index);   /* all members are empty if `index` is out of range. [any] */

#ifdef __cplusplus
}
#endif
#endif
