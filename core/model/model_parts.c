#include "model/model_parts.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/cache_line.h"
#include "base/memory.h"
#include "insertion/model/local_compliance.h"
#include "mesh/sliding_surface.h"
#include "refinement/refined_field.h"
#include "snapshot/free_displacement.h"
#include "tissue/blas.h"

/* Lists the names of the mesh groups of one dimension as "name1, name2, ...", for messages. */
static const char *list_groups(const mesh *m, int dimension, char *text, size_t size) {
    size_t used = 0;
    text[0] = '\0';
    for (int g = 0; g < m->group_count && used < size; g++)
        if (dimension < 0 || m->groups[g].dimension == dimension)
            used += (size_t)snprintf(text + used, size - used, "%s%s", used ? ", " : "", m->groups[g].name);
    return used ? text : "none";
}

static trocar_status bind_regions(model_parts *s, trocar_error *why) {
    char known[512];
    bool bound[MESH_MAX_GROUPS] = {false};
    for (int i = 0; i < s->config.region_count; i++) {
        const region_config *region = &s->config.regions[i];
        int group = mesh_find_group(&s->mesh, region->name, 3);
        if (group < 0)
            return fail(why, TROCAR_BAD_INPUT, "regions: %s has no region \"%s\"; it has: %s", s->config.mesh_path, region->name,
                        list_groups(&s->mesh, 3, known, sizeof known));
        s->materials[group] = region->material;
        bound[group] = true;
    }
    for (int g = 0; g < s->mesh.group_count; g++) s->wholes[g] = g;
    for (int i = 0; i < s->config.region_count; i++) {
        const region_config *region = &s->config.regions[i];
        if (region->part_of[0]) s->wholes[mesh_find_group(&s->mesh, region->name, 3)] = mesh_find_group(&s->mesh, region->part_of, 3);
    }
    for (int g = 0; g < s->mesh.group_count; g++)
        if (s->mesh.groups[g].dimension == 3 && !bound[g])
            return fail(why, TROCAR_BAD_INPUT, "regions: region \"%s\" of %s has no material; add it", s->mesh.groups[g].name, s->config.mesh_path);
    return TROCAR_OK;
}

static trocar_status bind_membranes(model_parts *s, trocar_error *why) {
    char known[512];
    for (int i = 0; i < s->config.membrane_count; i++) {
        const membrane_config *given = &s->config.membranes[i];
        int group = mesh_find_group(&s->mesh, given->name, 2);
        if (group < 0)
            return fail(why, TROCAR_BAD_INPUT, "membranes: %s has no surface \"%s\"; it has: %s", s->config.mesh_path, given->name,
                        list_groups(&s->mesh, 2, known, sizeof known));
        s->membranes[i] = (membrane){group, given->puncture_force};
        s->membrane_materials[group] = given->material;
    }
    return TROCAR_OK;
}

/* Looks up the surfaces on which the tissue slides, before the mesh is split there. */
static trocar_status find_sliding(const model_parts *s, sliding_surface found[MAX_SLIDING], trocar_error *why) {
    char known[512];
    for (int i = 0; i < s->config.sliding_count; i++) {
        const sliding_config *given = &s->config.sliding[i];
        found[i] = (sliding_surface){mesh_find_group(&s->mesh, given->name, 2), given->beside[0] ? mesh_find_group(&s->mesh, given->beside, 3) : -1};
        if (found[i].group < 0)
            return fail(why, TROCAR_BAD_INPUT, "sliding: %s has no surface \"%s\"; it has: %s", s->config.mesh_path, given->name,
                        list_groups(&s->mesh, 2, known, sizeof known));
        if (given->beside[0] && found[i].beside < 0)
            return fail(why, TROCAR_BAD_INPUT, "sliding[%s].beside: %s has no region \"%s\"; it has: %s", given->name, s->config.mesh_path, given->beside,
                        list_groups(&s->mesh, 3, known, sizeof known));
    }
    return TROCAR_OK;
}

static trocar_status let_slide(model_parts *s, trocar_error *why) {
    sliding_surface surfaces[MAX_SLIDING];
    if (s->config.sliding_count == 0) return TROCAR_OK;
    trocar_status status = find_sliding(s, surfaces, why);
    return status == TROCAR_OK ? mesh_let_slide(&s->mesh, s->config.sliding_count, surfaces, s->config.mesh_path, why) : status;
}

