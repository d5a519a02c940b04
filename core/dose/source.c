#include "dose/source.h"

#include <errno.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "base/input_file.h"
#include "yaml/yaml_text.h"

enum { MAX_FILE = 1 << 20, PLACE_ROOM = 64 };

/* The table as read from the file. */
typedef struct {
    int g_count;
    double g_radius[MAX_TABLE_RADII], g[MAX_TABLE_RADII];
    int radius_count, angle_count;
    double radius[MAX_TABLE_RADII], angle[2 * MAX_TABLE_ANGLES], f[MAX_TABLE_RADII][2 * MAX_TABLE_ANGLES]; /* `angle` and `f` have room for a mirrored table */
} seed_table;

typedef struct {
    const char *file;
    yaml_text *document;
    trocar_error *why;
} reader;

/* Writes an error message with the line number of `place`, a path such as "radial[3]". Returns false. */
__attribute__((format(printf, 3, 4)))
static bool refuse(const reader *r, const char *place, const char *format, ...) {
    char words[512];
    va_list arguments;
    va_start(arguments, format);
    decimal_vprint(words, sizeof words, format, arguments);
    va_end(arguments);
    fail(r->why, TROCAR_BAD_INPUT, "%s:%d: %s%s%s", r->file, yaml_line(r->document, place), place, *place ? ": " : "", words);
    return false;
}

/* ---- values ------------------------------------------------------------------------------------------------------------------ */

typedef struct {
    double low, high;            /* inclusive limits */
    const char *words;
} range;

static const range DOSE_RATE_CONSTANT = {1e-6, 100, "a number above 0, at most 100 (cGy/(h U))"};
static const range HALF_LIFE = {1e-3, 1e5, "a number from 0.001 to 100000 (days)"};
static const range LENGTH = {1e-4, 20, "a length from 0.0001 to 20 (cm)"};
static const range DIAMETER = {1e-3, 1, "a diameter from 0.001 to 1 (cm)"};
static const range RADIUS = {1e-3, 100, "a radius from 0.001 to 100 (cm)"};
static const range G = {1e-12, 100, "g, a number above 0, at most 100"};
static const range ANGLE = {0, 180, "an angle from 0 to 180 (degrees)"};
static const range F = {0, 100, "F, a number from 0 to 100"};

static bool read_number(const reader *r, const char *place, const yaml_value *value, const range *allowed, double *number) {
    char *end = NULL;
    if (value->kind == YAML_TEXT) *number = decimal_read(value->text, &end);
    if (end && end != value->text && *end == '\0' && *number >= allowed->low && *number <= allowed->high) return true;
    if (value->kind != YAML_TEXT) return refuse(r, place, "expected %s", allowed->words);
    if (!*value->text) return refuse(r, place, "a value is missing: expected %s", allowed->words);
    return refuse(r, place, "\"%.40s\": expected %s", value->text, allowed->words);
}

static bool read_name(const reader *r, const yaml_value *value, char name[SOURCE_NAME]) {
    size_t length = value->kind == YAML_TEXT ? strlen(value->text) : 0;
    if (length == 0 || length >= SOURCE_NAME) return refuse(r, "name", "expected a text of 1 to %d bytes", SOURCE_NAME - 1);
    memcpy(name, value->text, length + 1);
    return true;
}

/* Reads a row, a list of `count` numbers that starts with the row's radius or angle. */
static bool read_row(const reader *r, const char *place, const yaml_value *row, int count, const range *first, const range *rest, double *numbers) {
    if (row->kind != YAML_LIST || row->count != count)
        return refuse(r, place, "expected a list of %d numbers%s%s", count, row->kind == YAML_LIST && row->count < count ? ": fill the gap" : "",
                      row->kind == YAML_LIST && row->count > count ? ": remove the surplus" : "");
    for (int i = 0; i < count; i++) {
        char item[2 * PLACE_ROOM];
        snprintf(item, sizeof item, "%s[%d]", place, i);
        yaml_value value = yaml_item(row, i);
        if (!read_number(r, item, &value, i == 0 ? first : rest, &numbers[i])) return false;
    }
    return true;
}

