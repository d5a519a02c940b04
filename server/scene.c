#include "scene.h"

#include <errno.h>
#include <float.h>
#include <stdlib.h>
#include <string.h>

#include "scene_text.h"

enum { MAX_FILE = 1 << 20 }; /* bytes; a scene has some thousand */

/* ---- numbers and names, with messages ---- */

/* The file that is being checked. The first fault stays in `why`; later ones are passed over. */
typedef struct {
    const char *file;
    yaml_lines *lines;
    report *why;
    trocar_status status;
    char section[64];        /* prefix of the keys' paths, such as "regions[0]." */
} checker;

typedef struct { double low, high; const char *words; } range;

static const range POSITIVE = {DBL_MIN, DBL_MAX, "a number above 0"};
static const range NOT_NEGATIVE = {0, DBL_MAX, "a number of at least 0"};
static const range FORCE = {0, INFINITY, "a number of at least 0, or .inf"};
static const range STIFFNESS = {DBL_MIN, INFINITY, "a number above 0, or .inf"};
static const range COMPRESSIBLE = {0, 0.49999999, "a number of at least 0 and below 0.5"};
static const range ANY = {-DBL_MAX, DBL_MAX, "a number"};
static const range SLOPE = {0, 1, "a number from 0 to 1"};
static const range RATE = {SCENE_MIN_RATE, SCENE_MAX_RATE, "a number from 250 to 10000"};

__attribute__((format(printf, 2, 3)))
static void enter_section(checker *c, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(c->section, sizeof c->section, format, arguments);
    va_end(arguments);
}

__attribute__((format(printf, 3, 4)))
static void reject(checker *c, const char *key, const char *format, ...) {
    if (c->status != TROCAR_OK) return;
    char path[128], words[512];
    snprintf(path, sizeof path, "%s%s", c->section, key);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(words, sizeof words, format, arguments);
    va_end(arguments);
    c->status = fail(c->why, TROCAR_BAD_INPUT, "%s:%d: %s: %s", c->file, yaml_lines_find(c->lines, path), path, words);
}

/* A decimal number or YAML's infinity, nothing after it. */
static bool parse_number(const char *text, double *value) {
    static const char *const infinities[] = {".inf", ".Inf", ".INF", "+.inf"};
    for (size_t i = 0; i < sizeof infinities / sizeof *infinities; i++)
        if (strcmp(text, infinities[i]) == 0) return *value = INFINITY, true;
    char *end;
    *value = strtod(text, &end);
    return end != text && *end == '\0' && isfinite(*value);
}

/* Leaves `value` as it is where the file gives none. */
static void take_number(checker *c, const char *key, const char *unit, const char *text, range allowed, double *value) {
    double number;
    if (!text) return;
    if (!parse_number(text, &number) || !(number >= allowed.low && number <= allowed.high))
        reject(c, key, "\"%s\": expected %s%s%s%s", text, allowed.words, *unit ? " (" : "", unit, *unit ? ")" : "");
    else
        *value = number;
}

static void take_count(checker *c, const char *key, const char *text, int low, int high, int *value) {
    double number;
    if (!text) return;
    if (!parse_number(text, &number) || number < low || number > high || number != floor(number))
        reject(c, key, "\"%s\": expected a whole number from %d to %d", text, low, high);
    else
        *value = (int)number;
}

/* A name that none of the `count` names before it has; these stand `stride` bytes apart. */
static void take_name(checker *c, const char *key, const char *text, const void *before, int count, size_t stride,
                      char name[MESH_NAME]) {
    size_t length = strlen(text);
    if (length == 0 || length >= MESH_NAME) {
        reject(c, key, "\"%s\": expected a name of 1 to %d characters", text, MESH_NAME - 1);
        return;
    }
    for (int i = 0; i < count; i++)
        if (strcmp((const char *)before + i * stride, text) == 0) reject(c, key, "\"%s\" is there twice", text);
    memcpy(name, text, length + 1);
}

/* How many entries of a list to read; rejects a list that is empty but must not be, or too long. */
static int list_length(checker *c, const char *key, unsigned count, int low, int high) {
    if (count < (unsigned)low) reject(c, key, "expected at least %d entry", low);
    if (count > (unsigned)high) reject(c, key, "%u entries: expected at most %d", count, high);
    return count > (unsigned)high ? 0 : (int)count;
}

/* "a, b or c" */
static void list_words(const char *const *words, char *list, size_t size) {
    size_t used = 0;
    for (int i = 0; words[i] && used < size; i++)
        used += (size_t)snprintf(list + used, size - used, "%s%s", i == 0 ? "" : words[i + 1] ? ", " : " or ", words[i]);
}

