#include "scene/scene.h"

#include <stdlib.h>
#include <string.h>

#include "scene/scene_document.h"
#include "scene/scene_file.h"

/* ---- values that must fit each other ---------------------------------------------------------------------------------------- */

static const region_config *find_region(const simulation_config *c, const char *name) {
    for (int i = 0; i < c->region_count; i++)
        if (strcmp(c->regions[i].name, name) == 0) return &c->regions[i];
    return NULL;
}

static void check_part(const simulation_config *c, int index, fault *f) {
    char key[KEY_ROOM];
    const region_config *region = &c->regions[index], *whole = find_region(c, region->part_of);
    if (region->part_of[0] == '\0') return;
    snprintf(key, sizeof key, "regions[%d].part_of", index);
    if (!whole) reject(f, key, "there is no region \"%s\"", region->part_of);
    else if (whole == region) reject(f, key, "\"%s\" is this region itself; omit the key", region->part_of);
    else if (whole->part_of[0]) reject(f, key, "\"%s\" is itself a part of \"%s\"; write that name", region->part_of, whole->part_of);
}

static void check_region(const region_config *region, int index, fault *f) {
    char key[KEY_ROOM];
    const region_material *m = &region->material;
    snprintf(key, sizeof key, "regions[%d].friction.kinetic", index);
    if (m->friction_kinetic > m->friction_static)
        reject(f, key, "%g N/m exceeds the static limit of %g N/m", m->friction_kinetic, m->friction_static);
}

/* A scene file must give both the centre and the radius, but a program may have set only one of them. */
static void check_calcification(const calcification *given, int index, fault *f) {
    char key[KEY_ROOM];
    const char *missing = isnan(given->centre.x) ? "centre" : given->radius == 0.0 ? "radius" : NULL;
    snprintf(key, sizeof key, "calcifications[%d].%s", index, missing ? missing : "");
    if (missing) reject(f, key, "is missing");
}

static void check_guide(const guide_config *given, double needle_diameter, int index, fault *f) {
    trocar_error words;
    char key[KEY_ROOM];
    const char *wrong, *name;
    if (!(wrong = guide_fault(given, needle_diameter, &name, &words))) return;
    snprintf(key, sizeof key, "guides[%d].%s", index, name);
    reject(f, key, "%s", wrong);
}

static void check_relaxation(const simulation_config *c, fault *f) {
    char key[KEY_ROOM];
    relaxation_fault wrong = relaxation_check(c->relaxation_count, c->relaxation);
    if (!wrong.key) return;
    snprintf(key, sizeof key, "relaxation[%d].%s", wrong.term, wrong.key);
    reject(f, key, "%s", wrong.words);
}

static void check_probe(const probe_config *probe, fault *f) {
    const probe_shape *p = &probe->shape;
    if (p->tip_radius > p->radius) reject(f, "probe.tip_radius", "%g m exceeds the radius of %g m", p->tip_radius, p->radius);
    if (p->tip_radius > p->length) reject(f, "probe.length", "%g m is less than the radius of its tip, %g m", p->length, p->tip_radius);
    if (isfinite(probe->start.position.x) && probe->surface[0] == '\0') reject(f, "probe.start", "there is no probe without probe.surface");
}

static void check_mapping(const device_mapping *m, fault *f) {
    if (m->workspace.x <= 0.0 || m->workspace.y <= 0.0 || m->workspace.z <= 0.0) reject(f, "device.workspace", "expected three numbers above 0 (m)");
}

static void check_all(const scene *s, fault *f) {
    const simulation_config *c = &s->simulation;
    const needle_parameters *n = &c->needle;
    for (int i = 0; i < c->region_count; i++) {
        check_region(&c->regions[i], i, f);
        check_part(c, i, f);
    }
    for (int i = 0; i < c->calcification_count; i++) check_calcification(&c->calcifications[i], i, f);
    for (int i = 0; i < c->guide_count; i++) check_guide(&c->guides[i], n->outer_diameter, i, f);
    check_relaxation(c, f);
    check_probe(&c->probe, f);
    check_mapping(&s->mapping, f);
    if (n->inner_diameter >= n->outer_diameter)
        reject(f, "needle.inner_diameter", "%g m is not below the outer diameter of %g m", n->inner_diameter, n->outer_diameter);
    if (n->outer_diameter >= n->length)
        reject(f, "needle.outer_diameter", "%g m is not below the length of %g m", n->outer_diameter, n->length);
    if (c->seeds.spacing < c->seeds.length)
        reject(f, "seeds.spacing", "seeds of %g m overlap at a spacing of %g m", c->seeds.length, c->seeds.spacing);
    if (c->roi.radius > 0.0 && v3_norm(v3_sub(c->roi.to, c->roi.from)) == 0.0)
        reject(f, "region_of_interest.corridor.to", "the same point as \"from\"");
}

static trocar_status report_fault(const char *name, const fault *f, trocar_error *why) {
    if (!f->found) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: %s%s%s", name, f->key, *f->key ? ": " : "", f->words);
}

trocar_status scene_check(const scene *s, trocar_error *why) {
    fault f = {.found = false};
    if (s->simulation.mesh_path[0] == '\0' && !s->simulation.mesh_given) reject(&f, "", "missing key \"mesh\"");
    if (s->simulation.region_count == 0) reject(&f, "", "missing key \"regions\"");
    if (s->simulation.fixed_count == 0) reject(&f, "", "missing key \"fixed\"");
    check_all(s, &f);
    return report_fault(*s->path ? s->path : "scene", &f, why);
}

/* ---- the file ---------------------------------------------------------------------------------------------------------------- */

