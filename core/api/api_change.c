/* Implements trocar/change.h. */
#include <math.h>
#include <stdlib.h>

#include "api/api.h"
#include "changes/change.h"

struct trocar_change {
    trocar_model *model;
    trocar_model *moduli;    /* once the change is prepared, a model with the moduli in `values`; until then, its moduli may differ */
    change_values values;
};

static trocar_status allocate_change(const trocar_model *model, trocar_change **change, trocar_error *why) {
    *change = calloc(1, sizeof **change);
    if (!*change) return fail(why, TROCAR_NO_MEMORY, "no memory for a change");
    (*change)->model = model_share((trocar_model *)model);
    return TROCAR_OK;
}

trocar_status trocar_change_create(const trocar_sim *sim, trocar_change **change, trocar_error *error) {
    trocar_error ignored;
    trocar_status status = allocate_change(sim->model, change, error ? error : &ignored);
    if (status != TROCAR_OK) return status;
    (*change)->moduli = model_share(sim->elasticity.to.model);
    change_begin(&sim->model->parts, sim->changing ? &sim->changing->ticking.to : NULL, &(*change)->values);
    return TROCAR_OK;
}

trocar_status trocar_change_copy(const trocar_change *change, trocar_change **copy, trocar_error *error) {
    trocar_error ignored;
    trocar_status status = allocate_change(change->model, copy, error ? error : &ignored);
    if (status != TROCAR_OK) return status;
    (*copy)->moduli = model_share(change->moduli);
    (*copy)->values = change->values;
    return TROCAR_OK;
}

void trocar_change_free(trocar_change *change) {
    if (!change) return;
    trocar_model_free(change->moduli);
    trocar_model_free(change->model);
    free(change);
}

trocar_status trocar_change_set(trocar_change *change, const char *lines, trocar_error *error) {
    trocar_error ignored;
    return change_set(&change->values, lines, error ? error : &ignored);
}

int trocar_change_prepared(const trocar_change *change) { return same_elasticity(&change->moduli->parts.config, &change->values.values.simulation); }

trocar_status trocar_change_prepare(trocar_change *change, const trocar_watch *watch, trocar_error *error) {
    trocar_error ignored;
    trocar_model *moduli;
    if (trocar_change_prepared(change)) return TROCAR_OK;
    const simulation_config *config = &change->values.values.simulation;
    trocar_status status = TROCAR_OK;
    if (same_elasticity(&change->model->parts.config, config)) moduli = model_share(change->model);
    else status = model_stiffen(change->model, config, watch, &moduli, error ? error : &ignored);
    if (status != TROCAR_OK) return status;
    trocar_model_free(change->moduli);
    change->moduli = moduli;
    return TROCAR_OK;
}

int trocar_change_count(const trocar_change *change) { return change_count(&change->values); }

int trocar_change_at(const trocar_change *change, int index, char key[TROCAR_CHANGE_KEY], double *value) {
    return index >= 0 && change_at(&change->values, index, key, value);
}

trocar_status trocar_sim_change(trocar_sim *sim, const trocar_change *change, double time, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (!(time >= TROCAR_CHANGE_TIME_LEAST && time <= TROCAR_CHANGE_TIME_MOST))
        return fail(why, TROCAR_BAD_INPUT, "a change in %g s: expected %g to %g s", time, TROCAR_CHANGE_TIME_LEAST, TROCAR_CHANGE_TIME_MOST);
    if (change->model->checksum != sim->model->checksum) return fail(why, TROCAR_BAD_INPUT, "the change was made for a simulation of another model");
    bool stiffens = change->moduli != sim->elasticity.to.model;
    if (!trocar_change_prepared(change)) return fail(why, TROCAR_BAD_INPUT, "the change's moduli have no model yet: call trocar_change_prepare first");
    if (!trocar_sim_accepts(sim, change)) return fail(why, TROCAR_BAD_INPUT, "the moduli are still moving to their last values: wait %g s", elasticity_left(&sim->elasticity));
    trocar_status status = sim->changing ? TROCAR_OK : changing_create(&sim->model->parts, &sim->changing, why); /* allocates only in a batch, which is not
                                                                                                                    real-time */
    if (status != TROCAR_OK) return status;
    if (stiffens) {
        model_release(sim->elasticity.to.model);
        elasticity_change(&sim->elasticity, moduli_of(model_share(change->moduli)), sim->rounds.time, time);
    }
    changing_begin(sim->changing, &change->values.bound, sim->rounds.time, time);
    wake_worker(&sim->link);
    return TROCAR_OK;
}

double trocar_sim_changing(const trocar_sim *sim) {
    return sim->changing ? fmax((1.0 - sim->changing->ticking.part) * sim->changing->ticking.duration, elasticity_left(&sim->elasticity)) : 0.0;
}

int trocar_sim_accepts(const trocar_sim *sim, const trocar_change *change) {
    return change->moduli == sim->elasticity.to.model || elasticity_left(&sim->elasticity) == 0.0;
}
