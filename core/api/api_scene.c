/* Implements trocar/scene.h. */
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "api/view.h"

int trocar_version(void) { return TROCAR_NUMBER; }

/* ---- creation ------------------------------------------------------------------------------------------------------------ */

static void free_mesh(trocar_scene *s) {
    for (int i = 0; s->names && i < s->mesh.region_count + s->mesh.surface_count; i++) free(s->names[i]);
    free(s->names);
    free((void *)s->mesh.nodes);
    free((void *)s->mesh.tets);
    free((void *)s->mesh.tet_region);
    free((void *)s->mesh.triangles);
    free((void *)s->mesh.triangle_surface);
    s->mesh = (trocar_mesh){0};
    s->names = NULL;
    s->values.simulation.mesh_given = NULL;
}

trocar_status trocar_scene_create(trocar_scene **scene, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    *scene = calloc(1, sizeof **scene);
    if (!*scene) return fail(why, TROCAR_NO_MEMORY, "no memory for a scene");
    scene_defaults(&(*scene)->values);
    return TROCAR_OK;
}

trocar_status trocar_scene_load(const char *path, trocar_scene **scene, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_status status = trocar_scene_create(scene, why);
    if (status == TROCAR_OK) status = scene_load(path, &(*scene)->values, why);
    if (status == TROCAR_OK) return TROCAR_OK;
    trocar_scene_free(*scene);
    *scene = NULL;
    return status;
}

void trocar_scene_free(trocar_scene *scene) {
    if (!scene) return;
    free_mesh(scene);
    free(scene);
}

/* ---- keys ---------------------------------------------------------------------------------------------------------------- */

trocar_status trocar_scene_set(trocar_scene *scene, const char *key, const char *value, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_status status = scene_set(&scene->values, key, value, why);
    if (status == TROCAR_OK && strcmp(key, "mesh") == 0) free_mesh(scene);
    return status;
}

trocar_status trocar_scene_set_number(trocar_scene *scene, const char *key, double value, trocar_error *error) {
    char text[32];
    decimal_print(text, sizeof text, "%.17g", value);
    return trocar_scene_set(scene, key, isinf(value) ? value > 0 ? ".inf" : "-.inf" : text, error);
}

trocar_status trocar_scene_get(const trocar_scene *scene, const char *key, char *value, size_t size, trocar_error *error) {
    trocar_error ignored;
    return scene_get(&scene->values, key, value, size, error ? error : &ignored);
}

trocar_status trocar_scene_get_number(const trocar_scene *scene, const char *key, double *value, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    char text[64], *end;
    trocar_status status = scene_get(&scene->values, key, text, sizeof text, why);
    if (status != TROCAR_OK) return status;
    *value = strcmp(text, ".inf") == 0 ? INFINITY : decimal_read(text, &end);
    if (strcmp(text, ".inf") != 0 && (end == text || *end)) return fail(why, TROCAR_BAD_INPUT, "%s: \"%s\" is not a number", key, text);
    return TROCAR_OK;
}

const char *trocar_scene_path(const trocar_scene *scene) { return scene->values.path; }

trocar_device_limits trocar_scene_device(const trocar_scene *scene) { return device_limits_at_needle(&scene->values.device, &scene->values.mapping); }

int trocar_scene_start(const trocar_scene *scene, trocar_pose *start) {
    return start_out(scene->values.start, start);
}

int trocar_scene_patient_to_mesh(const trocar_scene *scene, double matrix[16]) {
    return transform_out(scene->values.patient_to_mesh, matrix);
}

int trocar_scene_count(const trocar_scene *scene, const char *list) {
    const simulation_config *c = &scene->values.simulation;
    return strcmp(list, "regions") == 0 ? c->region_count : strcmp(list, "membranes") == 0 ? c->membrane_count
         : strcmp(list, "guides") == 0  ? c->guide_count : strcmp(list, "calcifications") == 0 ? c->calcification_count
         : strcmp(list, "sliding") == 0 ? c->sliding_count
         : strcmp(list, "fixed") == 0   ? c->fixed_count : strcmp(list, "relaxation") == 0 ? c->relaxation_count : -1;
}

int trocar_key_count(void) { return scene_key_count(); }

/* Prints a key's default; for a key in a list, the value that a new entry starts with. */
static void print_default(const scene *standard, const char *key, char *text, size_t size) {
    trocar_error ignored;
    char first[128];
    const char *brackets = strstr(key, "[]");
    snprintf(first, sizeof first, "%.*s%s%s", (int)(brackets ? brackets - key : (long)strlen(key)), key, brackets ? "[0]" : "",
             brackets ? brackets + 2 : "");
    if (scene_get(standard, first, text, size, &ignored) != TROCAR_OK) text[0] = '\0';
}

