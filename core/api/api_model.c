/* Implements trocar/model.h. */
#include <stdlib.h>
#include <string.h>

#include "api/view.h"
#include "base/flush_denormals.h"
#include "base/host_log.h"
#include "saved/model_checksum.h"

_Static_assert(sizeof(bool) == sizeof(uint8_t) && (int)MESH_MAX_GROUPS == 32, "trocar.h says so");

/* Allocates a model and fills *config, the simulation's configuration. Scene values that are not part of the configuration are copied to the model. */
static trocar_status begin_model(const trocar_scene *scene, trocar_model **model, simulation_config *config, trocar_error *why) {
    trocar_status status = scene_check(&scene->values, why);
    if (status != TROCAR_OK) return status;
    trocar_model *m = calloc(1, sizeof *m);
    if (!m) return fail(why, TROCAR_NO_MEMORY, "no memory for a model");
    m->users = 1;
    *config = scene->values.simulation;
    config->scene_path = scene->values.path;
    m->rate_hz = scene->values.rate_hz;
    m->start = scene->values.start;
    memcpy(m->patient_to_mesh, scene->values.patient_to_mesh, sizeof m->patient_to_mesh);
    *model = m;
    return TROCAR_OK;
}

static trocar_status end_model(trocar_model *m, trocar_status status, trocar_model **model) {
    if (m->parts.config.mesh_given) m->parts.config.mesh_path[0] = '\0'; /* no file was read */
    m->parts.config.mesh_given = NULL; /* belongs to the scene, which the host may free before the model */
    m->parts.config.scene_path = NULL;
    if (status == TROCAR_OK) *model = m;
    else free(m);
    return status;
}

trocar_model_options trocar_default_model_options(void) {
    simulation_config config;
    simulation_defaults(&config);
    return (trocar_model_options){.max_substeps = config.insertion.most_steps};
}

/* Logs which inverse was chosen and any remarks on the mesh, so that the host need not query them. */
static void log_new_model(const trocar_model *m) {
    if (m->parts.mesh.remarks.text[0]) host_log(&m->log, TROCAR_LOG_WARNING, "%s", m->parts.mesh.remarks.text);
    if (!m->mesh_only) host_log(&m->log, TROCAR_LOG_INFO, "inverse: %s", m->parts.about_inverse.text);
}

trocar_status trocar_model_create(const trocar_scene *scene, const trocar_model_options *options, trocar_model **model, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_model *m = NULL;
    simulation_config config;
    *model = NULL;
    trocar_status status = begin_model(scene, &m, &config, why);
    if (status != TROCAR_OK) return status;
    if (options) {
        config.progress = (inverse_progress){options->watch.progress, options->watch.context, options->watch.cancelled};
        m->log = options->log;
        config.keep_inverse = options->keep_inverse;
        if (options->max_substeps > 0) config.insertion.most_steps = options->max_substeps;
    }
    m->mesh_only = options && options->mesh_only;
    floating_mode before = flush_denormals();
    status = m->mesh_only ? model_parts_create_mesh(&config, &m->parts, why) : model_parts_create(&config, &m->parts, why);
    restore_floating_mode(before);
    if (status == TROCAR_OK) {
        m->mesh_checksum = mesh_checksum(&m->parts);
        m->checksum = model_checksum(m->mesh_checksum, &scene->values, &m->parts);
        log_new_model(m);
    }
    return end_model(m, status, model);
}

trocar_status trocar_model_derive(const trocar_model *base, const trocar_scene *scene, trocar_model **model, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_model *m = NULL;
    simulation_config config;
    *model = NULL;
    if (base->mesh_only) return fail(why, TROCAR_BAD_INPUT, "a model that has only a mesh has no stiffness to share");
    trocar_status status = begin_model(scene, &m, &config, why);
    if (status != TROCAR_OK) return status;
    m->log = base->log;
    config.insertion.most_steps = base->parts.config.insertion.most_steps;
    floating_mode before = flush_denormals();
    status = model_parts_derive(&base->parts, &config, &m->parts, why);
    restore_floating_mode(before);
    if (status == TROCAR_OK) {
        m->base = model_share((trocar_model *)base);
        m->mesh_checksum = base->mesh_checksum;
        m->checksum = model_checksum(m->mesh_checksum, &scene->values, &m->parts);
    }
    return end_model(m, status, model);
}