static void bind_sliding(model_parts *s) {
    for (int i = 0; i < s->config.sliding_count; i++)
        s->sliding_materials[mesh_find_group(&s->mesh, s->config.sliding[i].name, 2)] = s->config.sliding[i].material;
}

enum { PLACE_ROOM = 600 };

/* Returns "FILE:LINE: ", or "" if the key does not come from a file. */
static const char *place_in_scene(const model_parts *s, int line, char place[PLACE_ROOM]) {
    place[0] = '\0';
    if (line > 0 && s->config.scene_path) snprintf(place, PLACE_ROOM, "%.500s:%d: ", s->config.scene_path, line);
    return place;
}

static trocar_status check_calcifications(const model_parts *s, trocar_error *why) {
    char place[PLACE_ROOM];
    for (int i = 0; i < s->config.calcification_count; i++) {
        const calcification *given = &s->config.calcifications[i];
        vec3 c = given->centre;
        if (mesh_locate(&s->mesh, c, -1) < 0)
            return fail(why, TROCAR_BAD_INPUT, "%scalcifications[%d].centre: %g, %g, %g m lies outside the tissue of %s; centres are in metres, in the mesh's "
                        "coordinates", place_in_scene(s, given->line, place), i, c.x, c.y, c.z, s->config.mesh_path);
    }
    return TROCAR_OK;
}

static trocar_status bind_guides(model_parts *s, trocar_error *why) {
    for (int i = 0; i < s->config.guide_count; i++) {
        const guide_config *given = &s->config.guides[i];
        trocar_error fault;
        const char *key, *words = guide_fault(given, s->config.needle.outer_diameter, &key, &fault);
        if (words) return fail(why, TROCAR_BAD_INPUT, "guides[%d].%s: %s", i, key, words);
        s->guides[i] = guide_make(given, s->config.needle.outer_diameter);
        if (!guide_is_in_tissue(&s->guides[i], &s->mesh)) continue;
        char place[PLACE_ROOM];
        return fail(why, TROCAR_BAD_INPUT, "%sguides[%d].origin: a hole of \"%s\", %g m thick, lies in the tissue at rest: move the origin back against the "
                    "normal until all holes end before the skin", place_in_scene(s, given->line, place), i, given->name, given->thickness);
    }
    return TROCAR_OK;
}

static trocar_status bind_probe(model_parts *s, trocar_error *why) {
    char known[512], place[PLACE_ROOM];
    const probe_config *p = &s->config.probe;
    s->probe_surface = -1;
    if (p->surface[0] == '\0') return TROCAR_OK;
    s->probe_surface = mesh_find_group(&s->mesh, p->surface, 2);
    place_in_scene(s, p->surface_line, place);
    if (s->probe_surface < 0)
        return fail(why, TROCAR_BAD_INPUT, "%sprobe.surface: %s has no surface \"%s\"; it has: %s", place, s->config.mesh_path, p->surface,
                    list_groups(&s->mesh, 2, known, sizeof known));
    if (isnan(p->start.position.x) || !probe_axis_in_tissue(&s->mesh, &p->shape, p->start)) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%sprobe.start: its axis lies in the tissue at rest, so it would press deeper than its radius of %g m: move it out of "
                "the tissue, or leave start away and place it with a pose", place_in_scene(s, p->start_line, place), p->shape.radius);
}

/* Looks up the configuration's group names in the mesh. */
static trocar_status bind_to_mesh(model_parts *s, trocar_error *why) {
    trocar_status status = bind_regions(s, why);
    if (status == TROCAR_OK) status = bind_membranes(s, why);
    bind_sliding(s);
    if (status == TROCAR_OK) status = check_calcifications(s, why);
    if (status == TROCAR_OK) status = bind_guides(s, why);
    return status == TROCAR_OK ? bind_probe(s, why) : status;
}