/* Checks that radii or angles increase from row to row, by enough that rounding errors do not matter in the interpolation. */
static bool grows(const reader *r, const char *place, const char *what, const double *values, int index) {
    if (index == 0 || values[index] >= values[index - 1] + 0.001) return true;
    return refuse(r, place, "the %s %g is not above the one before, %g, by 0.001 or more: sort by %s and remove repetitions", what, values[index], values[index - 1], what);
}

static bool read_list(const reader *r, const char *place, const yaml_value *list, int least, int most) {
    if (list->kind != YAML_LIST) return refuse(r, place, "expected a list");
    if (list->count < least || list->count > most) return refuse(r, place, "%d entries: expected %d to %d", list->count, least, most);
    return true;
}

/* ---- radial dose function ------------------------------------------------------------------------------------------------------ */

static bool read_radial(const reader *r, const yaml_value *list, seed_table *t) {
    if (!read_list(r, "radial", list, 2, MAX_TABLE_RADII)) return false;
    t->g_count = list->count;
    for (int i = 0; i < list->count; i++) {
        char place[PLACE_ROOM];
        double pair[2];
        snprintf(place, sizeof place, "radial[%d]", i);
        yaml_value row = yaml_item(list, i);
        if (!read_row(r, place, &row, 2, &RADIUS, &G, pair)) return false;
        t->g_radius[i] = pair[0];
        t->g[i] = pair[1];
        if (!grows(r, place, "radius", t->g_radius, i)) return false;
    }
    int last = t->g_count - 1;
    if (t->g_radius[0] > 1.0 || t->g_radius[last] < 1.0) return refuse(r, "radial", "the radii do not reach 1 cm, where g = 1: add the rows that are missing");
    if (t->g[last] >= t->g[last - 1])
        return refuse(r, "radial", "g does not fall over the last two radii, from which it is extrapolated: check the last rows");
    return true;
}

/* Returns the index of the interval between ascending numbers that contains x, or of the nearest interval if none does. */
static int interval_of(const double *numbers, int count, double x) {
    int i = 0;
    while (i + 2 < count && x >= numbers[i + 1]) i++;
    return i;
}

/* Computes the coefficients of log g = intercept + slope r for the interval that contains this radius. */
static void log_g_at(const seed_table *t, double radius, double *intercept, double *slope) {
    int i = interval_of(t->g_radius, t->g_count, radius);
    double from = t->g_radius[i];
    *slope = radius < t->g_radius[0] ? 0.0 : (log(t->g[i + 1]) - log(t->g[i])) / (t->g_radius[i + 1] - from);
    *intercept = log(t->g[i]) - (radius < t->g_radius[0] ? 0.0 : *slope * from);
}

static bool check_radial(const reader *r, const seed_table *t) {
    double intercept, slope;
    log_g_at(t, 1.0, &intercept, &slope);
    double g = exp(intercept + slope);
    return fabs(g - 1.0) <= 0.005 || refuse(r, "radial", "g at 1 cm is %.4g; by definition it is 1: check the rows, or divide g by that", g);
}

/* ---- anisotropy function --------------------------------------------------------------------------------------------------------- */

static bool read_radii(const reader *r, const yaml_value *list, seed_table *t) {
    if (!read_list(r, "anisotropy.radii", list, 1, MAX_TABLE_RADII)) return false;
    t->radius_count = list->count;
    for (int i = 0; i < list->count; i++) {
        char place[PLACE_ROOM];
        snprintf(place, sizeof place, "anisotropy.radii[%d]", i);
        yaml_value value = yaml_item(list, i);
        if (!read_number(r, place, &value, &RADIUS, &t->radius[i]) || !grows(r, place, "radius", t->radius, i)) return false;
    }
    return true;
}

