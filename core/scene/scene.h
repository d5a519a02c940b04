/* The scene, read from a YAML file or set by calls. Each key is one row of a table (scene_table.c). Reading, setting and printing keys all use this table, and
   so does the reference documentation. */
#ifndef TROCAR_SCENE_H
#define TROCAR_SCENE_H

#include "scene/scene_struct.h"

/* Sets all values to their defaults. The scene then has no mesh, regions or fixed groups. */
void scene_defaults(scene *s);

/* Reads a scene file on top of the default values. BAD_INPUT with file, line and key if a key is unknown, missing or repeated, or if its value has the wrong
   type or is out of range. Names are checked against the mesh later. */
trocar_status scene_load(const char *path, scene *s, trocar_error *why);

/* Sets one key from YAML, for example "needle.length" to "0.15" or "fixed" to "[back, below]". List entries are given by index or name, as in
   "regions[0].poisson_ratio" or "regions[prostate].friction.static"; a new name appends an entry. On BAD_INPUT, the scene is unchanged. */
trocar_status scene_set(scene *s, const char *key, const char *value, trocar_error *why);

/* Like scene_set, but for changes during a run: rejects keys that cannot change then, and never appends an entry. */
trocar_status scene_set_live(scene *s, const char *key, const char *value, trocar_error *why);

/* Writes the key's value to `value` as NUL-terminated YAML. BAD_INPUT if there is no such key or entry, or if `size` is too small. */
trocar_status scene_get(const scene *s, const char *key, char *value, size_t size, trocar_error *why);

/* Checks the scene as a whole: that required keys are present and that values are consistent with each other. */
trocar_status scene_check(const scene *s, trocar_error *why);

#endif
