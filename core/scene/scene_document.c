#include "scene/scene_document.h"

#include <string.h>

static void join_key(char out[KEY_ROOM], const char *before, const char *key) { snprintf(out, KEY_ROOM, "%s%s%s", before, *before ? "." : "", key); }

/* A mapping being read: its key, such as "regions[0].friction", the generic form of that key in the table, and the struct for its values. */
typedef struct {
    const char *key, *pattern;
    void *base;              /* the scene, or an entry of a list */
} mapping;

static void take_mapping(scene *s, const mapping *at, const yaml_value *value, fault *f);

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
        take_mapping(s, &(mapping){entry, pattern, append_entry(s, list)}, &item, f);
    }
}

/* Keys of earlier releases, and what to do about them. */
static const struct { const char *key, *remedy; } RETIRED[] = {
    {"contact.resolution", "the simulator measures the mesh's resolution: remove the key"},
    {"contact.placement", "contact nodes are added inside elements: remove the key"},
    {"needle.model", "every needle is a geometrically exact rod: remove the key"},
    {"remeshing", "contact nodes are added by nested addition, and scripts/bench measures other methods: remove the key"},
};

static void reject_unknown(fault *f, const char *key, const mapping *at, const char *name) {
    for (size_t i = 0; i < sizeof RETIRED / sizeof *RETIRED; i++)
        if (strcmp(RETIRED[i].key, key) == 0) reject_at(f, key, at->key, "this release has no key \"%s\": %s", name, RETIRED[i].remedy);
    if (!f->found) reject_at(f, key, at->key, "unknown key \"%s\"", name);
}

static void take_pair(scene *s, const mapping *at, const char *name, const yaml_value *value, fault *f) {
    char key[KEY_ROOM], row_key[KEY_ROOM];
    join_key(key, at->key, name);
    join_key(row_key, at->pattern, name);
    const key_spec *r = find_key(row_key);
    if (r) {
        take_value(s, r, key, at->base, value, f);
        return;
    }
    for (list_kind list = NO_LIST + 1; list < LISTS; list++)
        if (strcmp(LIST_TABLE[list].key, row_key) == 0) {
            take_list(s, list, value, f);
            return;
        }
    if (strcmp(row_key, "regions[].relaxation") == 0)
        reject(f, key, "all regions share one series, because one inverse of the stiffness must serve all times; move it to the top level");
    else if (leads_on(row_key, ".")) take_mapping(s, &(mapping){key, row_key, at->base}, value, f);
    else reject_unknown(f, key, at, name);
}

/* Returns whether the key is the device's profile, which must be read before the keys that override it. */
static bool comes_first(const char *pattern, const char *name) {
    char key[KEY_ROOM];
    join_key(key, pattern, name);
    const key_spec *r = find_key(key);
    return r && r->kind == PROFILE;
}

static void ask_for_keys(const char *key, const char *pattern, const yaml_value *value, fault *f) {
    size_t length = strlen(pattern);
    for (int i = 0; i < SCENE_ROWS; i++) {
        const char *rest = SCENE_TABLE[i].key + length + (length > 0);
        bool here = SCENE_TABLE[i].required && strncmp(SCENE_TABLE[i].key, pattern, length) == 0 && !strpbrk(rest, ".[");
        if (here && !yaml_has_key(value, rest)) reject_at(f, key, key, "missing key \"%s\"", rest);
    }
}

static void take_mapping(scene *s, const mapping *at, const yaml_value *value, fault *f) {
    if (value->kind != YAML_MAPPING) {
        reject(f, at->key, "expected keys with values");
        return;
    }
    for (int late = 0; late <= 1; late++)
        for (int i = 0; i < value->count && !f->found; i++) {
            yaml_value item;
            const char *name = yaml_pair(value, i, &item);
            char place[KEY_ROOM];
            join_key(place, at->key, name);
            if (yaml_key_repeated(value, i)) reject_at(f, place, at->key, "repeated key \"%s\"", name);
            else if (comes_first(at->pattern, name) != late) take_pair(s, at, name, &item, f);
        }
    ask_for_keys(at->key, at->pattern, value, f);
}

void take_document(scene *s, const yaml_value *root, fault *f) {
    take_mapping(s, &(mapping){"", "", s}, root, f);
    for (list_kind list = NO_LIST + 1; list < LISTS; list++)
        if (LIST_TABLE[list].least > 0 && !yaml_has_key(root, LIST_TABLE[list].key)) reject(f, "", "missing key \"%s\"", LIST_TABLE[list].key);
}