/* The place of one of these words, from 0; nothing given: the default stays. */
static int take_word(checker *c, const char *key, const char *text, const char *const *words, int given) {
    char list[256];
    if (!text) return given;
    for (int i = 0; words[i]; i++)
        if (strcmp(text, words[i]) == 0) return i;
    list_words(words, list, sizeof list);
    reject(c, key, "\"%s\": expected %s", text, list);
    return given;
}

/* ---- the sections ---- */

static void take_region(checker *c, const region_text *text, region_material *m) {
    take_number(c, "youngs_modulus", "Pa", text->youngs_modulus, POSITIVE, &m->youngs_modulus);
    take_number(c, "poisson_ratio", "", text->poisson_ratio, COMPRESSIBLE, &m->poisson_ratio);
    take_number(c, "cutting_force", "N", text->cutting_force, FORCE, &m->cutting_force);
    take_number(c, "cutting_viscosity", "N s/m", text->cutting_viscosity, NOT_NEGATIVE, &m->cutting_viscosity);
    take_number(c, "friction.static", "N/m", text->friction.static_limit, NOT_NEGATIVE, &m->friction_static);
    take_number(c, "friction.kinetic", "N/m", text->friction.kinetic, NOT_NEGATIVE, &m->friction_kinetic);
    take_number(c, "friction.viscous", "N s/m^2", text->friction.viscous, NOT_NEGATIVE, &m->friction_viscous);
    if (m->friction_kinetic > m->friction_static)
        reject(c, "friction.kinetic", "%g N/m exceeds the static limit of %g N/m", m->friction_kinetic, m->friction_static);
}

static void take_regions(checker *c, const scene_text *text, simulation_config *config) {
    enter_section(c, "%s", "");
    config->region_count = list_length(c, "regions", text->regions_count, 1, MAX_REGIONS);
    for (int i = 0; i < config->region_count; i++) {
        region_config *region = &config->regions[i];
        enter_section(c, "regions[%d].", i);
        take_name(c, "name", text->regions[i].name, config->regions, i, sizeof *region, region->name);
        region->material = region_defaults();
        take_region(c, &text->regions[i], &region->material);
    }
}

static void take_membranes(checker *c, const scene_text *text, simulation_config *config) {
    enter_section(c, "%s", "");
    config->membrane_count = list_length(c, "membranes", text->membranes_count, 0, MAX_MEMBRANES);
    for (int i = 0; i < config->membrane_count; i++) {
        membrane_config *membrane = &config->membranes[i];
        enter_section(c, "membranes[%d].", i);
        take_name(c, "name", text->membranes[i].name, config->membranes, i, sizeof *membrane, membrane->name);
        take_number(c, "puncture_force", "N", text->membranes[i].puncture_force, FORCE, &membrane->puncture_force);
    }
}

static void take_fixed(checker *c, const scene_text *text, simulation_config *config) {
    enter_section(c, "%s", "");
    config->fixed_count = list_length(c, "fixed", text->fixed_count, 1, MAX_FIXED);
    for (int i = 0; i < config->fixed_count; i++) {
        enter_section(c, "fixed[%d]", i);
        take_name(c, "", text->fixed[i], config->fixed, i, sizeof config->fixed[0], config->fixed[i]);
    }
}

static void take_needle(checker *c, const needle_text *text, needle_parameters *n) {
    enter_section(c, "needle.");
    static const char *const models[] = {[NEEDLE_ROD] = "rod", [NEEDLE_TETRAHEDRA] = "tetrahedra", NULL};
    n->kind = (needle_choice)take_word(c, "model", text->model, models, (int)n->kind);
    take_number(c, "length", "m", text->length, POSITIVE, &n->length);
    take_number(c, "outer_diameter", "m", text->outer_diameter, POSITIVE, &n->outer_diameter);
    take_number(c, "inner_diameter", "m", text->inner_diameter, NOT_NEGATIVE, &n->inner_diameter);
    take_number(c, "youngs_modulus", "Pa", text->youngs_modulus, POSITIVE, &n->youngs_modulus);
    take_number(c, "poisson_ratio", "", text->poisson_ratio, COMPRESSIBLE, &n->poisson_ratio);
    take_number(c, "bevel_slope", "", text->bevel_slope, SLOPE, &n->bevel_slope);
    take_count(c, "segments", text->segments, 2, NEEDLE_MAX_SEGMENTS, &n->segments);
    if (n->inner_diameter >= n->outer_diameter)
        reject(c, "inner_diameter", "%g m is not below the outer diameter of %g m", n->inner_diameter, n->outer_diameter);
    if (n->outer_diameter >= n->length)
        reject(c, "outer_diameter", "%g m is not below the length of %g m", n->outer_diameter, n->length);
}