static bool read_rows(const reader *r, const yaml_value *list, seed_table *t) {
    if (!read_list(r, "anisotropy.rows", list, 2, MAX_TABLE_ANGLES)) return false;
    t->angle_count = list->count;
    for (int i = 0; i < list->count; i++) {
        char place[PLACE_ROOM];
        double row[1 + MAX_TABLE_RADII];
        snprintf(place, sizeof place, "anisotropy.rows[%d]", i);
        yaml_value value = yaml_item(list, i);
        if (!read_row(r, place, &value, 1 + t->radius_count, &ANGLE, &F, row)) return false;
        t->angle[i] = row[0];
        for (int k = 0; k < t->radius_count; k++) t->f[k][i] = row[1 + k];
        if (!grows(r, place, "angle", t->angle, i)) return false;
    }
    double last = t->angle[t->angle_count - 1];
    if (t->angle[0] != 0.0 || (last != 90.0 && last != 180.0))
        return refuse(r, "anisotropy.rows", "the angles go from %g to %g: expected 0 to 90, or 0 to 180 if the seed's ends differ; add the rows that are missing",
                      t->angle[0], last);
    return true;
}

static bool check_anisotropy(const reader *r, const seed_table *t) {
    int i = 1;
    while (i < t->angle_count - 1 && t->angle[i] < 90.0) i++;
    double w = (90.0 - t->angle[i - 1]) / (t->angle[i] - t->angle[i - 1]);
    for (int k = 0; k < t->radius_count; k++) {
        double f = (1.0 - w) * t->f[k][i - 1] + w * t->f[k][i];
        if (fabs(f - 1.0) > 0.005)
            return refuse(r, "anisotropy.rows", "F at 90 degrees and %g cm is %.4g; by definition it is 1: check that column", t->radius[k], f);
    }
    return true;
}

static void mirror(seed_table *t) {
    int last = t->angle_count - 1;
    if (t->angle[last] != 90.0) return;
    for (int i = 1; i <= last; i++) {
        t->angle[last + i] = 180.0 - t->angle[last - i];
        for (int k = 0; k < t->radius_count; k++) t->f[k][last + i] = t->f[k][last - i];
    }
    t->angle_count = 2 * last + 1;
}

/* ---- pieces and cells -------------------------------------------------------------------------------------------------------------- */

/* Computes the coefficients of F = a + b angle at radius number k, between the angles of rows i and i + 1. */
static void along_angle(const seed_table *t, int k, int i, double *a, double *b) {
    *b = (t->f[k][i + 1] - t->f[k][i]) / (t->angle[i + 1] - t->angle[i]);
    *a = t->f[k][i] - *b * t->angle[i];
}

static anisotropy_cell make_cell(const seed_table *t, double radius, int i) {
    anisotropy_cell cell = {0};
    int last = t->radius_count - 1;
    if (radius < t->radius[0] || radius >= t->radius[last]) {
        along_angle(t, radius < t->radius[0] ? 0 : last, i, &cell.a, &cell.b);
        return cell;
    }
    int k = interval_of(t->radius, t->radius_count, radius);
    double near[2], far[2], width = t->radius[k + 1] - t->radius[k];
    along_angle(t, k, i, &near[0], &near[1]);
    along_angle(t, k + 1, i, &far[0], &far[1]);
    cell.c = (far[0] - near[0]) / width;
    cell.d = (far[1] - near[1]) / width;
    cell.a = near[0] - cell.c * t->radius[k];
    cell.b = near[1] - cell.d * t->radius[k];
    return cell;
}

/* Merges the radii of both tables (g and F) into one list: the starts of the pieces. */
static void make_starts(const seed_table *t, trocar_dose_source *s) {
    s->start[0] = 0.0;
    s->piece_count = 1;
    for (int i = 0, k = 0; i < t->g_count || k < t->radius_count;) {
        bool from_g = k == t->radius_count || (i < t->g_count && t->g_radius[i] <= t->radius[k]);
        double next = from_g ? t->g_radius[i++] : t->radius[k++];
        if (next > s->start[s->piece_count - 1]) s->start[s->piece_count++] = next;
    }
}

