#include "profile.h"

#include <stdbool.h>
#include <string.h>
#include <yaml.h>

#include "base/input_file.h"

typedef struct {
    yaml_parser_t parser;
    yaml_event_t event;
    const char *path;
    trocar_error *why;
} reader;

static trocar_status wrong(reader *r, const char *what) {
    return fail(r->why, TROCAR_BAD_INPUT, "%s:%zu: %s", r->path, r->event.start_mark.line + 1, what);
}

static trocar_status next(reader *r) {
    yaml_event_delete(&r->event);
    if (yaml_parser_parse(&r->parser, &r->event)) return TROCAR_OK;
    return fail(r->why, TROCAR_BAD_INPUT, "%s:%zu: %s", r->path, r->parser.problem_mark.line + 1, r->parser.problem ? r->parser.problem : "not YAML");
}

static bool is_scalar(const reader *r) { return r->event.type == YAML_SCALAR_EVENT; }

/* Appends a scalar to `value`, after a comma if `more` is true. */
static trocar_status append(reader *r, char *value, size_t size, bool more) {
    size_t length = strlen(value);
    int added = snprintf(value + length, size - length, "%s%s", more ? "," : "", (const char *)r->event.data.scalar.value);
    return (size_t)added < size - length ? TROCAR_OK : wrong(r, "the value is too long");
}

static trocar_status read_value(reader *r, char *value, size_t size) {
    trocar_status status = next(r);
    if (status != TROCAR_OK) return status;
    if (is_scalar(r)) return append(r, value, size, false);
    if (r->event.type != YAML_SEQUENCE_START_EVENT) return wrong(r, "expected a value or a list of numbers");
    for (bool more = false; (status = next(r)) == TROCAR_OK && is_scalar(r); more = true)
        if ((status = append(r, value, size, more)) != TROCAR_OK) return status;
    if (status != TROCAR_OK) return status;
    return r->event.type == YAML_SEQUENCE_END_EVENT ? TROCAR_OK : wrong(r, "expected a list of numbers");
}

/* Reads one option. The parser's current event is the key; the value comes next. */
static trocar_status read_option(reader *r, profile_setter set, void *context) {
    char key[64], value[1024] = "", place[1024];
    snprintf(key, sizeof key, "%s", (const char *)r->event.data.scalar.value);
    snprintf(place, sizeof place, "%s:%zu", r->path, r->event.start_mark.line + 1);
    for (char *c = key; *c; c++)
        if (*c == '_') *c = '-';
    trocar_status status = read_value(r, value, sizeof value);
    return status == TROCAR_OK ? set(context, place, key, value, r->why) : status;
}

static trocar_status read_mapping(reader *r, profile_setter set, void *context) {
    trocar_status status;
    do status = next(r);
    while (status == TROCAR_OK && (r->event.type == YAML_STREAM_START_EVENT || r->event.type == YAML_DOCUMENT_START_EVENT));
    if (status != TROCAR_OK) return status;
    if (r->event.type != YAML_MAPPING_START_EVENT) return wrong(r, "expected option: value");
    while ((status = next(r)) == TROCAR_OK && is_scalar(r))
        if ((status = read_option(r, set, context)) != TROCAR_OK) return status;
    if (status != TROCAR_OK) return status;
    return r->event.type == YAML_MAPPING_END_EVENT ? TROCAR_OK : wrong(r, "expected option: value");
}

static trocar_status read_end(reader *r) {
    trocar_status status;
    do status = next(r);
    while (status == TROCAR_OK && r->event.type == YAML_DOCUMENT_END_EVENT);
    if (status != TROCAR_OK) return status;
    return r->event.type == YAML_STREAM_END_EVENT ? TROCAR_OK : wrong(r, "a second document: a profile has only one; remove this line or everything above it");
}

trocar_status profile_read(const char *path, profile_setter set, void *context, trocar_error *why) {
    reader r = {.path = path, .why = why};
    const char *reason;
    FILE *file = input_open(path, &reason);
    if (!file) return fail(why, TROCAR_BAD_INPUT, "%s: %s", path, reason);
    trocar_status status = TROCAR_NO_MEMORY;
    if (yaml_parser_initialize(&r.parser)) {
        yaml_parser_set_input_file(&r.parser, file);
        status = read_mapping(&r, set, context);
        if (status == TROCAR_OK) status = read_end(&r);
        yaml_event_delete(&r.event);
        yaml_parser_delete(&r.parser);
    } else fail(why, status, "%s: no memory", path);
    fclose(file);
    return status;
}