static void take_contact(checker *c, const contact_text *text, insertion_settings *s) {
    enter_section(c, "contact.");
    static const char *const placements[] = {"inside", "faces", "moved", NULL};
    s->placement = (contact_placement)take_word(c, "placement", text->placement, placements, (int)s->placement);
    take_number(c, "spacing", "m", text->spacing, POSITIVE, &s->contact_spacing);
    take_number(c, "resolution", "", text->resolution, POSITIVE, &s->resolution);
    take_number(c, "weakening_distance", "m", text->weakening_distance, POSITIVE, &s->weakening_distance);
    take_number(c, "prefetch_distance", "m", text->prefetch_distance, NOT_NEGATIVE, &s->prefetch_distance);
    take_count(c, "max_passes", text->max_passes, 1, 100, &s->max_passes);
    take_number(c, "tolerance", "m", text->tolerance, POSITIVE, &s->tolerance);
}

static void take_device(checker *c, const device_text *text, guard_limits *limits) {
    char names[256];
    enter_section(c, "device.");
    guard_profile_names(names, sizeof names);
    if (text->profile && !guard_use_profile(text->profile, limits)) reject(c, "profile", "\"%s\": expected %s", text->profile, names);
    take_number(c, "max_stiffness", "N/m", text->max_stiffness, STIFFNESS, &limits->max_stiffness);
    take_number(c, "max_force", "N", text->max_force, POSITIVE, &limits->max_force);
    take_number(c, "max_torque", "N m", text->max_torque, POSITIVE, &limits->max_torque);
    take_number(c, "max_force_rate", "N/s", text->max_force_rate, POSITIVE, &limits->max_force_rate);
    take_number(c, "max_torque_rate", "N m/s", text->max_torque_rate, POSITIVE, &limits->max_torque_rate);
    take_number(c, "max_speed", "m/s", text->max_speed, POSITIVE, &limits->max_speed);
    take_number(c, "max_turn_rate", "rad/s", text->max_turn_rate, POSITIVE, &limits->max_turn_rate);
    take_number(c, "hold_time", "s", text->hold_time, NOT_NEGATIVE, &limits->hold_time);
    take_number(c, "ramp_time", "s", text->ramp_time, POSITIVE, &limits->ramp_time);
}

static void take_vector(checker *c, const char *key, char *const *text, unsigned count, vec3 *value) {
    double numbers[3] = {0};
    if (count != 3) reject(c, key, "expected three numbers (m)");
    for (unsigned i = 0; i < 3 && count == 3; i++) take_number(c, key, "m", text[i], ANY, &numbers[i]);
    *value = v3(numbers[0], numbers[1], numbers[2]);
}

static void take_corridor(checker *c, const corridor_text *text, reach_config *reach) {
    if (!text->from && !text->to && !text->radius) return;
    enter_section(c, "region_of_interest.corridor.");
    take_vector(c, "from", text->from, text->from_count, &reach->from);
    take_vector(c, "to", text->to, text->to_count, &reach->to);
    if (!text->radius) reject(c, "radius", "expected a number above 0 (m)");
    take_number(c, "radius", "m", text->radius, POSITIVE, &reach->radius);
    if (v3_norm(v3_sub(reach->to, reach->from)) == 0.0) reject(c, "to", "the same point as \"from\"");
}

static void take_reach(checker *c, const region_of_interest_text *text, reach_config *reach) {
    enter_section(c, "region_of_interest.");
    reach->region_count = list_length(c, "regions", text->regions_count, 0, REACH_MAX_REGIONS);
    for (int i = 0; i < reach->region_count; i++) {
        enter_section(c, "region_of_interest.regions[%d]", i);
        take_name(c, "", text->regions[i], reach->regions, i, sizeof reach->regions[0], reach->regions[i]);
    }
    take_corridor(c, &text->corridor, reach);
}

/* Paths are relative to the scene file. */
static void take_path(checker *c, const char *key, const char *what, const char *text, char *path, size_t size) {
    const char *slash = strrchr(c->file, '/');
    if (!text) return;
    int directory = slash && text[0] != '/' ? (int)(slash - c->file) + 1 : 0;
    enter_section(c, "%s", "");
    if (text[0] == '\0') reject(c, key, "expected the path of a %s", what);
    int length = snprintf(path, size, "%.*s%s", directory, c->file, text);
    if (length < 0 || (size_t)length >= size) reject(c, key, "path longer than %zu characters", size - 1);
}

