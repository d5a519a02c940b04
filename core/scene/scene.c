#include "scene/scene.h"

#include <errno.h>
#include <float.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "scene/yaml_text.h"

enum { MAX_FILE = 1 << 20 /* bytes; a scene has a few thousand */, KEY_ROOM = 256, WORDS_ROOM = 512 };

/* ---- the table of keys --------------------------------------------------------------------------------------------------- */

typedef enum { NUMBER, COUNT, WORD, LENGTH_UNIT, PROFILE, NAME, NAMES, FILE_PATH, DIRECTORY_PATH, POINT } value_kind;
typedef enum { NO_LIST, REGIONS, MEMBRANES, LISTS } list_kind;
typedef struct { double low, high; const char *words; } range;
typedef const char *(*word_of)(int index); /* NULL past the last one */

typedef struct {
    const char *key, *unit;
    value_kind kind;
    size_t offset;           /* of the value in `scene`, or in the list's entry */
    const range *allowed;    /* NUMBER, COUNT */
    word_of words;           /* WORD, PROFILE */
    list_kind list;
    bool required;
    const char *doc;
} row;

static const range POSITIVE = {DBL_MIN, DBL_MAX, "a number above 0"};
static const range NOT_NEGATIVE = {0, DBL_MAX, "a number of at least 0"};
static const range FORCE = {0, INFINITY, "a number of at least 0, or .inf"};
static const range STIFFNESS = {DBL_MIN, INFINITY, "a number above 0, or .inf"};
static const range POISSON = {0, 0.49999999, "a number of at least 0 and below 0.5"};
static const range ANY = {-DBL_MAX, DBL_MAX, "a number"};
static const range SLOPE = {0, 1, "a number from 0 to 1"};
static const range RATE = {SCENE_MIN_RATE, SCENE_MAX_RATE, "a number from 250 to 10000"};
static const range SEGMENTS = {2, NEEDLE_MAX_SEGMENTS, "a whole number from 2 to 64"};
static const range PASSES = {1, 100, "a whole number from 1 to 100"};
_Static_assert(NEEDLE_MAX_SEGMENTS == 64, "the text of SEGMENTS says so");

#define WORDS(function, ...)                                                       \
    static const char *function(int index) {                                       \
        static const char *const words[] = {__VA_ARGS__};                          \
        return index < (int)(sizeof words / sizeof *words) ? words[index] : NULL;  \
    }
WORDS(model_word, [NEEDLE_ROD] = "rod", [NEEDLE_TETRAHEDRA] = "tetrahedra")
WORDS(placement_word, [PLACE_INSIDE] = "inside", [PLACE_ON_FACES] = "faces", [PLACE_MOVED] = "moved")
WORDS(strain_word, [STRAIN_BY_NODE] = "node", [STRAIN_BY_ELEMENT] = "element")
static const char *remeshing_word(int index) { return index < REMESH_METHODS ? remesh_name((remesh_method)index) : NULL; }
static const char *inverse_word(int index) { return index < INVERSE_CHOICES ? inverse_choice_name((inverse_choice)index) : NULL; }
static const char *profile_word(int index) { return device_profiles[index]; }

#define OF(member) offsetof(scene, member)
#define MATERIAL(member) offsetof(region_config, material.member)