void trocar_model_free(trocar_model *model) {
    while (model && atomic_fetch_sub_explicit(&model->users, 1, memory_order_acq_rel) == 1) {
        trocar_model *base = model->base;
        model_parts_free(&model->parts);
        free(model);
        model = base;
    }
}

trocar_status trocar_model_prepare(trocar_model *model, trocar_error *error) {
    trocar_error ignored;
    if (model->mesh_only) return TROCAR_OK;
    floating_mode before = flush_denormals();
    trocar_status status = inverse_prepare(model->parts.inverse, error ? error : &ignored);
    restore_floating_mode(before);
    return status;
}

trocar_status model_stiffen(trocar_model *base, const simulation_config *config, const trocar_watch *watch, trocar_model **created, trocar_error *why) {
    trocar_model *m = calloc(1, sizeof *m);
    if (!m) return fail(why, TROCAR_NO_MEMORY, "no memory for a model");
    simulation_config changed = base->parts.config;
    double *to[MAX_MODULI], *from[MAX_MODULI];
    int count = simulation_moduli(&changed, to);
    simulation_moduli((simulation_config *)config, from); /* the cast is safe: `from` points into `config`, but is only read */
    for (int i = 0; i < count; i++) *to[i] = *from[i];
    changed.progress = watch ? (inverse_progress){watch->progress, watch->context, watch->cancelled} : (inverse_progress){0};
    changed.keep_inverse = false;
    floating_mode before = flush_denormals();
    trocar_status status = model_parts_stiffen(&base->parts, &changed, &m->parts, why);
    restore_floating_mode(before);
    if (status != TROCAR_OK) {
        free(m);
        return status;
    }
    m->users = 1;
    m->log = base->log;
    m->base = model_share(base);
    *created = m;
    return TROCAR_OK;
}

static _Atomic(trocar_model *) retired; /* list of models without users, waiting for model_free_retired; shared by all simulations */

void model_release(trocar_model *model) {
    if (atomic_fetch_sub_explicit(&model->users, 1, memory_order_acq_rel) > 1) return;
    model->next_retired = atomic_load_explicit(&retired, memory_order_relaxed);
    while (!atomic_compare_exchange_weak_explicit(&retired, &model->next_retired, model, memory_order_release, memory_order_relaxed)) {}
}

void model_free_retired(void) {
    if (!atomic_load_explicit(&retired, memory_order_relaxed)) return;
    trocar_model *next, *model = atomic_exchange_explicit(&retired, NULL, memory_order_acquire);
    for (; model; model = next) {
        next = model->next_retired;
        model->users = 1;
        trocar_model_free(model);
    }
}

static bool has_region(const trocar_model *model, int index) { return index >= 0 && index < model->parts.mesh.group_count; }

const char *trocar_model_inverse(const trocar_model *model) { return model->mesh_only ? "" : inverse_name(model->parts.inverse); }
const char *trocar_model_description(const trocar_model *model) { return model->parts.about_inverse.text; }
const char *trocar_model_remarks(const trocar_model *model) { return model->parts.mesh.remarks.text; }
int trocar_model_unknowns(const trocar_model *model) { return model->parts.tissue.dof_count; }
int trocar_model_needles(const trocar_model *model) { return model->parts.config.needle_count; }
int trocar_model_segments(const trocar_model *model) { return model->parts.config.needle.segments; }
double trocar_model_needle_length(const trocar_model *model) { return model->parts.config.needle.length; }
double trocar_model_rate(const trocar_model *model) { return model->rate_hz; }

int trocar_model_start(const trocar_model *model, trocar_pose *start) {
    return start_out(model->start, start);
}

