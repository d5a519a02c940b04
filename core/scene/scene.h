/* The scene, read from a YAML file or set by calls. Every key is one row of a table (scene_table.c), which is shared by the code that reads, sets and
   prints keys and by the reference documentation. */
#ifndef TROCAR_SCENE_H
#define TROCAR_SCENE_H

#include "scene/scene_struct.h"

/* Sets a scene to default values; it has no mesh, regions or fixed groups. */
void scene_defaults(scene *s);

/* Reads a scene file into a scene with default values. BAD_INPUT with file, line and key if a key is unknown, missing or repeated, or if a value has the
   wrong type or is out of range. Names are checked against the mesh later. */
trocar_status scene_load(const char *path, scene *s, trocar_error *why);

/* Sets one key to a value given as YAML, for example "needle.length" to "0.15" or "fixed" to "[back, below]". List entries are identified by index or name, as
   in "regions[0].poisson_ratio" or "regions[prostate].friction.static"; a new name appends an entry. BAD_INPUT leaves the scene unchanged. */
trocar_status scene_set(scene *s, const char *key, const char *value, trocar_error *why);

/* Like scene_set, but for a change during a run: refuses keys that cannot change then, and appends no entries. */
trocar_status scene_set_live(scene *s, const char *key, const char *value, trocar_error *why);

/* Prints the value of a key as YAML. BAD_INPUT if there is no such key or entry, or if `size` is too small. */
trocar_status scene_get(const scene *s, const char *key, char *value, size_t size, trocar_error *why);

/* Checks the scene as a whole: whether all required keys are present, and whether values are consistent with each other. */
trocar_status scene_check(const scene *s, trocar_error *why);

#endif