static const row TABLE[] = {
    {"mesh", "", FILE_PATH, OF(simulation.mesh_path), .required = true, .doc = "mesh file, in any format that Gmsh reads; relative to the scene file"},
    {"mesh_unit", "", LENGTH_UNIT, OF(simulation.mesh_unit), .doc = "of the mesh file's coordinates"},
    {"rate_hz", "Hz", NUMBER, OF(rate_hz), &RATE, .doc = "of the haptic loop"},

    {"regions[].name", "", NAME, offsetof(region_config, name), .list = REGIONS, .required = true, .doc = "a physical volume of the mesh"},
    {"regions[].youngs_modulus", "Pa", NUMBER, MATERIAL(youngs_modulus), &POSITIVE, .list = REGIONS, .doc = "of the tissue"},
    {"regions[].poisson_ratio", "", NUMBER, MATERIAL(poisson_ratio), &POISSON, .list = REGIONS, .doc = "of the tissue"},
    {"regions[].cutting_force", "N", NUMBER, MATERIAL(cutting_force), &FORCE, .list = REGIONS, .doc = "resistance at the tip; .inf is bone"},
    {"regions[].cutting_viscosity", "N s/m", NUMBER, MATERIAL(cutting_viscosity), &NOT_NEGATIVE, .list = REGIONS,
     .doc = "added resistance per speed of the tip"},
    {"regions[].friction.static", "N/m", NUMBER, MATERIAL(friction_static), &NOT_NEGATIVE, .list = REGIONS,
     .doc = "limit of the shaft's friction per length while it sticks"},
    {"regions[].friction.kinetic", "N/m", NUMBER, MATERIAL(friction_kinetic), &NOT_NEGATIVE, .list = REGIONS,
     .doc = "friction per length once it slides; at most the static limit"},
    {"regions[].friction.viscous", "N s/m^2", NUMBER, MATERIAL(friction_viscous), &NOT_NEGATIVE, .list = REGIONS,
     .doc = "added friction per length and sliding speed"},

    {"membranes[].name", "", NAME, offsetof(membrane_config, name), .list = MEMBRANES, .required = true, .doc = "a physical surface of the mesh"},
    {"membranes[].puncture_force", "N", NUMBER, offsetof(membrane_config, puncture_force), &FORCE, .list = MEMBRANES, .required = true,
     .doc = "that the tip must exceed; .inf is bone"},

    {"fixed", "", NAMES, OF(simulation.fixed), .required = true, .doc = "physical groups held at zero displacement"},

    {"needle.model", "", WORD, OF(simulation.needle.kind), .words = model_word, .doc = "tetrahedra is the paper's; 20 segments of it keep up with 1 kHz"},
    {"needle.length", "m", NUMBER, OF(simulation.needle.length), &POSITIVE, .doc = "from base to tip"},
    {"needle.outer_diameter", "m", NUMBER, OF(simulation.needle.outer_diameter), &POSITIVE, .doc = "18 G by default"},
    {"needle.inner_diameter", "m", NUMBER, OF(simulation.needle.inner_diameter), &NOT_NEGATIVE, .doc = "0 is solid"},
    {"needle.youngs_modulus", "Pa", NUMBER, OF(simulation.needle.youngs_modulus), &POSITIVE, .doc = "of the needle"},
    {"needle.poisson_ratio", "", NUMBER, OF(simulation.needle.poisson_ratio), &POISSON, .doc = "of the needle"},
    {"needle.bevel_slope", "", NUMBER, OF(simulation.needle.bevel_slope), &SLOPE, .doc = "sideways cut per forward cut"},
    {"needle.segments", "", COUNT, OF(simulation.needle.segments), &SEGMENTS, .doc = "of its length"},

    {"contact.spacing", "m", NUMBER, OF(simulation.insertion.contact_spacing), &POSITIVE, .doc = "least distance between contact nodes"},
    {"contact.placement", "", WORD, OF(simulation.insertion.placement), .words = placement_word,
     .doc = "half way through elements; or where the tip leaves them, added on the face or its closest corner moved there"},
    {"contact.resolution", "", NUMBER, OF(simulation.insertion.resolution), &POSITIVE, .doc = "alpha of the local compliance"},
    {"contact.weakening_distance", "m", NUMBER, OF(simulation.insertion.weakening_distance), &POSITIVE,
     .doc = "of sliding over which static friction falls to kinetic"},
    {"contact.prefetch_distance", "m", NUMBER, OF(simulation.insertion.prefetch_distance), &NOT_NEGATIVE,
     .doc = "of the path ahead of the tip that the worker keeps ready"},
    {"contact.max_passes", "", COUNT, OF(simulation.insertion.max_passes), &PASSES, .doc = "Newton passes in a step, at most"},
    {"contact.tolerance", "m", NUMBER, OF(simulation.insertion.tolerance), &POSITIVE, .doc = "error of the needle's shape at which the passes stop"},

    {"remeshing", "", WORD, OF(simulation.remeshing), .words = remeshing_word, .doc = "how the inverse follows the changes of the mesh"},
    {"inverse", "", WORD, OF(simulation.inverse), .words = inverse_word,
     .doc = "auto: dense below 1 GB, else condensed with a region_of_interest, else sparse"},
    {"volumetric_strain", "", WORD, OF(simulation.volumetric), .words = strain_word, .doc = "averaged at nodes, which does not lock, or by element"},
    {"cache", "", DIRECTORY_PATH, OF(simulation.cache), .doc = "directory of condensed inverses; by default $XDG_CACHE_HOME/trocar"},

    {"region_of_interest.regions", "", NAMES, OF(simulation.roi.regions), .doc = "regions that needles reach"},
    {"region_of_interest.corridor.from", "m", POINT, OF(simulation.roi.from), .required = true, .doc = "start of the corridor's axis"},
    {"region_of_interest.corridor.to", "m", POINT, OF(simulation.roi.to), .required = true, .doc = "end of the corridor's axis"},
    {"region_of_interest.corridor.radius", "m", NUMBER, OF(simulation.roi.radius), &POSITIVE, .required = true, .doc = "of the corridor"},

    {"device.profile", "", PROFILE, OF(profile), .words = profile_word, .doc = "a device by name; explicit keys override it"},
    {"device.max_stiffness", "N/m", NUMBER, OF(device.max_stiffness), &STIFFNESS, .doc = "of the virtual coupling; .inf: none"},
    {"device.max_force", "N", NUMBER, OF(device.max_force), &POSITIVE, .doc = "largest force sent to the hand"},
    {"device.max_torque", "N m", NUMBER, OF(device.max_torque), &POSITIVE, .doc = "largest torque sent to the hand"},
    {"device.max_force_rate", "N/s", NUMBER, OF(device.max_force_rate), &POSITIVE, .doc = "slew limit of the force"},
    {"device.max_torque_rate", "N m/s", NUMBER, OF(device.max_torque_rate), &POSITIVE, .doc = "slew limit of the torque"},
    {"device.max_speed", "m/s", NUMBER, OF(device.max_speed), &POSITIVE, .doc = "poses that move faster are refused"},
    {"device.max_turn_rate", "rad/s", NUMBER, OF(device.max_turn_rate), &POSITIVE, .doc = "poses that turn faster are refused"},
    {"device.hold_time", "s", NUMBER, OF(device.hold_time), &NOT_NEGATIVE, .doc = "without a pose before the wrench is ramped down"},
    {"device.ramp_time", "s", NUMBER, OF(device.ramp_time), &POSITIVE, .doc = "of every ramp"},
};
enum { ROWS = sizeof TABLE / sizeof *TABLE };

