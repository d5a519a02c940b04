#include "changes/change.h"

#include <stdlib.h>
#include <string.h>

#include "base/decimal.h"
#include "scene/scene_table.h"

enum { VALUE_ROOM = 32, LIVE_MOST = 12 }; /* VALUE_ROOM: bytes for a value's text; LIVE_MOST: most keys per list entry that can change */

void change_begin(const model_parts *parts, const run_values *in_use, change_values *change) {
    change->parts = parts;
    scene_defaults(&change->values);
    change->values.simulation = parts->config;
    if (in_use) change->bound = *in_use;
    else run_values_of(parts, &change->bound);
    run_values_unbind(parts, &change->bound, &change->values.simulation);
}

/* ---- values -------------------------------------------------------------------------------------------------------------- */

/* Returns a key's value as a number, or NAN if there is no such key. */
static double number_at(const scene *values, const char *key) {
    char text[VALUE_ROOM];
    trocar_error ignored;
    if (scene_get(values, key, text, sizeof text, &ignored) != TROCAR_OK) return NAN;
    return strcmp(text, ".inf") == 0 ? INFINITY : decimal_read(text, NULL);
}

static trocar_status set_key(scene *values, const char *key, const char *value, trocar_error *why) {
    double before = number_at(values, key);
    trocar_status status = scene_set_live(values, key, value, why);
    if (status != TROCAR_OK || isinf(before) == isinf(number_at(values, key))) return status;
    return fail(why, TROCAR_BAD_INPUT, "%s: .inf is bone, which neither appears nor vanishes during a run: set it in the scene and start again", key);
}

/* Splits "key: value" at the last colon: the key may contain a name with a colon in it, but the value is a number. */
static trocar_status set_line(scene *values, const char *line, size_t length, trocar_error *why) {
    char text[KEY_ROOM], *colon;
    if (length >= sizeof text) return fail(why, TROCAR_BAD_INPUT, "%.40s...: longer than %d characters", line, KEY_ROOM - 1);
    memcpy(text, line, length);
    text[length] = '\0';
    if (!(colon = strrchr(text, ':'))) return fail(why, TROCAR_BAD_INPUT, "\"%s\": expected \"key: value\"", text);
    char *end = colon;
    while (end > text && end[-1] == ' ') end--;
    *end = '\0';
    return set_key(values, text + strspn(text, " "), colon + 1, why);
}

static trocar_status check_friction(const simulation_config *c, trocar_error *why) {
    for (int i = 0; i < c->region_count; i++) {
        const region_material *m = &c->regions[i].material;
        if (m->friction_kinetic > m->friction_static)
            return fail(why, TROCAR_BAD_INPUT, "regions[%s].friction.kinetic: %g N/m exceeds the static limit of %g N/m: change both together", c->regions[i].name,
                        m->friction_kinetic, m->friction_static);
    }
    return TROCAR_OK;
}

trocar_status change_set(change_values *change, const char *lines, trocar_error *why) {
    scene *values = malloc(sizeof *values);
    if (!values) return fail(why, TROCAR_NO_MEMORY, "no memory for a change");
    *values = change->values;
    trocar_status status = TROCAR_OK;
    bool any = false;
    for (const char *line = lines; *line && status == TROCAR_OK;) {
        size_t length = strcspn(line, "\n");
        if (strspn(line, " \n") < length) status = set_line(values, line, length, why), any = true;
        line += length + (line[length] == '\n');
    }
    if (!any) status = fail(why, TROCAR_BAD_INPUT, "nothing to change: expected lines of \"key: value\"");
    if (status == TROCAR_OK) status = check_friction(&values->simulation, why);
    if (status == TROCAR_OK) {
        change->values = *values;
        run_values_bind(change->parts, &values->simulation, &change->bound);
    }
    free(values);
    return status;
}

/* ---- the keys ------------------------------------------------------------------------------------------------------------ */

/* Collects the rows of the scene table that belong to one list and whose values may change during a run. Returns how many. */
static int live_rows(list_kind list, const key_spec *rows[LIVE_MOST]) {
    int count = 0;
    for (int i = 0; i < SCENE_ROWS && count < LIVE_MOST; i++)
        if (SCENE_TABLE[i].live && SCENE_TABLE[i].list == list) rows[count++] = &SCENE_TABLE[i];
    return count;
}

int change_count(const change_values *change) {
    const key_spec *rows[LIVE_MOST];
    int count = 0;
    for (list_kind list = NO_LIST + 1; list < LISTS; list++) count += live_rows(list, rows) * *count_of((scene *)&change->values, list);
    return count;
}

/* Keys are sorted by list, then by entry, then by table row. */
int change_at(const change_values *change, int index, char key[TROCAR_CHANGE_KEY], double *value) {
    scene *values = (scene *)&change->values; /* cast away const: count_of, name_of and entry_of only read it */
    const key_spec *rows[LIVE_MOST];
    for (list_kind list = NO_LIST + 1; list < LISTS && index >= 0; list++) {
        int each = live_rows(list, rows), here = each * *count_of(values, list);
        if (index >= here) {
            index -= here;
            continue;
        }
        int entry = index / each;
        const key_spec *row = rows[index % each];
        char number[12];
        snprintf(number, sizeof number, "%d", entry);
        snprintf(key, TROCAR_CHANGE_KEY, "%s[%s]%s", LIST_TABLE[list].key, LIST_TABLE[list].named ? name_of(values, list, entry) : number, strstr(row->key, "[]") + 2);
        memcpy(value, (const char *)entry_of(values, list, entry) + row->offset, sizeof *value); /* every value that may change is a double */
        return 1;
    }
    return 0;
}