/* A unit by name, or its size in metres. */
static void take_unit(checker *c, const char *text, double *unit) {
    static const struct { const char *name; double size; } units[] = {{"m", 1.0}, {"cm", 1e-2}, {"mm", 1e-3}};
    double number;
    enter_section(c, "%s", "");
    if (!text) return;
    for (size_t i = 0; i < sizeof units / sizeof *units; i++)
        if (strcmp(text, units[i].name) == 0) {
            *unit = units[i].size;
            return;
        }
    if (parse_number(text, &number) && number >= 1e-9 && number <= 1e3) *unit = number;
    else reject(c, "mesh_unit", "\"%s\": expected m, cm, mm, or the unit's size in m (1e-9 to 1000)", text);
}

static void take_methods(checker *c, const scene_text *text, simulation_config *s) {
    enter_section(c, "%s", "");
    static const char *const strains[] = {[STRAIN_BY_NODE] = "node", [STRAIN_BY_ELEMENT] = "element", NULL};
    const char *methods[REMESH_METHODS + 1] = {NULL}, *owners[INVERSE_CHOICES + 1] = {NULL};
    for (int i = 0; i < REMESH_METHODS; i++) methods[i] = remesh_name((remesh_method)i);
    for (int i = 0; i < INVERSE_CHOICES; i++) owners[i] = inverse_choice_name((inverse_choice)i);
    s->remeshing = (remesh_method)take_word(c, "remeshing", text->remeshing, methods, (int)s->remeshing);
    s->inverse = (inverse_choice)take_word(c, "inverse", text->inverse, owners, (int)s->inverse);
    s->volumetric = (volumetric_strain)take_word(c, "volumetric_strain", text->volumetric_strain, strains, (int)s->volumetric);
}

static trocar_status take_scene(checker *c, const scene_text *text, scene *s) {
    simulation_defaults(&s->simulation);
    s->guard = guard_defaults();
    s->rate_hz = 1000;
    take_path(c, "mesh", "mesh file", text->mesh, s->simulation.mesh_path, sizeof s->simulation.mesh_path);
    take_unit(c, text->mesh_unit, &s->simulation.mesh_unit);
    take_path(c, "cache", "directory", text->cache, s->simulation.cache, sizeof s->simulation.cache);
    take_number(c, "rate_hz", "Hz", text->rate_hz, RATE, &s->rate_hz);
    take_regions(c, text, &s->simulation);
    take_membranes(c, text, &s->simulation);
    take_fixed(c, text, &s->simulation);
    take_needle(c, &text->needle, &s->simulation.needle);
    take_contact(c, &text->contact, &s->simulation.insertion);
    take_methods(c, text, &s->simulation);
    take_reach(c, &text->region_of_interest, &s->simulation.reach);
    take_device(c, &text->device, &s->guard);
    return c->status;
}

/* ---- the file ---- */

static trocar_status read_file(const char *path, char **text, size_t *length, report *why) {
    FILE *file = fopen(path, "rb");
    if (!file) return fail(why, TROCAR_BAD_INPUT, "%s: cannot open the scene: %s", path, strerror(errno));
    trocar_status status = TROCAR_OK;
    *text = malloc(MAX_FILE);
    *length = *text ? fread(*text, 1, MAX_FILE, file) : 0;
    if (!*text) status = fail(why, TROCAR_NO_MEMORY, "%s: no memory to read it", path);
    else if (ferror(file)) status = fail(why, TROCAR_BAD_INPUT, "%s: cannot read the scene: %s", path, strerror(errno));
    else if (*length == MAX_FILE) status = fail(why, TROCAR_BAD_INPUT, "%s: too long for a scene file", path);
    fclose(file);
    if (status != TROCAR_OK) free(*text);
    return status;
}

static trocar_status load_text(const char *yaml, size_t length, scene *s, report *why) {
    yaml_lines lines;
    trocar_status status = yaml_lines_open(s->path, yaml, length, &lines, why);
    if (status != TROCAR_OK) return status;
    scene_text *text;
    status = scene_text_read(s->path, yaml, length, &lines, &text, why);
    if (status == TROCAR_OK) {
        checker c = {.file = s->path, .lines = &lines, .why = why};
        status = take_scene(&c, text, s);
        scene_text_free(text);
    }
    yaml_lines_close(&lines);
    return status;
}

trocar_status scene_load(const char *path, scene *s, report *why) {
    memset(s, 0, sizeof *s);
    if (strlen(path) >= sizeof s->path)
        return fail(why, TROCAR_BAD_INPUT, "%.64s...: path of the scene longer than %zu characters", path,
                    sizeof s->path - 1);
    strcpy(s->path, path);
    char *yaml = NULL;
    size_t length = 0;
    trocar_status status = read_file(path, &yaml, &length, why);
    if (status != TROCAR_OK) return status;
    status = load_text(yaml, length, s, why);
    free(yaml);
    return status;
}
