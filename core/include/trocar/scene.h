/* Scenes: descriptions of what to simulate. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_SCENE_H
#define TROCAR_PUBLIC_SCENE_H

#include "trocar/errors.h"
#include "trocar/pose.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The contents of a scene file. The scene key reference lists all keys. */
typedef struct trocar_scene trocar_scene;

/* ---- creation ---- */

/* Creates a scene with all keys at their defaults. You must still set `mesh`, `regions` and `fixed`. NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_scene_create(trocar_scene **scene, trocar_error *error);

/* Reads a scene from a YAML file. BAD_INPUT, naming file, line and key; NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_scene_load(const char *path, trocar_scene **scene, trocar_error *error);

/* Creates an independent copy, including any mesh in memory. NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_scene_copy(const trocar_scene *scene, trocar_scene **copy, trocar_error *error);
TROCAR_API void trocar_scene_free(trocar_scene *scene);

/* ---- keys ---- */

/* Sets a key to a value written as in YAML, for example ("needle.length", "0.15") or ("fixed", "[back, below]"). Refer to a list entry by its index or name,
   as in "regions[prostate].friction.static". A new name appends an entry; in a list without names, so does the next index. BAD_INPUT leaves the scene
   unchanged. [one, allocates] */
TROCAR_API trocar_status trocar_scene_set(trocar_scene *scene, const char *key, const char *value, trocar_error *error);
TROCAR_API trocar_status trocar_scene_set_number(trocar_scene *scene, const char *key, double value, trocar_error *error);

/* Writes the key's value to `value` as NUL-terminated YAML. BAD_INPUT if there is no such key or entry, or if `size` is too small. [one] */
TROCAR_API trocar_status trocar_scene_get(const trocar_scene *scene, const char *key, char *value, size_t size, trocar_error *error);
TROCAR_API trocar_status trocar_scene_get_number(const trocar_scene *scene, const char *key, double *value, trocar_error *error);

/* Returns the number of entries of "regions", "membranes", "sliding", "calcifications", "guides", "fixed" or "relaxation"; -1 for any other key. [one] */
TROCAR_API int trocar_scene_count(const trocar_scene *scene, const char *list);

/* Returns the path that was passed to trocar_scene_load, or "" if the scene was not loaded from a file. Valid as long as the scene exists. [one] */
TROCAR_API const char *trocar_scene_path(const trocar_scene *scene);

/* Limits of the key "rate_hz", Hz. */
#define TROCAR_MIN_RATE 250.0
#define TROCAR_MAX_RATE 10000.0

/* Limits of the haptic device, from the "device." keys, for hosts that enforce them. They apply at the needle: they have been converted from the hand's side
   using "device.scale" and "device.force_scale". */
typedef struct trocar_device_limits {
    double max_stiffness;    /* N/m, stiffness of the virtual coupling; INFINITY: no coupling, the needle follows the device rigidly */
    double max_force;        /* N */
    double max_torque;       /* N m */
    double max_force_rate;   /* N/s */
    double max_torque_rate;  /* N m/s */
    double max_speed;        /* m/s, speed of the base point */
    double max_turn_rate;    /* rad/s */
    double hold_time;        /* s; if no new pose arrives for this long, the wrench is ramped down */
    double ramp_time;        /* s, time to ramp the wrench from full to zero, or back */
    double mass;             /* kg, combined mass of device and hand at the handle; the virtual coupling stays stable even if the true mass is half of this */
    double delay;            /* s, round-trip delay between bridge and device, from sending a force until measured positions show its effect */
} trocar_device_limits;
TROCAR_API trocar_device_limits trocar_scene_device(const trocar_scene *scene); /* [one] */

/* Gets the pose of the first needle's base before insertion, from the keys "needle.start.". Returns 1, or 0 without writing if the scene gives none. [one] */
TROCAR_API int trocar_scene_start(const trocar_scene *scene, trocar_pose *start);

/* Gets the transform from patient to mesh coordinates; see trocar_model_patient_to_mesh. Returns 1, or 0 without writing if the scene gives none. [one] */
TROCAR_API int trocar_scene_patient_to_mesh(const trocar_scene *scene, double matrix[16]);

/* ---- a mesh in memory ---- */

/* A tetrahedral mesh. Tetrahedra may have either orientation. */
typedef struct trocar_mesh {
    int32_t node_count, tet_count;
    const double *nodes;             /* [node_count][3], m */
    const int32_t *tets;             /* [tet_count][4], node indices, counted from 0 */
    const int32_t *tet_region;       /* [tet_count]: index into `regions`; NULL if all tetrahedra are in region 0 */
    int32_t region_count;
    const char *const *regions;      /* names */
    int32_t triangle_count;          /* number of triangles on named surfaces; each must be a face of a tetrahedron */
    const int32_t *triangles;        /* [triangle_count][3], node indices */
    const int32_t *triangle_surface; /* [triangle_count]: index into `surfaces` */
    int32_t surface_count;
    const char *const *surfaces;     /* names of surfaces, referred to by membranes and `fixed` */
} trocar_mesh;

/* Uses a copy of these arrays as the scene's mesh, instead of a mesh file. BAD_INPUT for invalid arrays, such as indices out of range;
   trocar_model_create checks the mesh itself. [one, allocates] */
TROCAR_API trocar_status trocar_scene_set_mesh(trocar_scene *scene, const trocar_mesh *mesh, trocar_error *error);

/* ---- the table of keys ---- */

/* The type of a key's value. */
typedef enum trocar_key_kind {
    TROCAR_KEY_NUMBER = 0,
    TROCAR_KEY_TEXT = 1,     /* a word, a name or a path */
    TROCAR_KEY_NUMBERS = 2,  /* a list of numbers */
    TROCAR_KEY_NAMES = 3     /* a list of names */
} trocar_key_kind;

/* One row of the key reference. The strings are valid for the lifetime of the program. */
typedef struct trocar_key {
    const char *key;         /* for example "regions[].friction.static", where "[]" stands for any entry */
    const char *unit;        /* empty if there is none */
    const char *accepts;     /* accepted values, for example "a number above 0" */
    const char *default_value; /* empty if there is none */
    const char *doc;
    int required;
    int32_t kind;            /* trocar_key_kind */
} trocar_key;
TROCAR_API int trocar_key_count(void);            /* [any, RT] */
TROCAR_API trocar_key trocar_key_at(int index);   /* all strings are empty if `index` is out of range. [any] */

#ifdef __cplusplus
}
#endif
#endif
