#include "oracles/run.h"

#include <stdlib.h>
#include <string.h>

#include "base/cache_line.h"

trocar_status run_create(model_parts *parts, needle_run *r, trocar_error *why) {
    *r = (needle_run){.parts = parts};
    trocar_status status = remesher_create(parts->inverse, &r->remesher, why);
    r->workspace = allocate_on_cache_lines(sizeof *r->workspace);
    r->field_scratch = calloc(model_parts_field_scratch(parts), sizeof *r->field_scratch);
    if (status == TROCAR_OK && !(r->workspace && r->field_scratch)) status = fail(why, TROCAR_NO_MEMORY, "no memory");
    if (status != TROCAR_OK) run_free(r);
    return status;
}

void run_free(needle_run *r) {
    free(r->workspace);
    free(r->field_scratch);
    remesher_free(r->remesher);
}

trocar_status run_step(needle_run *r, tick_input tick, insertion_state *state, compliance_snapshot *snapshot, tick_output *output, trocar_error *why) {
    tick.model = &r->parts->insertion;
    tick.snapshot = snapshot;
    insertion_tick(&tick, state, r->workspace, output);
    if (!insertion_is_finite(state, output)) insertion_start_over(&r->parts->insertion, tick.base.pose, state, output);
    if (snapshot->serial == state->request.serial) return TROCAR_OK;
    return remesher_answer(r->remesher, &state->request, snapshot, why);
}

void run_save(const insertion_state *state, const compliance_snapshot *snapshot, checkpoint *saved) {
    memcpy(&saved->state, state, sizeof *state);
    memcpy(&saved->snapshot, snapshot, sizeof *snapshot);
}

trocar_status run_restore(needle_run *r, const checkpoint *saved, insertion_state *state, compliance_snapshot *snapshot, trocar_error *why) {
    memcpy(state, &saved->state, sizeof *state);
    memcpy(snapshot, &saved->snapshot, sizeof *snapshot);
    return remesher_resume(r->remesher, &state->request, snapshot, why);
}

void run_displacement(needle_run *r, const insertion_state *state, vec3 *nominal, vec3 *added) {
    memset(nominal, 0, (size_t)r->parts->mesh.node_count * sizeof *nominal);
    model_parts_field(r->parts, r->parts->inverse, state, r->field_scratch, nominal, added);
}
