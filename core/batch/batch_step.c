/* Implements the stepping part of trocar/batch.h. */
#include <stdatomic.h>
#include <string.h>

#include "api/ticking.h"
#include "api/view.h"
#include "base/host_watch.h"
#include "batch/batch.h"

typedef struct {
    const trocar_pose *poses;
    int steps, from, to;     /* steps: number of steps in this call; the current pass over the rows computes steps `from` to `to` - 1 */
    double dt;
    int row_count;           /* number of rows in the mask */
    const trocar_watch *watch;
    const trocar_batch_outputs *out;
    int *done;               /* for each row, number of completed steps */
    bool *failed;            /* for each row, true if a step has failed */
    atomic_bool cancelled;
    atomic_llong completed;  /* total number of steps completed over all rows */
} step_call;

/* ---- outputs --------------------------------------------------------------------------------------------------------------------- */

static void write_tip(const trocar_sim *sim, int needle, trocar_pose *tip) {
    const needle_state *shape = &state_of_needle(sim, needle, NULL)->needle;
    int segments = sim->model->parts.needle.given.segments;
    *tip = pose_out((pose){shape->joints[segments], shape->frames[segments - 1]});
}

/* `at`: index in the output arrays [R][S][N] (row, step, needle). */
static void write_outputs(const trocar_batch_outputs *out, const trocar_sim *sim, int needle, size_t at, const trocar_output *o) {
    if (out->force) memcpy(out->force + 3 * at, o->force, sizeof o->force);
    if (out->torque) memcpy(out->torque + 3 * at, o->torque, sizeof o->torque);
    if (out->depth) out->depth[at] = o->depth;
    if (out->tip) write_tip(sim, needle, &out->tip[at]);
    if (out->contacts) out->contacts[at] = o->contacts;
    if (out->events) out->events[at] = o->events;
    if (out->membrane) out->membrane[at] = o->membrane;
    if (out->passes) out->passes[at] = o->passes;
    if (out->switches) out->switches[at] = o->switches;
}

/* Sets a row's outputs to zero from step `from` on. */
static void clear_outputs(const trocar_batch *batch, const step_call *call, int row, int from) {
    const trocar_batch_outputs *out = call->out;
    size_t step = (size_t)row * (size_t)call->steps + (size_t)from, at = step * (size_t)batch->needles, steps = (size_t)(call->steps - from);
    size_t count = steps * (size_t)batch->needles;
    if (out->force) memset(out->force + 3 * at, 0, 3 * count * sizeof *out->force);
    if (out->torque) memset(out->torque + 3 * at, 0, 3 * count * sizeof *out->torque);
    if (out->depth) memset(out->depth + at, 0, count * sizeof *out->depth);
    if (out->tip) memset(out->tip + at, 0, count * sizeof *out->tip);
    int32_t *const numbers[] = {out->contacts, (int32_t *)out->events, out->membrane, out->passes, out->switches};
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        if (numbers[i]) memset(numbers[i] + at, 0, count * sizeof *numbers[i]);
    if (out->seeds) memset(out->seeds + step, 0, steps * sizeof *out->seeds);
}

/* ---- a row ----------------------------------------------------------------------------------------------------------------------- */

static trocar_status step_row(const trocar_batch *batch, const step_call *call, int row, int step, trocar_error *why) {
    trocar_sim *sim = batch->rows[row].sim;
    size_t at = ((size_t)row * (size_t)call->steps + (size_t)step) * (size_t)batch->needles;
    trocar_output outputs[MAX_NEEDLES];
    trocar_status status = step_needles(sim, batch->needles, &call->poses[at], call->dt, outputs, why);
    if (status != TROCAR_OK) return status;
    for (int n = 0; n < batch->needles; n++) write_outputs(call->out, sim, n, at + (size_t)n, &outputs[n]);
    if (call->out->seeds) call->out->seeds[(size_t)row * (size_t)call->steps + (size_t)step] = sim->seeds.count;
    return TROCAR_OK;
}

static void look(step_call *call) {
    watch_report(call->watch, "batch", (double)atomic_load(&call->completed) / ((double)call->row_count * call->steps));
    if (watch_cancels(call->watch)) atomic_store(&call->cancelled, true);
}

static trocar_status step_task(trocar_batch *batch, int row, int member, void *context, trocar_error *why) {
    step_call *call = context;
    trocar_status status = TROCAR_OK;
    if (call->failed[row] || atomic_load(&call->cancelled)) return TROCAR_OK;
    while (call->done[row] < call->to && status == TROCAR_OK) {
        trocar_error reason;
        status = step_row(batch, call, row, call->done[row], &reason);
        if (status == TROCAR_OK) call->done[row]++;
        else fail(why, status, "step %d: %.900s", call->done[row], reason.text);
    }
    call->failed[row] = status != TROCAR_OK;
    if (call->out->status) call->out->status[row] = (int32_t)status;
    atomic_fetch_add(&call->completed, call->done[row] - call->from);
    if (member == 0) look(call);
    return status;
}

/* ---- all rows -------------------------------------------------------------------------------------------------------------------- */

static void begin_rows(const trocar_batch *batch, step_call *call, const uint8_t *mask) {
    for (int row = 0; row < batch->row_count; row++) {
        if (!batch_has(mask, row)) continue;
        call->row_count++;
        call->done[row] = 0;
        call->failed[row] = false;
        if (call->out->status) call->out->status[row] = TROCAR_OK;
    }
}

static void end_rows(const trocar_batch *batch, step_call *call, const uint8_t *mask) {
    for (int row = 0; row < batch->row_count; row++) {
        if (!batch_has(mask, row)) continue;
        if (call->done[row] < call->steps) clear_outputs(batch, call, row, call->done[row]);
        if (call->out->done) call->out->done[row] = call->done[row];
    }
}

trocar_status trocar_batch_step(trocar_batch *batch, const trocar_pose *poses, int steps, double dt, const uint8_t *mask, const trocar_watch *watch,
                                const trocar_batch_outputs *outputs, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (steps < 0) return fail(why, TROCAR_BAD_INPUT, "%d steps: expected 0 or more", steps);
    if (!(dt > 0.0 && dt <= 1.0)) return fail(why, TROCAR_BAD_INPUT, "dt of %g s: above 0 and at most 1 s", dt);
    step_call call = {.poses = poses, .steps = steps, .dt = dt, .watch = watch, .out = outputs, .done = batch->done, .failed = batch->row_failed};
    begin_rows(batch, &call, mask);
    batch_begin(batch);
    for (call.from = 0; call.from < steps && !atomic_load(&call.cancelled); call.from = call.to) {
        call.to = watch_next_look(call.from, steps);
        batch_for_rows(batch, mask, step_task, &call);
    }
    end_rows(batch, &call, mask);
    if (atomic_load(&call.cancelled) && batch->failure.status == TROCAR_OK) return fail(why, TROCAR_CANCELLED, "cancelled");
    return batch_end(batch, why);
}