static bool make_pieces(const seed_table *t, trocar_dose_source *s) {
    make_starts(t, s);
    s->angle_count = t->angle_count;
    memcpy(s->angle, t->angle, sizeof s->angle);
    int intervals = s->angle_count - 1;
    s->cells = malloc((size_t)s->piece_count * (size_t)intervals * sizeof *s->cells);
    for (int p = 0; p < s->piece_count && s->cells; p++) {
        log_g_at(t, s->start[p], &s->intercept[p], &s->slope[p]);
        for (int i = 0; i < intervals; i++) s->cells[p * intervals + i] = make_cell(t, s->start[p], i);
    }
    return s->cells != NULL;
}

/* ---- document ---------------------------------------------------------------------------------------------------------------------- */

/* Looks up the values of these keys in a mapping. Fails if a key is unknown, repeated or missing. */
static bool read_keys(const reader *r, const char *place, const yaml_value *mapping, const char *const *keys, int count, yaml_value *values) {
    if (mapping->kind != YAML_MAPPING) return refuse(r, place, "expected keys and values");
    bool found[16] = {false};
    for (int i = 0; i < mapping->count; i++) {
        yaml_value value;
        const char *key = yaml_pair(mapping, i, &value);
        int k = 0;
        while (k < count && strcmp(keys[k], key) != 0) k++;
        if (k == count) return refuse(r, place, "unknown key \"%.40s\": remove it, or correct its spelling", key);
        if (found[k]) return refuse(r, place, "the key \"%s\" appears twice: remove one", key);
        found[k] = true;
        values[k] = value;
    }
    for (int k = 0; k < count; k++)
        if (!found[k]) return refuse(r, place, "missing key \"%s\"", keys[k]);
    return true;
}

static bool read_document(const reader *r, trocar_dose_source *s, seed_table *t) {
    enum { NAME, CONSTANT, ACTIVE, LIFE, CAPSULE, RADIAL, ANISOTROPY, KEYS };
    static const char *const keys[] = {"name", "dose_rate_constant", "active_length", "half_life", "capsule", "radial", "anisotropy"};
    static const char *const capsule_keys[] = {"length", "diameter"}, *const anisotropy_keys[] = {"radii", "rows"};
    yaml_value root = yaml_root(r->document), value[KEYS], capsule[2], anisotropy[2];
    if (!read_keys(r, "", &root, keys, KEYS, value) || !read_keys(r, "capsule", &value[CAPSULE], capsule_keys, 2, capsule) ||
        !read_keys(r, "anisotropy", &value[ANISOTROPY], anisotropy_keys, 2, anisotropy) || !read_name(r, &value[NAME], s->name) ||
        !read_number(r, "dose_rate_constant", &value[CONSTANT], &DOSE_RATE_CONSTANT, &s->dose_rate_constant) ||
        !read_number(r, "active_length", &value[ACTIVE], &LENGTH, &s->active_length) ||
        !read_number(r, "half_life", &value[LIFE], &HALF_LIFE, &s->half_life) ||
        !read_number(r, "capsule.length", &capsule[0], &LENGTH, &s->capsule_length) ||
        !read_number(r, "capsule.diameter", &capsule[1], &DIAMETER, &s->capsule_diameter))
        return false;
    if (s->active_length >= s->capsule_length)
        return refuse(r, "active_length", "%g cm do not fit into a capsule of %g cm: check both", s->active_length, s->capsule_length);
    if (s->active_length >= 2.0) return refuse(r, "active_length", "%g cm: g is defined at 1 cm, beside the source: expected less than 2 cm", s->active_length);
    if (!read_radial(r, &value[RADIAL], t) || !check_radial(r, t) || !read_radii(r, &anisotropy[0], t) || !read_rows(r, &anisotropy[1], t) ||
        !check_anisotropy(r, t))
        return false;
    mirror(t);
    return true;
}