/* A list of mappings, and how many entries it may have. */
static const struct { const char *key; size_t entries, count, stride; int least, most; } LIST_TABLE[LISTS] = {
    [REGIONS] = {"regions", OF(simulation.regions), OF(simulation.region_count), sizeof(region_config), 1, MAX_REGIONS},
    [MEMBRANES] = {"membranes", OF(simulation.membranes), OF(simulation.membrane_count), sizeof(membrane_config), 0, MAX_MEMBRANES},
};

static void *entry_of(scene *s, list_kind list, int index) {
    return (char *)s + LIST_TABLE[list].entries + (size_t)index * LIST_TABLE[list].stride;
}
static int *count_of(scene *s, list_kind list) { return (int *)((char *)s + LIST_TABLE[list].count); }
static const char *name_of(const scene *s, list_kind list, int index) { return entry_of((scene *)s, list, index); } /* its first member */
_Static_assert(offsetof(region_config, name) == 0 && offsetof(membrane_config, name) == 0, "name_of relies on it");

/* NAMES: where the count is, and how many there may be. */
static int *names_count(scene *s, const row *r, int *least, int *most) {
    bool fixed = r->offset == OF(simulation.fixed);
    *least = fixed ? 1 : 0;
    *most = fixed ? MAX_FIXED : REACH_MAX_REGIONS;
    return fixed ? &s->simulation.fixed_count : &s->simulation.roi.region_count;
}

static const row *find_row(const char *pattern) {
    for (int i = 0; i < ROWS; i++)
        if (strcmp(TABLE[i].key, pattern) == 0) return &TABLE[i];
    return NULL;
}

/* Does a row's key go on after `pattern` with `next`, as a section's with "." and a list's with "[]"? */
static bool leads_on(const char *pattern, const char *next) {
    size_t length = strlen(pattern);
    for (int i = 0; i < ROWS; i++)
        if (strncmp(TABLE[i].key, pattern, length) == 0 && strncmp(TABLE[i].key + length, next, strlen(next)) == 0) return true;
    return false;
}

