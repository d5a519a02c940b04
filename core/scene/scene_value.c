#include "scene/scene_value.h"

#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "scene/scene_file.h"

#define ROTATION_ERROR 1e-3 /* tolerance for directions, because those in a scene may be rounded */

void reject_at(fault *f, const char *place, const char *key, const char *format, ...) {
    if (f->found) return;
    f->found = true;
    snprintf(f->place, sizeof f->place, "%s", place);
    snprintf(f->key, sizeof f->key, "%s", key);
    va_list arguments;
    va_start(arguments, format);
    decimal_vprint(f->words, sizeof f->words, format, arguments);
    va_end(arguments);
}

/* ---- values -------------------------------------------------------------------------------------------------------------- */

/* Parses a decimal number or YAML's infinity. Rejects trailing characters. */
static bool parse_number(const char *text, double *value) {
    static const char *const infinities[] = {".inf", ".Inf", ".INF", "+.inf"};
    for (size_t i = 0; i < sizeof infinities / sizeof *infinities; i++)
        if (strcmp(text, infinities[i]) == 0) return *value = INFINITY, true;
    char *end;
    *value = decimal_read(text, &end);
    return end != text && *end == '\0' && isfinite(*value);
}

static bool take_number(const key_spec *r, const char *key, const char *text, const range *allowed, double *value, fault *f) {
    double number;
    if (parse_number(text, &number) && number >= allowed->low && number <= allowed->high && (r->kind != COUNT || number == floor(number)))
        return *value = number, true;
    reject(f, key, "\"%s\": expected %s%s%s%s", text, allowed->words, *r->unit ? " (" : "", r->unit, *r->unit ? ")" : "");
    return false;
}

/* Reads a unit, given either by name or as a size in metres. */
static void take_unit(const char *key, const char *text, double *unit, fault *f) {
    double number;
    double named = unit_size(text);
    if (named > 0.0) *unit = named;
    else if (parse_number(text, &number) && number >= 1e-9 && number <= 1e3) *unit = number;
    else reject(f, key, "\"%s\": expected %s", text, UNIT_WORDS);
}

static int take_word(const key_spec *r, const char *key, const char *text, fault *f) {
    char list[WORDS_ROOM];
    for (int i = 0; r->words(i); i++)
        if (strcmp(text, r->words(i)) == 0) return i;
    describe_words(r, list, sizeof list);
    reject(f, key, "\"%s\": expected %s", text, list);
    return -1;
}

static void take_name(const char *key, const char *text, char name[MESH_NAME], fault *f) {
    size_t length = strlen(text);
    if (length == 0 || length >= MESH_NAME) reject(f, key, "\"%s\": expected a name of 1 to %d characters", text, MESH_NAME - 1);
    else memcpy(name, text, length + 1);
}

/* Stores a path. A relative path starts from the scene file's directory. */
static void take_path(const scene *s, const key_spec *r, const char *key, const char *text, char path[1024], fault *f) {
    const char *slash = strrchr(s->path, '/');
    int directory = slash && text[0] != '/' ? (int)(slash - s->path) + 1 : 0;
    if (text[0] == '\0') reject(f, key, "expected the path of a %s", r->kind == DIRECTORY_PATH ? "directory" : "file");
    int length = snprintf(path, 1024, "%.*s%s", directory, s->path, text);
    if (length < 0 || length >= 1024) reject(f, key, "path longer than 1023 characters");
}

/* Reads a list of exactly `count` numbers. */
static bool take_numbers(const key_spec *r, const char *key, const yaml_value *value, const char *count_in_words, int count, double *numbers, fault *f) {
    bool good = value->count == count;
    for (int i = 0; i < count && good; i++) {
        yaml_value item = yaml_item(value, i);
        good = item.kind == YAML_TEXT;
        if (good && !take_number(r, key, item.text, &ANY_NUMBER, &numbers[i], f)) return false;
    }
    if (!good) reject(f, key, "expected %s numbers%s%s%s", count_in_words, *r->unit ? " (" : "", r->unit, *r->unit ? ")" : "");
    return good;
}

static void take_point(const key_spec *r, const char *key, const yaml_value *value, vec3 *point, fault *f) {
    double n[3];
    if (take_numbers(r, key, value, "three", 3, n, f)) *point = v3(n[0], n[1], n[2]);
}

