#include "condense.h"

#include <string.h>

#include "common/progress.h"

/* Prints the path of the condensed inverse. The file does exist, because the model is not created if saving the file fails. */
static trocar_status describe(const trocar_model *model, FILE *out, trocar_error *why) {
    const char *description = trocar_model_description(model);
    if (strcmp(trocar_model_inverse(model), "condensed") != 0)
        return fail(why, TROCAR_BAD_INPUT, "there is no condensed inverse to save: the inverse is %s; set inverse: condensed and a region_of_interest",
                    description);
    fprintf(out, "inverse    %s\n", description);
    return TROCAR_OK;
}

trocar_status condense_scene(const char *scene_path, FILE *out, trocar_error *why) {
    trocar_scene *scene = NULL;
    trocar_model *model = NULL;
    trocar_status status = trocar_scene_load(scene_path, &scene, why);
    const trocar_model_options options = {.watch.progress = progress_show, .log = {progress_warn, "trocar-server"}, .keep_inverse = 1};
    if (status == TROCAR_OK) status = trocar_model_create(scene, &options, &model, why);
    if (status == TROCAR_OK) status = describe(model, out, why);
    trocar_model_free(model);
    trocar_scene_free(scene);
    return status;
}