static const struct { const char *name; double size; } UNITS[] = {{"m", 1.0}, {"cm", 1e-2}, {"mm", 1e-3}};
enum { UNIT_COUNT = sizeof UNITS / sizeof *UNITS };
static const char UNIT_WORDS[] = "m, cm, mm, or the unit's size in m (1e-9 to 1000)";

int scene_key_count(void) { return ROWS; }

/* "a, b or c" */
static void list_words(word_of word, char *list, size_t size) {
    size_t used = 0;
    for (int i = 0; word(i) && used < size; i++)
        used += (size_t)snprintf(list + used, size - used, "%s%s", i == 0 ? "" : word(i + 1) ? ", " : " or ", word(i));
}

scene_key_info scene_key_at(int index) {
    static char lists[ROWS][WORDS_ROOM];
    static const char *const others[] = {[NAME] = "a name", [NAMES] = "a list of names", [FILE_PATH] = "a path", [DIRECTORY_PATH] = "a path",
                                         [POINT] = "three numbers"};
    const row *r = &TABLE[index];
    const char *accepts = r->allowed ? r->allowed->words : r->kind == LENGTH_UNIT ? UNIT_WORDS : others[r->kind];
    if (r->words) {
        list_words(r->words, lists[index], sizeof lists[index]);
        accepts = lists[index];
    }
    return (scene_key_info){r->key, r->unit, accepts, r->doc, r->required};
}

/* ---- faults -------------------------------------------------------------------------------------------------------------- */

/* The first thing that is wrong; later ones are passed over. */
typedef struct {
    bool found;
    char place[KEY_ROOM];    /* whose line is told */
    char key[KEY_ROOM];      /* that the message names, may be empty */
    char words[WORDS_ROOM];
} fault;

__attribute__((format(printf, 4, 5)))
static void reject_at(fault *f, const char *place, const char *key, const char *format, ...) {
    if (f->found) return;
    f->found = true;
    snprintf(f->place, sizeof f->place, "%s", place);
    snprintf(f->key, sizeof f->key, "%s", key);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(f->words, sizeof f->words, format, arguments);
    va_end(arguments);
}
#define reject(f, key, ...) reject_at(f, key, key, __VA_ARGS__)

/* ---- values -------------------------------------------------------------------------------------------------------------- */

/* A decimal number or YAML's infinity, nothing after it. */
static bool parse_number(const char *text, double *value) {
    static const char *const infinities[] = {".inf", ".Inf", ".INF", "+.inf"};
    for (size_t i = 0; i < sizeof infinities / sizeof *infinities; i++)
        if (strcmp(text, infinities[i]) == 0) return *value = INFINITY, true;
    char *end;
    *value = strtod(text, &end);
    return end != text && *end == '\0' && isfinite(*value);
}

static bool take_number(const row *r, const char *key, const char *text, const range *allowed, double *value, fault *f) {
    double number;
    if (parse_number(text, &number) && number >= allowed->low && number <= allowed->high && (r->kind != COUNT || number == floor(number)))
        return *value = number, true;
    reject(f, key, "\"%s\": expected %s%s%s%s", text, allowed->words, *r->unit ? " (" : "", r->unit, *r->unit ? ")" : "");
    return false;
}

/* A unit by name, or its size in metres. */
static void take_unit(const char *key, const char *text, double *unit, fault *f) {
    double number;
    for (int i = 0; i < UNIT_COUNT; i++)
        if (strcmp(text, UNITS[i].name) == 0) {
            *unit = UNITS[i].size;
            return;
        }
    if (parse_number(text, &number) && number >= 1e-9 && number <= 1e3) *unit = number;
    else reject(f, key, "\"%s\": expected %s", text, UNIT_WORDS);
}

static int take_word(const row *r, const char *key, const char *text, fault *f) {
    char list[WORDS_ROOM];
    for (int i = 0; r->words(i); i++)
        if (strcmp(text, r->words(i)) == 0) return i;
    list_words(r->words, list, sizeof list);
    reject(f, key, "\"%s\": expected %s", text, list);
    return -1;
}