/* Fails if all nodes of the probe's surface are fixed, because then the surface cannot yield. Call it after creating the tissue. */
static trocar_status check_probe_surface(const model_parts *s, trocar_error *why) {
    char place[PLACE_ROOM];
    if (s->probe_surface < 0) return TROCAR_OK;
    const mesh_group *surface = &s->mesh.groups[s->probe_surface];
    for (int i = 0; i < surface->node_count; i++)
        if (s->tissue.dof[surface->nodes[i]] >= 0) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%sprobe.surface: all nodes of \"%s\" are fixed: name a surface that can move",
                place_in_scene(s, s->config.probe.surface_line, place), surface->name);
}

static trocar_status build_tissue(model_parts *s, trocar_error *why) {
    char known[512];
    bool *fixed = calloc((size_t)s->mesh.node_count, sizeof *fixed);
    if (!fixed) return fail(why, TROCAR_NO_MEMORY, "no memory");
    trocar_status status = TROCAR_OK;
    for (int i = 0; i < s->config.fixed_count && status == TROCAR_OK; i++) {
        int group = mesh_find_group(&s->mesh, s->config.fixed[i], -1);
        if (group < 0)
            status = fail(why, TROCAR_BAD_INPUT, "fixed: %s has no group \"%s\"; it has: %s", s->config.mesh_path, s->config.fixed[i],
                          list_groups(&s->mesh, -1, known, sizeof known));
        else
            for (int k = 0; k < s->mesh.groups[group].node_count; k++) fixed[s->mesh.groups[group].nodes[k]] = true;
    }
    if (status == TROCAR_OK) status = tissue_define(&s->mesh, s->materials, fixed, s->config.volumetric, &s->tissue, why);
    s->tissue.membranes = s->membrane_materials;
    s->tissue.sliding = s->sliding_materials;
    free(fixed);
    return status;
}

/* ---- kind of the inverse ---------------------------------------------------------------------------------------------- */

/* BLAS uses one thread, except to factorise or invert the whole matrix of a large mesh, where more threads save minutes. Condensation has threads of its
   own. */
enum { SEVERAL_THREADS = 30000 }; /* number of unknowns above which BLAS uses several threads */

static bool is_large(const model_parts *s) { return s->tissue.dof_count > SEVERAL_THREADS; }

static trocar_status build_whole(model_parts *s, bool sparse, int roi_count, const int *roi, trocar_error *why) {
    inverse_progress progress = s->config.progress;
    if (!sparse) progress.show = NULL; /* a dense inverse is computed too quickly to report progress */
    trocar_status status = inverse_factor(&s->tissue, sparse ? roi_count : 0, roi, progress, why);
    if (status != TROCAR_OK) return status;
    return sparse ? inverse_create_sparse(&s->tissue, SPARSE_CACHE, &s->inverse, why) : inverse_create_dense(&s->tissue, progress, &s->inverse, why);
}

static trocar_status build_large(model_parts *s, bool sparse, int roi_count, const int *roi, trocar_error *why) {
    blas_begin_turn();
    trocar_status status = build_whole(s, sparse, roi_count, roi, why);
    blas_end_turn();
    return status;
}

static trocar_status build_owner(model_parts *s, int roi_count, const int *roi, trocar_error *why) {
    trocar_error notice;
    const simulation_config *config = &s->config;
    inverse_facts facts = {.given = config->inverse, .precision = config->precision, .node_count = s->mesh.node_count,
                           .dof_count = s->tissue.dof_count, .roi_given = roi_given(&config->roi), .roi_count = roi_count,
                           .memory = memory_total()}; /* total rather than free memory, so that a scene always gets the same kind of inverse on a machine */
    inverse_choice choice = inverse_choose(&facts, &s->about_inverse);
    int threads = is_large(s) ? blas_own_threads() : 1;
    trocar_status status = blas_make_room(threads, why);
    if (status != TROCAR_OK) return status;
    if (choice == INVERSE_CONDENSED) {
        condensed_region region = {.count = roi_count, .nodes = roi, .single = inverse_is_single(config->precision, roi_count), .threads = threads, .directory = config->cache,
                                   .must_be_saved = config->keep_inverse, .progress = config->progress};
        status = inverse_create_condensed(&s->tissue, &region, &s->inverse, &notice, why);
        size_t used = strlen(s->about_inverse.text);
        if (status == TROCAR_OK) snprintf(s->about_inverse.text + used, sizeof s->about_inverse.text - used, ": %.800s", notice.text);
        return status;
    }
    return (is_large(s) ? build_large : build_whole)(s, choice == INVERSE_SPARSE, roi_count, roi, why);
}