int trocar_model_patient_to_mesh(const trocar_model *model, double matrix[16]) {
    return transform_out(model->patient_to_mesh, matrix);
}

int trocar_model_node_count(const trocar_model *model) { return model->parts.mesh.node_count; }
int trocar_model_tet_count(const trocar_model *model) { return model->parts.mesh.tet_count; }
const double *trocar_model_nodes(const trocar_model *model) { return &model->parts.mesh.nodes[0].x; }
const int32_t *trocar_model_tets(const trocar_model *model) { return model->parts.mesh.tets[0]; }
const int32_t *trocar_model_neighbours(const trocar_model *model) { return model->parts.mesh.neighbours[0]; }
const int32_t *trocar_model_tet_regions(const trocar_model *model) { return model->parts.mesh.region; }
const uint32_t *trocar_model_face_surfaces(const trocar_model *model) { return model->parts.mesh.face_groups[0]; }
const uint8_t *trocar_model_fixed(const trocar_model *model) { return (const uint8_t *)model->parts.tissue.fixed; }
int trocar_model_region_count(const trocar_model *model) { return model->parts.mesh.group_count; }

const char *trocar_model_region_name(const trocar_model *model, int index) {
    return has_region(model, index) ? model->parts.mesh.groups[index].name : "";
}

int trocar_model_region_dimension(const trocar_model *model, int index) {
    return has_region(model, index) ? model->parts.mesh.groups[index].dimension : -1;
}

int trocar_model_part_of(const trocar_model *model, int index) { return has_region(model, index) ? model->parts.wholes[index] : -1; }

int trocar_model_find_region(const trocar_model *model, const char *name, int dimension) {
    return mesh_find_group(&model->parts.mesh, name, dimension);
}

int trocar_model_entry(const trocar_model *model, const double from[3], const double to[3], double point[3]) {
    surface_hit hit = mesh_enter(&model->parts.mesh, v3(from[0], from[1], from[2]), v3(to[0], to[1], to[2]));
    if (!hit.hit) return 0;
    point[0] = hit.point.x;
    point[1] = hit.point.y;
    point[2] = hit.point.z;
    return 1;
}

trocar_material trocar_model_material(const trocar_model *model, int region) {
    if (trocar_model_region_dimension(model, region) != 3) return (trocar_material){0};
    const region_material *m = &model->parts.materials[region];
    return (trocar_material){.youngs_modulus = m->youngs_modulus, .poisson_ratio = m->poisson_ratio, .cutting_force = m->cutting_force,
                             .cutting_viscosity = m->cutting_viscosity, .friction_static = m->friction_static,
                             .friction_kinetic = m->friction_kinetic, .friction_viscous = m->friction_viscous,
                             .spreading_force = m->spreading_force, .stiffening = m->stiffening};
}

trocar_membrane trocar_model_membrane(const trocar_model *model, int region) {
    if (trocar_model_region_dimension(model, region) != 2) return (trocar_membrane){0};
    const membrane_material *m = &model->parts.membrane_materials[region];
    return (trocar_membrane){.stiffness = m->stiffness, .poisson_ratio = m->poisson_ratio};
}

int trocar_model_guide_count(const trocar_model *model) { return model->parts.config.guide_count; }

trocar_guide trocar_model_guide(const trocar_model *model, int index) {
    if (index < 0 || index >= model->parts.config.guide_count) return (trocar_guide){.columns = 0};
    const guide *g = &model->parts.guides[index];
    trocar_guide out = {.spacing = g->spacing, .hole_diameter = 2.0 * g->hole_radius, .thickness = g->thickness, .columns = g->columns, .rows = g->rows};
    store_vec3(g->origin, out.origin);
    store_vec3(g->normal, out.normal);
    for (int a = 0; a < 2; a++) store_vec3(g->across[a], out.across[a]);
    return out;
}

int trocar_model_averages_strain(const trocar_model *model) { return model->parts.config.volumetric == STRAIN_BY_NODE; }

const int32_t *trocar_model_strain_patches(const trocar_model *model) { return model->parts.tissue.patch; }