static void take_name(const char *key, const char *text, char name[MESH_NAME], fault *f) {
    size_t length = strlen(text);
    if (length == 0 || length >= MESH_NAME) reject(f, key, "\"%s\": expected a name of 1 to %d characters", text, MESH_NAME - 1);
    else memcpy(name, text, length + 1);
}

/* Relative to the scene file. */
static void take_path(const scene *s, const row *r, const char *key, const char *text, char path[1024], fault *f) {
    const char *slash = strrchr(s->path, '/');
    int directory = slash && text[0] != '/' ? (int)(slash - s->path) + 1 : 0;
    if (text[0] == '\0') reject(f, key, "expected the path of a %s", r->kind == FILE_PATH ? "file" : "directory");
    int length = snprintf(path, 1024, "%.*s%s", directory, s->path, text);
    if (length < 0 || length >= 1024) reject(f, key, "path longer than 1023 characters");
}

static void take_point(const row *r, const char *key, const yaml_value *value, vec3 *point, fault *f) {
    double numbers[3] = {0};
    if (value->count != 3) reject(f, key, "expected three numbers (%s)", r->unit);
    for (int i = 0; i < 3 && value->count == 3; i++) {
        yaml_value item = yaml_item(value, i);
        if (item.kind != YAML_TEXT) reject(f, key, "expected three numbers (%s)", r->unit);
        else take_number(r, key, item.text, &ANY, &numbers[i], f);
    }
    *point = v3(numbers[0], numbers[1], numbers[2]);
}

static void take_names(scene *s, const row *r, const char *key, const yaml_value *value, fault *f) {
    int least, most, *count = names_count(s, r, &least, &most);
    char (*names)[MESH_NAME] = (void *)((char *)s + r->offset), entry[KEY_ROOM];
    if (value->count < least) reject(f, key, "expected at least %d entry", least);
    if (value->count > most) reject(f, key, "%d entries: expected at most %d", value->count, most);
    *count = value->count > most ? 0 : value->count;
    for (int i = 0; i < *count; i++) {
        yaml_value item = yaml_item(value, i);
        snprintf(entry, sizeof entry, "%s[%d]", key, i);
        if (item.kind != YAML_TEXT) reject(f, entry, "expected a single value");
        else take_name(entry, item.text, names[i], f);
        for (int k = 0; k < i; k++)
            if (strcmp(names[i], names[k]) == 0) reject(f, entry, "\"%s\" is there twice", names[i]);
    }
}

/* A name in a list that no other entry has. */
static void take_entry_name(scene *s, const row *r, const char *key, const char *text, char *name, fault *f) {
    for (int i = 0; i < *count_of(s, r->list); i++)
        if (name_of(s, r->list, i) != name && strcmp(name_of(s, r->list, i), text) == 0) reject(f, key, "\"%s\" is there twice", text);
    take_name(key, text, name, f);
}

/* Puts the value of one key into the scene; `base` is the scene or the list's entry. */
static void take_value(scene *s, const row *r, const char *key, void *base, const yaml_value *value, fault *f) {
    void *target = (char *)base + r->offset;
    bool list = r->kind == NAMES || r->kind == POINT;
    double number;
    int word;
    if (value->kind != (list ? YAML_LIST : YAML_TEXT)) {
        reject(f, key, list ? "expected a list" : "expected a single value");
        return;
    }
    switch (r->kind) {
    case NUMBER: take_number(r, key, value->text, r->allowed, target, f); break;
    case COUNT: if (take_number(r, key, value->text, r->allowed, &number, f)) *(int *)target = (int)number; break;
    case WORD: if ((word = take_word(r, key, value->text, f)) >= 0) memcpy(target, &word, sizeof word); break;
    case LENGTH_UNIT: take_unit(key, value->text, target, f); break;
    case PROFILE:
        if (take_word(r, key, value->text, f) < 0) break;
        take_name(key, value->text, target, f);
        device_use_profile(value->text, &s->device);
        break;
    case NAME: take_entry_name(s, r, key, value->text, target, f); break;
    case NAMES: take_names(s, r, key, value, f); break;
    case FILE_PATH:
    case DIRECTORY_PATH: take_path(s, r, key, value->text, target, f); break;
    case POINT: take_point(r, key, value, target, f); break;
    }
}
_Static_assert(sizeof(remesh_method) == sizeof(int) && sizeof(inverse_choice) == sizeof(int) && sizeof(contact_placement) == sizeof(int)
               && sizeof(volumetric_strain) == sizeof(int) && sizeof(needle_choice) == sizeof(int), "a word is stored as an int");

