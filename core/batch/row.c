#include "batch/row.h"

#include <stdlib.h>

#include "api/ticking.h"
#include "api/view.h"

trocar_status row_create(trocar_model *model, insertion_workspace *workspace, batch_row *row, trocar_error *why) {
    *row = (batch_row){.sim = NULL};
    trocar_status status = sim_create(model, workspace, &row->sim, why);
    if (status == TROCAR_OK) status = sim_save_new(row->sim, &row->fresh, &row->fresh_bytes, why);
    if (status != TROCAR_OK) row_free(row);
    return status;
}

void row_free(batch_row *row) {
    trocar_sim_free(row->sim);
    free(row->fresh);
    *row = (batch_row){.sim = NULL};
}

trocar_status row_reset(const batch_row *row, int needles, const trocar_pose *poses, trocar_error *why) {
    trocar_status status = trocar_sim_restore(row->sim, row->fresh, row->fresh_bytes, why);
    for (int n = 0; n < needles && status == TROCAR_OK; n++) status = trocar_sim_reset(row->sim, n, &poses[n], why);
    return status;
}

trocar_status check_driven_needles(const trocar_model *model, int needles, trocar_error *why) {
    int there = model->parts.config.needle_count;
    if (model->mesh_only) return fail(why, TROCAR_BAD_INPUT, "the model has only a mesh: create it without mesh_only");
    if (there >= needles) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%d needles are driven and the model has %d; the scene's \"needles\" says how many", needles, there);
}

/* True if the needle is resting or about to rest, so it is not ticked. A needle being taken is ticked, because its step completes the handover. */
static bool rests(const trocar_sim *sim, int needle) {
    trocar_needle_state state = trocar_sim_needle_state(sim, needle);
    return state == TROCAR_NEEDLE_LEAVING || state == TROCAR_NEEDLE_RESTING;
}

static trocar_output output_at_rest(const trocar_sim *sim, int needle) {
    const insertion_state *state = state_of_needle(sim, needle, NULL);
    return (trocar_output){.depth = state->tip.place.phase == TIP_FREE ? 0.0 : state->tip.place.depth, .contacts = contacts_active(state), .membrane = NO_MEMBRANE};
}

trocar_status step_needles(trocar_sim *sim, int needles, const trocar_pose *poses, double dt, trocar_output *outputs, trocar_error *why) {
    int ticked = 0, leaving = 0;
    for (int n = 0; n < needles; n++) {
        if (rests(sim, n)) {
            leaving += trocar_sim_needle_state(sim, n) == TROCAR_NEEDLE_LEAVING;
            outputs[n] = output_at_rest(sim, n);
            continue;
        }
        trocar_status status = trocar_sim_step(sim, n, &poses[n], dt, &outputs[n], why);
        if (status != TROCAR_OK) return status;
        ticked++;
    }
    return leaving > 0 && ticked == 0 ? trocar_sim_work(sim, NULL, why) : TROCAR_OK; /* in lockstep, a tick attaches leaving needles; if no needle was ticked,
                                                                                        do it here */
}
