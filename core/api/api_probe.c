/* Implements trocar/probe.h. See docs/mechanics.md, "Probe". */
#include "api/ticking.h"
#include "api/view.h"

_Static_assert(TROCAR_MAX_PRESSED == (int)MAX_PRESSED, "limits differ from trocar.h");

int trocar_model_probe(const trocar_model *model, trocar_probe_shape *out) {
    const probe_shape *shape = &model->parts.config.probe.shape;
    if (model->parts.probe_surface < 0) return 0;
    *out = (trocar_probe_shape){.radius = shape->radius, .tip_radius = shape->tip_radius, .length = shape->length, .surface = model->parts.probe_surface};
    return 1;
}

int trocar_model_probe_start(const trocar_model *model, trocar_pose *start) {
    return model->parts.probe_surface < 0 ? 0 : start_out(model->parts.config.probe.start, start);
}

trocar_status trocar_sim_set_probe(trocar_sim *sim, const trocar_pose *base, trocar_error *error) {
    pose at;
    if (!sim->probe) return error ? fail(error, TROCAR_BAD_INPUT, "the scene has no probe: name the surface that it presses in probe.surface") : TROCAR_BAD_INPUT;
    trocar_status status = check_pose(base, &at, error);
    if (status != TROCAR_OK) return status;
    probe_link_post(&sim->link.probe, at);
    wake_worker(&sim->link);
    return TROCAR_OK;
}