void scene_defaults(scene *s) {
    memset(s, 0, sizeof *s);
    simulation_defaults(&s->simulation);
    s->device = device_defaults();
    s->mapping = device_mapping_defaults();
    s->rate_hz = 1000;
    s->start = (pose){v3(NAN, NAN, NAN), {1, 0, 0, 0}};
    s->start_depth = 0.066;
    s->patient_to_mesh[0] = NAN;
}

/* Records the lines of values that will be checked against the mesh later. */
static void note_lines(scene *s, yaml_text *document) {
    char key[KEY_ROOM];
    for (int i = 0; i < s->simulation.guide_count; i++) {
        snprintf(key, sizeof key, "guides[%d].origin", i);
        s->simulation.guides[i].line = yaml_line(document, key);
    }
    for (int i = 0; i < s->simulation.calcification_count; i++) {
        snprintf(key, sizeof key, "calcifications[%d].centre", i);
        s->simulation.calcifications[i].line = yaml_line(document, key);
    }
    s->simulation.probe.surface_line = yaml_line(document, "probe.surface");
    s->simulation.probe.start_line = yaml_line(document, "probe.start");
}

static trocar_status load_text(const char *yaml, size_t length, scene *s, trocar_error *why) {
    yaml_text document;
    trocar_status status = yaml_open(s->path, yaml, length, &document, why);
    if (status != TROCAR_OK) return status;
    fault f = {.found = false};
    yaml_value root = yaml_root(&document);
    take_document(s, &root, &f);
    check_all(s, &f);
    note_lines(s, &document);
    char name[sizeof s->path + 16];
    snprintf(name, sizeof name, "%s:%d", s->path, yaml_line(&document, f.place));
    status = report_fault(name, &f, why);
    yaml_close(&document);
    return status;
}

trocar_status scene_load(const char *path, scene *s, trocar_error *why) {
    scene_defaults(s);
    if (strlen(path) >= sizeof s->path)
        return fail(why, TROCAR_BAD_INPUT, "%.64s...: path of the scene longer than %zu characters", path, sizeof s->path - 1);
    strcpy(s->path, path);
    char *yaml = NULL;
    size_t length = 0;
    trocar_status status = scene_file_read(path, "scene", &yaml, &length, why);
    if (status != TROCAR_OK) return status;
    status = load_text(yaml, length, s, why);
    free(yaml);
    return status;
}

/* ---- one key ----------------------------------------------------------------------------------------------------------------- */

/* Resolves a key such as "regions[0].x" or "regions[prostate].x". Returns the list entry it refers to, the scene itself if the key is not in a list, or NULL if
   there is no such entry. Writes the generic form, "regions[].x", to `pattern`. */
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
    if (list == LISTS || !find_key(pattern)) return NULL;
    long index = strtol(name, &end, 10);
    bool next = append && !LIST_TABLE[list].named && index == *count_of(s, list) && index < LIST_TABLE[list].most; /* entries without names can only be appended
                                                                                                                      in order */
    if (*end == '\0' && next) return append_entry(s, list);
    if (*end == '\0') return index >= 0 && index < *count_of(s, list) ? entry_of(s, list, (int)index) : NULL;
    for (int i = 0; i < *count_of(s, list); i++)
        if (name_of(s, list, i) && strcmp(name_of(s, list, i), name) == 0) return entry_of(s, list, i);
    if (!append || !LIST_TABLE[list].named || *count_of(s, list) == LIST_TABLE[list].most) return NULL;
    void *entry = append_entry(s, list);
    memcpy(entry, name, sizeof name);
    return entry;
}

/* Finds a key's row in the table, and in *base the struct that holds its value. */
static const key_spec *find_value(scene *s, const char *key, bool append, void **base, fault *f) {
    char pattern[KEY_ROOM];
    *base = strlen(key) < KEY_ROOM ? find_entry(s, key, append, pattern) : NULL;
    const key_spec *r = *base ? find_key(pattern) : NULL;
    if (!r) reject(f, "", "no key \"%.100s\"%s", key, *base ? "" : ", or no such entry");
    return r;
}

static trocar_status set(scene *s, const char *key, const char *value, bool live, trocar_error *why) {
    fault f = {.found = false};
    yaml_text document;
    scene *changed = malloc(sizeof *changed);
    if (!changed) return fail(why, TROCAR_NO_MEMORY, "no memory");
    *changed = *s;
    trocar_status status = yaml_open(key, value, strlen(value), &document, why);
    if (status == TROCAR_OK) {
        void *base;
        yaml_value root = yaml_root(&document);
        const key_spec *r = find_value(changed, key, !live, &base, &f);
        if (r && live && !r->live) reject(&f, key, "cannot change during a run: set it in the scene and start again");
        else if (r) take_value(changed, r, key, base, &root, &f);
        status = report_fault("scene", &f, why);
        yaml_close(&document);
    }
    if (status == TROCAR_OK) *s = *changed;
    free(changed);
    return status;
}

trocar_status scene_set(scene *s, const char *key, const char *value, trocar_error *why) { return set(s, key, value, false, why); }

trocar_status scene_set_live(scene *s, const char *key, const char *value, trocar_error *why) { return set(s, key, value, true, why); }

trocar_status scene_get(const scene *s, const char *key, char *value, size_t size, trocar_error *why) {
    fault f = {.found = false};
    void *base;
    const key_spec *r = find_value((scene *)s, key, false, &base, &f);
    if (!r) return report_fault("scene", &f, why);
    int length = print_value(s, r, base, value, size);
    if (length >= 0 && (size_t)length < size) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: its value does not fit in %zu bytes", key, size);
}
