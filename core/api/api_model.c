/* trocar.h: models. */
#include <stdlib.h>

#include "api/api.h"
#include "base/flush_denormals.h"

trocar_status trocar_model_create(const trocar_scene *scene, const trocar_model_options *options, trocar_model **model, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    *model = NULL;
    trocar_status status = scene_check(&scene->values, why);
    if (status != TROCAR_OK) return status;
    trocar_model *m = calloc(1, sizeof *m);
    if (!m) return fail(why, TROCAR_NO_MEMORY, "no memory for a model");
    simulation_config config = scene->values.simulation;
    if (options) {
        config.progress = (inverse_progress){options->progress, options->context};
        if (options->longest_catch_up > 0) config.insertion.most_steps = options->longest_catch_up;
    }
    m->rate_hz = scene->values.rate_hz;
    floating_mode before = flush_denormals();
    status = simulation_create_model(&config, &m->parts, why);
    restore_floating_mode(before);
    m->parts.config.mesh_given = NULL; /* the scene's, which may go */
    if (status == TROCAR_OK) *model = m;
    else free(m);
    return status;
}

void trocar_model_free(trocar_model *model) {
    if (!model) return;
    simulation_free(&model->parts);
    free(model);
}

trocar_status trocar_model_prepare(trocar_model *model, trocar_error *error) {
    trocar_error ignored;
    floating_mode before = flush_denormals();
    trocar_status status = inverse_prepare(model->parts.inverse, error ? error : &ignored);
    restore_floating_mode(before);
    return status;
}

const char *trocar_model_inverse(const trocar_model *model) { return inverse_name(model->parts.inverse); }
const char *trocar_model_description(const trocar_model *model) { return model->parts.about_inverse.text; }
int trocar_model_node_count(const trocar_model *model) { return model->parts.mesh.node_count; }
int trocar_model_tet_count(const trocar_model *model) { return model->parts.mesh.tet_count; }
const double *trocar_model_nodes(const trocar_model *model) { return &model->parts.mesh.nodes[0].x; }
const int32_t *trocar_model_tets(const trocar_model *model) { return model->parts.mesh.tets[0]; }
int trocar_model_region_count(const trocar_model *model) { return model->parts.mesh.group_count; }
const int32_t *trocar_model_tet_regions(const trocar_model *model) { return model->parts.mesh.region; }
int trocar_model_segments(const trocar_model *model) { return model->parts.needle.given.segments; }
double trocar_model_rate(const trocar_model *model) { return model->rate_hz; }

const char *trocar_model_region_name(const trocar_model *model, int index) {
    return index >= 0 && index < model->parts.mesh.group_count ? model->parts.mesh.groups[index].name : "";
}