/* ---- reading a document ---------------------------------------------------------------------------------------------------- */

static void *append_entry(scene *s, list_kind list) {
    void *entry = entry_of(s, list, (*count_of(s, list))++);
    memset(entry, 0, LIST_TABLE[list].stride);
    if (list == REGIONS) ((region_config *)entry)->material = region_defaults();
    return entry;
}

static void join_key(char out[KEY_ROOM], const char *before, const char *key) { snprintf(out, KEY_ROOM, "%s%s%s", before, *before ? "." : "", key); }

static void take_mapping(scene *s, const char *key, const char *pattern, void *base, const yaml_value *value, fault *f);

static void take_list(scene *s, list_kind list, const yaml_value *value, fault *f) {
    const char *key = LIST_TABLE[list].key;
    char entry[KEY_ROOM], pattern[KEY_ROOM];
    *count_of(s, list) = 0;
    if (value->kind != YAML_LIST) {
        reject(f, key, "expected a list");
        return;
    }
    if (value->count < LIST_TABLE[list].least) reject(f, key, "expected at least %d entry", LIST_TABLE[list].least);
    if (value->count > LIST_TABLE[list].most) reject(f, key, "%d entries: expected at most %d", value->count, LIST_TABLE[list].most);
    snprintf(pattern, sizeof pattern, "%s[]", key);
    for (int i = 0; i < value->count && !f->found; i++) {
        yaml_value item = yaml_item(value, i);
        snprintf(entry, sizeof entry, "%s[%d]", key, i);
        take_mapping(s, entry, pattern, append_entry(s, list), &item, f);
    }
}

static void take_pair(scene *s, const char *mapping, const char *pattern, const char *name, void *base, const yaml_value *value, fault *f) {
    char key[KEY_ROOM], row_key[KEY_ROOM];
    join_key(key, mapping, name);
    join_key(row_key, pattern, name);
    const row *r = find_row(row_key);
    if (r) {
        take_value(s, r, key, base, value, f);
        return;
    }
    for (list_kind list = NO_LIST + 1; list < LISTS; list++)
        if (strcmp(LIST_TABLE[list].key, row_key) == 0) {
            take_list(s, list, value, f);
            return;
        }
    if (leads_on(row_key, ".")) take_mapping(s, key, row_key, base, value, f);
    else reject_at(f, key, mapping, "unknown key \"%s\"", name);
}

/* The profile of a device comes before the keys that override it. */
static bool comes_first(const char *pattern, const char *name) {
    char key[KEY_ROOM];
    join_key(key, pattern, name);
    const row *r = find_row(key);
    return r && r->kind == PROFILE;
}

static void ask_for_keys(const char *key, const char *pattern, const yaml_value *value, fault *f) {
    size_t length = strlen(pattern);
    for (int i = 0; i < ROWS; i++) {
        const char *rest = TABLE[i].key + length + (length > 0);
        bool here = TABLE[i].required && strncmp(TABLE[i].key, pattern, length) == 0 && !strpbrk(rest, ".[");
        if (here && !yaml_has_key(value, rest)) reject_at(f, key, key, "missing key \"%s\"", rest);
    }
}

static void take_mapping(scene *s, const char *key, const char *pattern, void *base, const yaml_value *value, fault *f) {
    if (value->kind != YAML_MAPPING) {
        reject(f, key, "expected keys with values");
        return;
    }
    for (int late = 0; late <= 1; late++)
        for (int i = 0; i < value->count && !f->found; i++) {
            yaml_value item;
            const char *name = yaml_pair(value, i, &item);
            char place[KEY_ROOM];
            join_key(place, key, name);
            if (yaml_key_repeated(value, i)) reject_at(f, place, key, "repeated key \"%s\"", name);
            else if (comes_first(pattern, name) != late) take_pair(s, key, pattern, name, base, &item, f);
        }
    ask_for_keys(key, pattern, value, f);
}

/* ---- values that must fit each other ---------------------------------------------------------------------------------------- */