/* If there are a probe and a region of interest, adds the nodes that the probe can press to the region. */
static trocar_status add_probe_nodes(const model_parts *s, int **nodes, int *count, trocar_error *why) {
    if (s->probe_surface < 0 || *count == 0) return TROCAR_OK;
    const mesh_group *surface = &s->mesh.groups[s->probe_surface];
    int *all = realloc(*nodes, (size_t)(*count + surface->node_count) * sizeof *all), found = *count;
    if (!all) return fail(why, TROCAR_NO_MEMORY, "no memory for the region of interest");
    *nodes = all;
    for (int i = 0; i < surface->node_count; i++)
        if (!bsearch(&surface->nodes[i], all, (size_t)*count, sizeof *all, compare_nodes)) all[found++] = surface->nodes[i];
    *count = found;
    qsort(all, (size_t)found, sizeof *all, compare_nodes);
    return TROCAR_OK;
}

static trocar_status build_inverse(model_parts *s, trocar_error *why) {
    int *roi, roi_count;
    int surface = s->config.membrane_count > 0 ? s->membranes[0].group : -1;
    trocar_status status = roi_find(&s->mesh, &s->config.roi, surface, &roi, &roi_count, why);
    if (status != TROCAR_OK) return status;
    status = add_probe_nodes(s, &roi, &roi_count, why);
    if (status == TROCAR_OK) status = build_owner(s, roi_count, roi, why);
    free(roi);
    return status;
}

static trocar_status build_insertion(model_parts *s, trocar_error *why) {
    s->insertion = (insertion_model){.mesh = &s->mesh, .tissue = &s->tissue, .materials = s->materials, .needle = &s->needle,
                                     .membranes = s->membranes, .membrane_count = s->config.membrane_count,
                                     .calcifications = s->config.calcifications, .calcification_count = s->config.calcification_count,
                                     .guides = s->guides, .guide_count = s->config.guide_count, .settings = s->config.insertion};
    trocar_status status = creep_from_relaxation(s->config.relaxation_count, s->config.relaxation, &s->insertion.creep, why);
    return status == TROCAR_OK ? local_create(&s->insertion, why) : status;
}

static trocar_status take_mesh(model_parts *s, trocar_error *why) {
    return s->config.mesh_given ? mesh_from_arrays(s->config.mesh_given, &s->mesh, why) : mesh_read_in(s->config.mesh_path, s->config.mesh_unit, &s->mesh, why);
}

trocar_status model_parts_create_mesh(const simulation_config *config, model_parts *s, trocar_error *why) {
    memset(s, 0, sizeof *s);
    s->config = *config;
    trocar_status status = take_mesh(s, why);
    if (status != TROCAR_OK) return status;
    mesh_compare_with_needle(&s->mesh, config->needle.length, config->needle.outer_diameter);
    status = let_slide(s, why);
    if (status == TROCAR_OK) status = bind_to_mesh(s, why);
    if (status != TROCAR_OK) model_parts_free(s);
    return status;
}

trocar_status model_parts_create(const simulation_config *config, model_parts *s, trocar_error *why) {
    memset(s, 0, sizeof *s);
    trocar_status status = blas_start(why);
    if (status == TROCAR_OK) status = model_parts_create_mesh(config, s, why);
    if (status != TROCAR_OK) return status;
    status = inverse_go_on(config->progress, why);
    if (status == TROCAR_OK) status = needle_create(&config->needle, &s->needle, why);
    if (status == TROCAR_OK) status = build_tissue(s, why);
    if (status == TROCAR_OK) status = check_probe_surface(s, why);
    if (status == TROCAR_OK) status = inverse_go_on(config->progress, why);
    if (status == TROCAR_OK) status = build_inverse(s, why);
    if (status == TROCAR_OK) status = build_insertion(s, why);
    if (status != TROCAR_OK) model_parts_free(s);
    return status;
}