static void take_rotation(const key_spec *r, const char *key, const yaml_value *value, quat *rotation, fault *f) {
    double n[4];
    if (!take_numbers(r, key, value, "four", 4, n, f)) return;
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] + n[3] * n[3]);
    if (!(fabs(length - 1.0) <= ROTATION_ERROR)) reject(f, key, "its length is %g: expected a unit quaternion w, x, y, z", length);
    else *rotation = q_unit((quat){n[0], n[1], n[2], n[3]});
}

/* Reads a similarity transform from mm to m, that is, a rotation and a translation, scaled by 1e-3. */
static void take_transform(const key_spec *r, const char *key, const yaml_value *value, double matrix[16], fault *f) {
    double n[16];
    if (!take_numbers(r, key, value, "sixteen", 16, n, f)) return;
    vec3 x = v3(1e3 * n[0], 1e3 * n[1], 1e3 * n[2]), y = v3(1e3 * n[4], 1e3 * n[5], 1e3 * n[6]), z = v3(1e3 * n[8], 1e3 * n[9], 1e3 * n[10]);
    double off = v3_norm(v3_sub(v3_cross(x, y), z)) + v3_norm(v3_sub(v3_cross(y, z), x)) + fabs(v3_norm(x) - 1.0);
    if (n[12] != 0.0 || n[13] != 0.0 || n[14] != 0.0 || n[15] != 1.0) reject(f, key, "its last row must be 0, 0, 0, 1");
    else if (!(off <= ROTATION_ERROR)) reject(f, key, "its upper left 3 x 3 must be a rotation times 1e-3, from mm to m, not mirrored");
    else memcpy(matrix, n, sizeof n);
}

static void take_names(scene *s, const key_spec *r, const char *key, const yaml_value *value, fault *f) {
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
            if (strcmp(names[i], names[k]) == 0) reject(f, entry, "\"%s\" appears twice", names[i]);
    }
}

/* Reads an entry's name, which must be unique in its list. */
static void take_entry_name(scene *s, const key_spec *r, const char *key, const char *text, char *name, fault *f) {
    for (int i = 0; i < *count_of(s, r->list); i++)
        if (name_of(s, r->list, i) != name && strcmp(name_of(s, r->list, i), text) == 0) reject(f, key, "\"%s\" appears twice", text);
    take_name(key, text, name, f);
}

/* ---- device profiles ------------------------------------------------------------------------------------------------- */

static bool is_path(const char *profile) {
    size_t length = strlen(profile), suffix = strlen(PROFILE_SUFFIX);
    return length > suffix && strcmp(profile + length - suffix, PROFILE_SUFFIX) == 0;
}

static void take_named_profile(scene *s, const key_spec *r, const char *key, const char *name, fault *f) {
    if (take_word(r, key, name, f) < 0) return;
    snprintf(s->profile, sizeof s->profile, "%s", name);
    device_use_profile(name, &s->device);
    s->mapping.workspace = device_workspace(name);
}

/* Reads one key of a profile file. The file may name a built-in profile, whose values the file's other keys override. It may not name another file. */
static void take_profile_key(scene *s, const yaml_value *file, int index, bool named, fault *f) {
    yaml_value value;
    const char *name = yaml_pair(file, index, &value);
    char key[KEY_ROOM];
    snprintf(key, sizeof key, "device.%s", name);
    const key_spec *r = find_key(key);
    if (!r) reject_at(f, name, "", "unknown key \"%s\": expected a key of the section \"device\" of scenes", name);
    else if (yaml_key_repeated(file, index)) reject_at(f, name, "", "repeated key \"%s\"", name);
    else if ((r->kind == PROFILE) != named) return;
    else if (!named) take_value(s, r, name, s, &value, f);
    else if (value.kind != YAML_TEXT || is_path(value.text)) reject_at(f, name, name, "expected the name of a device: a file cannot refer to another file");
    else take_named_profile(s, r, name, value.text, f);
}

static void take_profile_file(scene *s, const char *key, const char *path, fault *f) {
    trocar_error why;
    yaml_text document;
    char *text;
    size_t length;
    trocar_status status = scene_file_read(path, "profile", &text, &length, &why);
    if (status == TROCAR_OK) {
        status = yaml_open(path, text, length, &document, &why);
        free(text);
    }
    if (status != TROCAR_OK) {
        reject(f, key, "%s", why.text);
        return;
    }
    fault inside = {.found = false};
    yaml_value root = yaml_root(&document);
    if (root.kind != YAML_MAPPING) reject(&inside, "", "expected keys with values");
    for (int named = 1; named >= 0; named--)
        for (int i = 0; i < root.count && !inside.found; i++) take_profile_key(s, &root, i, named, &inside);
    if (inside.found)
        reject(f, key, "%s:%d: %s%s%s", path, yaml_line(&document, inside.place), inside.key, *inside.key ? ": " : "", inside.words);
    yaml_close(&document);
}