static void check_region(const region_config *region, int index, fault *f) {
    char key[KEY_ROOM];
    const region_material *m = &region->material;
    snprintf(key, sizeof key, "regions[%d].friction.kinetic", index);
    if (m->friction_kinetic > m->friction_static)
        reject(f, key, "%g N/m exceeds the static limit of %g N/m", m->friction_kinetic, m->friction_static);
}

static void check_all(const scene *s, fault *f) {
    const simulation_config *c = &s->simulation;
    const needle_parameters *n = &c->needle;
    for (int i = 0; i < c->region_count; i++) check_region(&c->regions[i], i, f);
    if (n->inner_diameter >= n->outer_diameter)
        reject(f, "needle.inner_diameter", "%g m is not below the outer diameter of %g m", n->inner_diameter, n->outer_diameter);
    if (n->outer_diameter >= n->length)
        reject(f, "needle.outer_diameter", "%g m is not below the length of %g m", n->outer_diameter, n->length);
    if (c->roi.radius > 0.0 && v3_norm(v3_sub(c->roi.to, c->roi.from)) == 0.0)
        reject(f, "region_of_interest.corridor.to", "the same point as \"from\"");
}

static trocar_status told(const char *name, const fault *f, report *why) {
    if (!f->found) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: %s%s%s", name, f->key, *f->key ? ": " : "", f->words);
}

trocar_status scene_check(const scene *s, report *why) {
    fault f = {.found = false};
    if (s->simulation.mesh_path[0] == '\0' && !s->simulation.mesh_given) reject(&f, "", "missing key \"mesh\"");
    if (s->simulation.region_count == 0) reject(&f, "", "missing key \"regions\"");
    if (s->simulation.fixed_count == 0) reject(&f, "", "missing key \"fixed\"");
    check_all(s, &f);
    return told(*s->path ? s->path : "scene", &f, why);
}

/* ---- the file ---------------------------------------------------------------------------------------------------------------- */

void scene_defaults(scene *s) {
    memset(s, 0, sizeof *s);
    simulation_defaults(&s->simulation);
    s->device = device_defaults();
    s->rate_hz = 1000;
}

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
    yaml_text document;
    trocar_status status = yaml_open(s->path, yaml, length, &document, why);
    if (status != TROCAR_OK) return status;
    fault f = {.found = false};
    yaml_value root = yaml_root(&document);
    take_mapping(s, "", "", s, &root, &f);
    for (list_kind list = NO_LIST + 1; list < LISTS; list++)
        if (LIST_TABLE[list].least > 0 && !yaml_has_key(&root, LIST_TABLE[list].key)) reject(&f, "", "missing key \"%s\"", LIST_TABLE[list].key);
    check_all(s, &f);
    char name[sizeof s->path + 16];
    snprintf(name, sizeof name, "%s:%d", s->path, yaml_line(&document, f.place));
    status = told(name, &f, why);
    yaml_close(&document);
    return status;
}

trocar_status scene_load(const char *path, scene *s, report *why) {
    scene_defaults(s);
    if (strlen(path) >= sizeof s->path)
        return fail(why, TROCAR_BAD_INPUT, "%.64s...: path of the scene longer than %zu characters", path, sizeof s->path - 1);
    strcpy(s->path, path);
    char *yaml = NULL;
    size_t length = 0;
    trocar_status status = read_file(path, &yaml, &length, why);
    if (status != TROCAR_OK) return status;
    status = load_text(yaml, length, s, why);
    free(yaml);
    return status;
}

/* ---- one key ----------------------------------------------------------------------------------------------------------------- */