/* ---- sharing the inverse ---------------------------------------------------------------------------------------------- */

static bool same_names(int count, const char (*a)[MESH_NAME], const char (*b)[MESH_NAME]) {
    for (int i = 0; i < count; i++)
        if (strcmp(a[i], b[i]) != 0) return false;
    return true;
}

/* Returns the first region key in which the configurations differ, or NULL. `text` is a buffer for the key. */
static const char *region_key_that_differs(const simulation_config *a, const simulation_config *b, char *text, size_t size) {
    if (a->region_count != b->region_count) return "regions";
    for (int i = 0; i < a->region_count; i++) {
        const region_config *r = &a->regions[i], *q = &b->regions[i];
        bool same_name = strcmp(r->name, q->name) == 0, same_modulus = r->material.youngs_modulus == q->material.youngs_modulus;
        if (same_name && same_modulus && r->material.poisson_ratio == q->material.poisson_ratio) continue;
        snprintf(text, size, "regions[%d].%s", i, !same_name ? "name" : !same_modulus ? "youngs_modulus" : "poisson_ratio");
        return text;
    }
    return NULL;
}

static const membrane_config *stiff_membrane(const simulation_config *c, const char *name) {
    for (int i = 0; i < c->membrane_count; i++)
        if (strcmp(c->membranes[i].name, name) == 0) return c->membranes[i].material.stiffness > 0.0 ? &c->membranes[i] : NULL;
    return NULL;
}

/* Like region_key_that_differs, but for the membranes of `a` that have a stiffness. Ignores the order of the membranes. */
static const char *membrane_key_that_differs(const simulation_config *a, const simulation_config *b, char *text, size_t size) {
    for (int i = 0; i < a->membrane_count; i++) {
        const char *name = a->membranes[i].name;
        const membrane_config *given = stiff_membrane(a, name), *other = stiff_membrane(b, name);
        if (!given) continue;
        bool same_stiffness = other && other->material.stiffness == given->material.stiffness;
        if (same_stiffness && other->material.poisson_ratio == given->material.poisson_ratio) continue;
        snprintf(text, size, "membranes[%s].%s", name, same_stiffness ? "poisson_ratio" : "stiffness");
        return text;
    }
    return NULL;
}

static bool same_sliding(const simulation_config *a, const simulation_config *b) {
    bool same = a->sliding_count == b->sliding_count;
    for (int i = 0; i < a->sliding_count && same; i++) {
        const sliding_config *s = &a->sliding[i], *t = &b->sliding[i];
        same = strcmp(s->name, t->name) == 0 && strcmp(s->beside, t->beside) == 0 && s->material.normal == t->material.normal && s->material.shear == t->material.shear;
    }
    return same;
}

static bool same_roi(const roi_config *a, const roi_config *b) {
    return a->region_count == b->region_count && a->radius == b->radius && memcmp(&a->from, &b->from, sizeof a->from) == 0 && memcmp(&a->to, &b->to, sizeof a->to) == 0
        && same_names(a->region_count, a->regions, b->regions);
}

static const char *first_membrane(const simulation_config *c) { return c->membrane_count > 0 ? c->membranes[0].name : ""; }

/* Returns the first key that differs and affects the mesh, stiffness or inverse; NULL if there is none. `text` is a buffer for the key. The probe's surface and
   the first membrane affect the inverse, because a condensed inverse covers that surface and, unless the scene specifies a region of interest, the nodes near
   that membrane. */
static const char *stiffness_key_that_differs(const simulation_config *a, const simulation_config *b, char *text, size_t size) {
    const char *of_material = region_key_that_differs(a, b, text, size);
    if (!of_material) of_material = membrane_key_that_differs(a, b, text, size);
    if (!of_material) of_material = membrane_key_that_differs(b, a, text, size);
    const struct { bool same; const char *key; } keys[] = {
        {strcmp(a->mesh_path, b->mesh_path) == 0, "mesh"},
        {a->mesh_unit == b->mesh_unit, "mesh_unit"},
        {of_material == NULL, of_material},
        {same_sliding(a, b), "sliding"},
        {a->fixed_count == b->fixed_count && same_names(a->fixed_count, a->fixed, b->fixed), "fixed"},
        {a->volumetric == b->volumetric, "volumetric_strain"},
        {a->inverse == b->inverse, "inverse"},
        {a->precision == b->precision, "inverse_precision"},
        {same_roi(&a->roi, &b->roi), "region_of_interest"},
        {strcmp(first_membrane(a), first_membrane(b)) == 0, "membranes[0].name"},
        {strcmp(a->probe.surface, b->probe.surface) == 0, "probe.surface"},
    };
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++)
        if (!keys[i].same) return keys[i].key;
    return NULL;
}

