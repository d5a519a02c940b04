#include "scene/scene_value.h"

#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

void reject_at(fault *f, const char *place, const char *key, const char *format, ...) {
    if (f->found) return;
    f->found = true;
    snprintf(f->place, sizeof f->place, "%s", place);
    snprintf(f->key, sizeof f->key, "%s", key);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(f->words, sizeof f->words, format, arguments);
    va_end(arguments);
}

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
    double named = unit_size(text);
    if (named > 0.0) *unit = named;
    else if (parse_number(text, &number) && number >= 1e-9 && number <= 1e3) *unit = number;
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
        else take_number(r, key, item.text, &ANY_NUMBER, &numbers[i], f);
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

void take_value(scene *s, const row *r, const char *key, void *base, const yaml_value *value, fault *f) {
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

/* ---- printing ------------------------------------------------------------------------------------------------------- */

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

int print_value(const scene *s, const row *r, const void *base, char *value, size_t size) {
    const void *target = (const char *)base + r->offset;
    switch (r->kind) {
    case NUMBER:
    case LENGTH_UNIT: return print_number(value, size, *(const double *)target);
    case COUNT: return snprintf(value, size, "%d", *(const int *)target);
    case WORD: return snprintf(value, size, "%s", r->words(*(const int *)target));
    case NAMES: return print_names(s, r, value, size);
    case POINT: return print_point(value, size, target);
    default: return snprintf(value, size, "%s", (const char *)target);
    }
}