/* The entry that "regions[0].x" or "regions[prostate].x" means, and "regions[].x". NULL: there is none. */
static void *find_entry(scene *s, const char *key, bool append, char pattern[KEY_ROOM]) {
    const char *open = strchr(key, '['), *close = open ? strchr(open, ']') : NULL;
    snprintf(pattern, KEY_ROOM, "%s", key);
    if (!close) return s;
    char name[MESH_NAME], *end;
    int length = (int)(close - open - 1);
    if (length < 1 || length >= MESH_NAME) return NULL;
    snprintf(name, sizeof name, "%.*s", length, open + 1);
    snprintf(pattern, KEY_ROOM, "%.*s[]%s", (int)(open - key), key, close + 1);
    size_t prefix = (size_t)(open - key);
    list_kind list = NO_LIST + 1;
    while (list < LISTS && !(strlen(LIST_TABLE[list].key) == prefix && strncmp(LIST_TABLE[list].key, key, prefix) == 0)) list++;
    if (list == LISTS || !find_row(pattern)) return NULL;
    long index = strtol(name, &end, 10);
    if (*end == '\0') return index >= 0 && index < *count_of(s, list) ? entry_of(s, list, (int)index) : NULL;
    for (int i = 0; i < *count_of(s, list); i++)
        if (strcmp(name_of(s, list, i), name) == 0) return entry_of(s, list, i);
    if (!append || *count_of(s, list) == LIST_TABLE[list].most) return NULL;
    void *entry = append_entry(s, list);
    memcpy(entry, name, sizeof name);
    return entry;
}

/* The row that a key means, and where its value is. */
static const row *find_value(scene *s, const char *key, bool append, void **base, fault *f) {
    char pattern[KEY_ROOM];
    *base = strlen(key) < KEY_ROOM ? find_entry(s, key, append, pattern) : NULL;
    const row *r = *base ? find_row(pattern) : NULL;
    if (!r) reject(f, "", "no key \"%.100s\"%s", key, *base ? "" : ", or no such entry");
    return r;
}

trocar_status scene_set(scene *s, const char *key, const char *value, report *why) {
    fault f = {.found = false};
    yaml_text document;
    scene *changed = malloc(sizeof *changed);
    if (!changed) return fail(why, TROCAR_NO_MEMORY, "no memory");
    *changed = *s;
    trocar_status status = yaml_open(key, value, strlen(value), &document, why);
    if (status == TROCAR_OK) {
        void *base;
        yaml_value root = yaml_root(&document);
        const row *r = find_value(changed, key, true, &base, &f);
        if (r) take_value(changed, r, key, base, &root, &f);
        status = told("scene", &f, why);
        yaml_close(&document);
    }
    if (status == TROCAR_OK) *s = *changed;
    free(changed);
    return status;
}

/* The shortest decimal that reads back as the same number. */
static int print_number(char *text, size_t size, double x) {
    if (isinf(x)) return snprintf(text, size, ".inf");
    char shortest[32];
    for (int digits = 1; digits <= 17; digits++) {
        snprintf(shortest, sizeof shortest, "%.*g", digits, x);
        if (strtod(shortest, NULL) == x) break;
    }
    return snprintf(text, size, "%s", shortest);
}

static int print_point(char *text, size_t size, const vec3 *p) {
    char x[32], y[32], z[32];
    print_number(x, sizeof x, p->x);
    print_number(y, sizeof y, p->y);
    print_number(z, sizeof z, p->z);
    return snprintf(text, size, "[%s, %s, %s]", x, y, z);
}

static int print_names(const scene *s, const row *r, char *text, size_t size) {
    int least, most, count = *names_count((scene *)s, r, &least, &most), used = snprintf(text, size, "[");
    char (*names)[MESH_NAME] = (void *)((char *)s + r->offset);
    for (int i = 0; i < count && (size_t)used < size; i++) used += snprintf(text + used, size - (size_t)used, "%s%s", i ? ", " : "", names[i]);
    return (size_t)used < size ? used + snprintf(text + used, size - (size_t)used, "]") : used;
}

trocar_status scene_get(const scene *s, const char *key, char *value, size_t size, report *why) {
    fault f = {.found = false};
    void *base;
    const row *r = find_value((scene *)s, key, false, &base, &f);
    if (!r) return told("scene", &f, why);
    const void *target = (const char *)base + r->offset;
    int length = 0;
    switch (r->kind) {
    case NUMBER:
    case LENGTH_UNIT: length = print_number(value, size, *(const double *)target); break;
    case COUNT: length = snprintf(value, size, "%d", *(const int *)target); break;
    case WORD: length = snprintf(value, size, "%s", r->words(*(const int *)target)); break;
    case NAMES: length = print_names(s, r, value, size); break;
    case POINT: length = print_point(value, size, target); break;
    default: length = snprintf(value, size, "%s", (const char *)target); break;
    }
    if (length >= 0 && (size_t)length < size) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: its value does not fit in %zu bytes", key, size);
}