/* The table of keys, built once, by the first thread that needs it. */
static trocar_key key_table[SCENE_KEYS_MOST];
static pthread_once_t keys_once = PTHREAD_ONCE_INIT;
static void make_keys(void) {
    enum { ROOM = 64 };
    static char defaults[SCENE_KEYS_MOST][ROOM];
    static scene standard;
    trocar_error ignored;
    scene_defaults(&standard);
    scene_set(&standard, "regions[any].poisson_ratio", "0.45", &ignored);
    scene_set(&standard, "guides[any].rows", "1", &ignored);
    scene_set(&standard, "calcifications[0].cutting_factor", "5", &ignored);
    scene_set(&standard, "sliding[any].shear_stiffness", "0", &ignored);
    for (int i = 0; i < scene_key_count(); i++) {
        scene_key_info info = scene_key_at(i);
        if (!info.required) print_default(&standard, info.key, defaults[i], ROOM);
        key_table[i] = (trocar_key){info.key, info.unit, info.accepts, defaults[i], info.doc, info.required, (int32_t)info.kind};
    }
}

trocar_key trocar_key_at(int index) {
    pthread_once(&keys_once, make_keys);
    if (index < 0 || index >= scene_key_count()) return (trocar_key){"", "", "", "", "", 0, 0};
    return key_table[index];
}

/* ---- a mesh in memory ------------------------------------------------------------------------------------------------------ */

/* Copies an array of `count` elements of `size` bytes each; `from` may be NULL. Returns false if out of memory. */
static bool copy(const void *from, size_t count, size_t size, const void **to) {
    *to = NULL;
    if (!from || count == 0) return true;
    void *memory = malloc(count * size);
    if (memory) memcpy(memory, from, count * size);
    *to = memory;
    return memory != NULL;
}

static bool copy_names(trocar_scene *s, const trocar_mesh *given) {
    s->names = calloc((size_t)(given->region_count + given->surface_count) + 1, sizeof *s->names);
    if (!s->names) return false;
    for (int i = 0; i < given->region_count; i++)
        if (given->regions[i] && !(s->names[i] = strdup(given->regions[i]))) return false;
    for (int i = 0; i < given->surface_count; i++)
        if (given->surfaces[i] && !(s->names[given->region_count + i] = strdup(given->surfaces[i]))) return false;
    s->mesh.regions = (const char *const *)s->names;
    s->mesh.surfaces = (const char *const *)s->names + given->region_count;
    return true;
}

trocar_status trocar_scene_set_mesh(trocar_scene *scene, const trocar_mesh *given, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_status status = mesh_arrays_check(given, why);
    if (status != TROCAR_OK) return status;
    free_mesh(scene);
    scene->mesh = *given;
    size_t nodes = (size_t)given->node_count, tets = (size_t)given->tet_count, triangles = (size_t)given->triangle_count;
    const void *copied[5] = {NULL};
    bool done = copy(given->nodes, 3 * nodes, sizeof(double), &copied[0]) && copy(given->tets, 4 * tets, sizeof(int32_t), &copied[1])
              && copy(given->tet_region, tets, sizeof(int32_t), &copied[2]) && copy(given->triangles, 3 * triangles, sizeof(int32_t), &copied[3])
              && copy(given->triangle_surface, triangles, sizeof(int32_t), &copied[4]) && copy_names(scene, given);
    scene->mesh.nodes = copied[0];
    scene->mesh.tets = copied[1];
    scene->mesh.tet_region = copied[2];
    scene->mesh.triangles = copied[3];
    scene->mesh.triangle_surface = copied[4];
    if (!done) {
        free_mesh(scene);
        return fail(why, TROCAR_NO_MEMORY, "no memory for a mesh of %d nodes", given->node_count);
    }
    scene->values.simulation.mesh_given = &scene->mesh;
    return TROCAR_OK;
}

trocar_status trocar_scene_copy(const trocar_scene *scene, trocar_scene **copied, trocar_error *error) {
    trocar_status status = trocar_scene_create(copied, error);
    if (status != TROCAR_OK) return status;
    (*copied)->values = scene->values;
    (*copied)->values.simulation.mesh_given = NULL;
    if (!scene->values.simulation.mesh_given) return TROCAR_OK;
    status = trocar_scene_set_mesh(*copied, &scene->mesh, error);
    if (status == TROCAR_OK) return TROCAR_OK;
    trocar_scene_free(*copied);
    *copied = NULL;
    return status;
}