static void take_profile(scene *s, const key_spec *r, const char *key, const char *text, fault *f) {
    if (!is_path(text)) {
        take_named_profile(s, r, key, text, f);
        return;
    }
    char path[1024] = "";
    take_path(s, r, key, text, path, f);
    if (f->found) return;
    take_profile_file(s, key, path, f);
    snprintf(s->profile, sizeof s->profile, "%s", path);
}

/* ---- any value ------------------------------------------------------------------------------------------------------------- */

void take_value(scene *s, const key_spec *r, const char *key, void *base, const yaml_value *value, fault *f) {
    void *target = (char *)base + r->offset;
    bool list = r->kind == NAMES || r->kind == POINT || r->kind == ROTATION || r->kind == TRANSFORM;
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
    case PROFILE: take_profile(s, r, key, value->text, f); break;
    case NAME:
        if (target == base && r->list != NO_LIST) take_entry_name(s, r, key, value->text, target, f); /* an entry's name is its first member, so this key is the
                                                                                                         name */
        else take_name(key, value->text, target, f);
        break;
    case NAMES: take_names(s, r, key, value, f); break;
    case FILE_PATH:
    case DIRECTORY_PATH: take_path(s, r, key, value->text, target, f); break;
    case POINT: take_point(r, key, value, target, f); break;
    case ROTATION: take_rotation(r, key, value, target, f); break;
    case TRANSFORM: take_transform(r, key, value, target, f); break;
    }
}
_Static_assert(sizeof(inverse_choice) == sizeof(int) && sizeof(inverse_precision) == sizeof(int)
               && sizeof(volumetric_strain) == sizeof(int), "a word is stored as an int");

/* ---- printing ------------------------------------------------------------------------------------------------------- */

/* Prints a number with as few digits as it takes to read back the same value. */
static int print_number(char *text, size_t size, double x) {
    if (isinf(x)) return snprintf(text, size, ".inf");
    char shortest[32];
    for (int digits = 1; digits <= 17; digits++) {
        decimal_print(shortest, sizeof shortest, "%.*g", digits, x);
        if (decimal_read(shortest, NULL) == x) break;
    }
    return snprintf(text, size, "%s", shortest);
}

/* Prints numbers as a YAML list. Prints nothing if the first one is NAN, which means that the key was not given. */
static int print_numbers(char *text, size_t size, const double *numbers, int count) {
    char number[32];
    if (isnan(numbers[0])) return snprintf(text, size, "%s", "");
    int used = snprintf(text, size, "[");
    for (int i = 0; i < count && (size_t)used < size; i++) {
        print_number(number, sizeof number, numbers[i]);
        used += snprintf(text + used, size - (size_t)used, "%s%s", i ? ", " : "", number);
    }
    return (size_t)used < size ? used + snprintf(text + used, size - (size_t)used, "]") : used;
}

static int print_names(const scene *s, const key_spec *r, char *text, size_t size) {
    int least, most, count = *names_count((scene *)s, r, &least, &most), used = snprintf(text, size, "[");
    char (*names)[MESH_NAME] = (void *)((char *)s + r->offset);
    for (int i = 0; i < count && (size_t)used < size; i++) used += snprintf(text + used, size - (size_t)used, "%s%s", i ? ", " : "", names[i]);
    return (size_t)used < size ? used + snprintf(text + used, size - (size_t)used, "]") : used;
}

int print_value(const scene *s, const key_spec *r, const void *base, char *value, size_t size) {
    const void *target = (const char *)base + r->offset;
    switch (r->kind) {
    case NUMBER:
    case LENGTH_UNIT: return print_number(value, size, *(const double *)target);
    case COUNT: return snprintf(value, size, "%d", *(const int *)target);
    case WORD: return snprintf(value, size, "%s", r->words(*(const int *)target));
    case NAMES: return print_names(s, r, value, size);
    case POINT: return print_numbers(value, size, target, 3);
    case ROTATION: return print_numbers(value, size, target, 4);
    case TRANSFORM: return print_numbers(value, size, target, 16);
    default: return snprintf(value, size, "%s", (const char *)target);
    }
}
