#include "scene_text.h"

#include <cyaml/cyaml.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

/* ---- the schema ---- */

#define TEXT_AS(structure, key, member) \
    CYAML_FIELD_STRING_PTR(key, CYAML_FLAG_POINTER | CYAML_FLAG_OPTIONAL, structure, member, 0, CYAML_UNLIMITED)
#define TEXT(structure, member) TEXT_AS(structure, #member, member)
#define REQUIRED_TEXT(structure, member) \
    CYAML_FIELD_STRING_PTR(#member, CYAML_FLAG_POINTER, structure, member, 0, CYAML_UNLIMITED)
#define SECTION(structure, member, fields) CYAML_FIELD_MAPPING(#member, CYAML_FLAG_OPTIONAL, structure, member, fields)
#define LIST_IN(structure, member, presence, entry) \
    CYAML_FIELD_SEQUENCE(#member, CYAML_FLAG_POINTER | (presence), structure, member, entry, 0, CYAML_UNLIMITED)
#define LIST(member, presence, entry) LIST_IN(scene_text, member, presence, entry)

static const cyaml_schema_field_t friction_fields[] = {
    TEXT_AS(friction_text, "static", static_limit), TEXT(friction_text, kinetic), TEXT(friction_text, viscous),
    CYAML_FIELD_END};

static const cyaml_schema_field_t region_fields[] = {
    REQUIRED_TEXT(region_text, name), TEXT(region_text, youngs_modulus), TEXT(region_text, poisson_ratio),
    TEXT(region_text, cutting_force), TEXT(region_text, cutting_viscosity),
    SECTION(region_text, friction, friction_fields), CYAML_FIELD_END};

static const cyaml_schema_field_t membrane_fields[] = {
    REQUIRED_TEXT(membrane_text, name), REQUIRED_TEXT(membrane_text, puncture_force), CYAML_FIELD_END};

static const cyaml_schema_field_t needle_fields[] = {
    TEXT(needle_text, model), TEXT(needle_text, length), TEXT(needle_text, outer_diameter),
    TEXT(needle_text, inner_diameter), TEXT(needle_text, youngs_modulus), TEXT(needle_text, poisson_ratio),
    TEXT(needle_text, bevel_slope), TEXT(needle_text, segments), CYAML_FIELD_END};

static const cyaml_schema_field_t contact_fields[] = {
    TEXT(contact_text, placement), TEXT(contact_text, spacing), TEXT(contact_text, resolution), TEXT(contact_text, weakening_distance),
    TEXT(contact_text, prefetch_distance), TEXT(contact_text, max_passes), TEXT(contact_text, tolerance), CYAML_FIELD_END};

static const cyaml_schema_field_t device_fields[] = {
    TEXT(device_text, profile), TEXT(device_text, max_stiffness), TEXT(device_text, max_force),
    TEXT(device_text, max_torque), TEXT(device_text, max_force_rate),
    TEXT(device_text, max_torque_rate), TEXT(device_text, max_speed), TEXT(device_text, max_turn_rate), TEXT(device_text, hold_time), TEXT(device_text, ramp_time), CYAML_FIELD_END};

static const cyaml_schema_value_t region_entry = {CYAML_VALUE_MAPPING(CYAML_FLAG_DEFAULT, region_text, region_fields)};
static const cyaml_schema_value_t membrane_entry = {CYAML_VALUE_MAPPING(CYAML_FLAG_DEFAULT, membrane_text, membrane_fields)};
static const cyaml_schema_value_t text_entry = {CYAML_VALUE_STRING(CYAML_FLAG_POINTER, char, 0, CYAML_UNLIMITED)};

static const cyaml_schema_field_t corridor_fields[] = {
    LIST_IN(corridor_text, from, CYAML_FLAG_OPTIONAL, &text_entry), LIST_IN(corridor_text, to, CYAML_FLAG_OPTIONAL, &text_entry),
    TEXT(corridor_text, radius), CYAML_FIELD_END};

static const cyaml_schema_field_t region_of_interest_fields[] = {
    LIST_IN(region_of_interest_text, regions, CYAML_FLAG_OPTIONAL, &text_entry),
    SECTION(region_of_interest_text, corridor, corridor_fields), CYAML_FIELD_END};

static const cyaml_schema_field_t scene_fields[] = {
    REQUIRED_TEXT(scene_text, mesh), TEXT(scene_text, rate_hz), TEXT(scene_text, remeshing),
    TEXT(scene_text, mesh_unit), TEXT(scene_text, inverse), TEXT(scene_text, cache), TEXT(scene_text, volumetric_strain),
    LIST(regions, CYAML_FLAG_DEFAULT, &region_entry), LIST(membranes, CYAML_FLAG_OPTIONAL, &membrane_entry),
    LIST(fixed, CYAML_FLAG_DEFAULT, &text_entry), SECTION(scene_text, needle, needle_fields),
    SECTION(scene_text, contact, contact_fields), SECTION(scene_text, device, device_fields),
    SECTION(scene_text, region_of_interest, region_of_interest_fields), CYAML_FIELD_END};

static const cyaml_schema_value_t scene_schema = {CYAML_VALUE_MAPPING(CYAML_FLAG_POINTER, scene_text, scene_fields)};

/* ---- messages: libcyaml logs the cause, then a backtrace from the inside out ---- */

typedef struct {
    char cause[256];
    char path[256];          /* keys and indices of the backtrace, as in "regions[1].friction" */
    bool ends_in_key;        /* the innermost step is a key */
    int steps;
} load_log;

static void prepend_step(load_log *log, const char *step) {
    char joined[sizeof log->path];
    bool dot = log->path[0] != '\0' && log->path[0] != '[';
    snprintf(joined, sizeof joined, "%.100s%s%.150s", step, dot ? "." : "", log->path);
    strcpy(log->path, joined);
}

/* One line of the backtrace, such as "  in mapping field 'needle' (line: 3, column: 1)". Its lines are those of the
   last event read, which is often the one before the fault; the key's own line is looked up instead. */
static void note_step(load_log *log, const char *text) {
    char key[101], entry[24];
    unsigned number;
    bool is_key = sscanf(text, "  in mapping field '%100[^']'", key) == 1;
    if (log->steps++ == 1) log->ends_in_key = is_key; /* after the heading */
    if (is_key) {
        prepend_step(log, key);
    } else if (sscanf(text, "  in sequence entry '%u'", &number) == 1) {
        snprintf(entry, sizeof entry, "[%u]", number - 1); /* libcyaml counts from 1 */
        prepend_step(log, entry);
    }
}

__attribute__((format(printf, 3, 0)))
static void take_log(cyaml_log_t level, void *context, const char *format, va_list arguments) {
    (void)level;
    load_log *log = context;
    char text[256];
    vsnprintf(text, sizeof text, format, arguments);
    text[strcspn(text, "\n")] = '\0';
    if (log->cause[0] == '\0') strcpy(log->cause, text);
    else note_step(log, text);
}

/* libcyaml's causes in plain words. The first ones end in the name of a key. */
typedef enum { KEY_HERE, KEY_MISSING, NO_KEY } cause_kind;
static const struct { const char *cause, *words; cause_kind kind; } CAUSES[] = {
    {"Load: Unexpected key: ", "unknown key", KEY_HERE},
    {"Load: Mapping field already seen: ", "repeated key", KEY_HERE},
    {"Load: Missing required mapping field: ", "missing key", KEY_MISSING},
    {"Load: Expecting STRING", "expected a single value", NO_KEY},
    {"Load: Expecting MAPPING", "expected keys with values", NO_KEY},
    {"Load: Expecting SEQUENCE", "expected a list", NO_KEY},
};
enum { CAUSE_COUNT = sizeof CAUSES / sizeof *CAUSES };

static int find_cause(const char *text) {
    int i = 0;
    while (i < CAUSE_COUNT && strncmp(text, CAUSES[i].cause, strlen(CAUSES[i].cause)) != 0) i++;
    return i;
}

static void drop_last_key(char *path) {
    char *dot = strrchr(path, '.');
    if (dot) *dot = '\0';
    else path[0] = '\0';
}

static trocar_status explain(const char *name, cyaml_err_t error, load_log *log, yaml_lines *lines, report *why) {
    if (error == CYAML_ERR_OOM) return fail(why, TROCAR_NO_MEMORY, "%s: no memory to read it", name);
    int cause = find_cause(log->cause);
    bool known = cause < CAUSE_COUNT, names_key = known && CAUSES[cause].kind != NO_KEY;
    const char *words = known ? CAUSES[cause].words : log->cause[0] ? log->cause : cyaml_strerror(error);
    const char *key = names_key ? log->cause + strlen(CAUSES[cause].cause) : "", *quote = names_key ? "\"" : "";
    if (names_key && log->ends_in_key) drop_last_key(log->path); /* that is the key read before */

    char place[512];
    snprintf(place, sizeof place, "%s.%s", log->path, known && CAUSES[cause].kind == KEY_HERE ? key : "");
    return fail(why, TROCAR_BAD_INPUT, "%s:%d: %s%s%s%s%s%s%s", name, yaml_lines_find(lines, place), log->path,
                log->path[0] ? ": " : "", words, names_key ? " " : "", quote, key, quote);
}

/* ---- reading ---- */

static cyaml_config_t config_with(load_log *log) {
    return (cyaml_config_t){.log_fn = take_log, .log_ctx = log, .mem_fn = cyaml_mem, .log_level = CYAML_LOG_ERROR};
}

trocar_status scene_text_read(const char *name, const char *yaml, size_t length, yaml_lines *lines, scene_text **text,
                              report *why) {
    load_log log = {.cause = ""};
    cyaml_config_t config = config_with(&log);
    *text = NULL;
    cyaml_err_t error = cyaml_load_data((const uint8_t *)yaml, length, &config, &scene_schema, (cyaml_data_t **)text, NULL);
    if (error != CYAML_OK) return explain(name, error, &log, lines, why);
    return *text ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "%s: empty", name);
}

void scene_text_free(scene_text *text) {
    load_log log = {.cause = ""};
    cyaml_config_t config = config_with(&log);
    cyaml_free(&config, &scene_schema, text, 0);
}