trocar_status model_parts_derive(const model_parts *base, const simulation_config *config, model_parts *s, trocar_error *why) {
    char text[128];
    memset(s, 0, sizeof *s);
    if (config->mesh_given || base->config.mesh_path[0] == '\0')
        return fail(why, TROCAR_BAD_INPUT, "mesh: a model whose mesh was given as arrays cannot be shared: build a separate model");
    const char *key = stiffness_key_that_differs(&base->config, config, text, sizeof text);
    if (key) return fail(why, TROCAR_BAD_INPUT, "%s: differs from that of the model to be shared: build a separate model", key);
    s->config = *config;
    s->shares = true;
    s->mesh = base->mesh;
    s->tissue = tissue_constants(&base->tissue);
    s->inverse = base->inverse;
    s->about_inverse = base->about_inverse;
    trocar_status status = bind_to_mesh(s, why);
    if (status == TROCAR_OK) status = needle_create(&config->needle, &s->needle, why);
    if (status == TROCAR_OK) status = build_insertion(s, why);
    if (status != TROCAR_OK) model_parts_free(s);
    return status;
}

bool same_elasticity(const simulation_config *a, const simulation_config *b) {
    double *of_a[MAX_MODULI], *of_b[MAX_MODULI];
    int count = simulation_moduli((simulation_config *)a, of_a); /* the cast is safe: the moduli are only read */
    simulation_moduli((simulation_config *)b, of_b);
    for (int i = 0; i < count; i++)
        if (*of_a[i] != *of_b[i]) return false;
    return true;
}

trocar_status model_parts_stiffen(const model_parts *base, const simulation_config *config, model_parts *s, trocar_error *why) {
    char text[128];
    memset(s, 0, sizeof *s);
    s->config = *config;
    s->shares = true;
    s->mesh = base->mesh;
    s->stiffened = region_key_that_differs(&base->config, config, text, sizeof text) || membrane_key_that_differs(&base->config, config, text, sizeof text)
        || membrane_key_that_differs(config, &base->config, text, sizeof text);
    trocar_status status = bind_to_mesh(s, why);
    if (status == TROCAR_OK) status = needle_create(&config->needle, &s->needle, why);
    if (status == TROCAR_OK && s->stiffened) status = build_tissue(s, why);
    if (status == TROCAR_OK && s->stiffened) status = build_inverse(s, why);
    if (!s->stiffened) {
        s->tissue = tissue_constants(&base->tissue);
        s->inverse = base->inverse;
        s->about_inverse = base->about_inverse;
    }
    if (status == TROCAR_OK) status = build_insertion(s, why);
    if (status != TROCAR_OK) model_parts_free(s);
    return status;
}

size_t model_parts_field_scratch(const model_parts *s) { return REFINED_FIELD_SCRATCH * ((size_t)s->mesh.node_count + MAX_CONTACTS); }

void model_parts_free(model_parts *s) {
    local_free(&s->insertion);
    if (!s->shares || s->stiffened) {
        inverse_free(s->inverse);
        if (s->tissue.mesh) tissue_free(&s->tissue);
    }
    if (!s->shares) mesh_free(&s->mesh);
    memset(s, 0, sizeof *s);
}

void model_parts_field(const model_parts *s, inverse *inv, const insertion_state *state, vec3 *scratch, vec3 *nominal, vec3 *added) {
    refinement refined;
    vec3 force[MAX_CONTACTS];
    insertion_refinement(state, &refined);
    insertion_forces(&s->insertion, state, nominal, force);
    refined_displacement(inv, &refined, (refined_vectors){nominal, force}, scratch, (refined_vectors){nominal, added});
}