trocar_status dose_source_read(const char *file, const char *text, size_t length, trocar_dose_source *s, trocar_error *why) {
    yaml_text document;
    seed_table t = {0};
    trocar_status status = yaml_open(file, text, length, &document, why);
    if (status != TROCAR_OK) return status;
    reader r = {file, &document, why};
    if (!read_document(&r, s, &t)) status = TROCAR_BAD_INPUT;
    else if (!make_pieces(&t, s)) status = fail(why, TROCAR_NO_MEMORY, "%s: no memory for its tables", file);
    yaml_close(&document);
    return status;
}

void dose_source_clear(trocar_dose_source *s) { free(s->cells); }

/* ---- trocar.h ------------------------------------------------------------------------------------------------------------------------ */

static trocar_status create(const char *file, const char *text, size_t length, trocar_dose_source **created, trocar_error *why) {
    trocar_dose_source *s = calloc(1, sizeof *s);
    if (!s) return fail(why, TROCAR_NO_MEMORY, "no memory for a seed model");
    trocar_status status = dose_source_read(file, text, length, s, why);
    if (status == TROCAR_OK) *created = s;
    else free(s);
    return status;
}

trocar_status trocar_dose_source_create(const char *name, trocar_dose_source **created, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    *created = NULL;
    for (const dose_table *t = DOSE_TABLES; t->name; t++)
        if (strcmp(t->name, name) == 0) return create(t->file, t->text, strlen(t->text), created, why);
    char known[256] = "";
    for (const dose_table *t = DOSE_TABLES; t->name; t++)
        snprintf(known + strlen(known), sizeof known - strlen(known), "%s\"%s\"", t == DOSE_TABLES ? "" : ", ", t->name);
    return fail(why, TROCAR_BAD_INPUT, "no seed model \"%.60s\": there are %s; load others from a table file", name, known);
}

trocar_status trocar_dose_source_load(const char *path, trocar_dose_source **created, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    *created = NULL;
    const char *reason;
    FILE *file = input_open(path, &reason);
    if (!file) return fail(why, TROCAR_BAD_INPUT, "%s: cannot open the seed table: %s", path, reason);
    trocar_status status = TROCAR_OK;
    char *text = malloc(MAX_FILE);
    size_t length = text ? fread(text, 1, MAX_FILE, file) : 0;
    if (!text) status = fail(why, TROCAR_NO_MEMORY, "%s: no memory to read it", path);
    else if (ferror(file)) status = fail(why, TROCAR_BAD_INPUT, "%s: cannot read the seed table: %s", path, strerror(errno));
    else if (length == MAX_FILE) status = fail(why, TROCAR_BAD_INPUT, "%s: too long for a seed table: at most 1 MB", path);
    fclose(file);
    if (status == TROCAR_OK) status = create(path, text, length, created, why);
    free(text);
    return status;
}

void trocar_dose_source_free(trocar_dose_source *source) {
    if (source) dose_source_clear(source);
    free(source);
}

trocar_dose_source_data trocar_dose_source_get(const trocar_dose_source *s) {
    trocar_dose_source_data data = {.dose_rate_constant = s->dose_rate_constant, .active_length = 0.01 * s->active_length,
                                    .capsule_length = 0.01 * s->capsule_length, .capsule_diameter = 0.01 * s->capsule_diameter,
                                    .half_life = 86400.0 * s->half_life};
    memcpy(data.name, s->name, sizeof data.name);
    return data;
}

double trocar_dose_hours(const trocar_dose_source *s, double hours) {
    double mean_life = 24.0 * s->half_life / log(2.0);
    return hours < 0.0 ? NAN : -mean_life * expm1(-hours / mean_life);
}
