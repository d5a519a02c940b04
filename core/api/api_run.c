/* trocar.h: many ticks per call. */
#include <string.h>

#include "api/api.h"
#include "base/host_watch.h"

trocar_status trocar_sim_run(trocar_sim *sim, int needle, const trocar_pose *poses, int steps, double dt, const trocar_watch *watch, trocar_output *outputs,
                             trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (steps < 0) return fail(why, TROCAR_BAD_INPUT, "%d steps: expected 0 or more", steps);
    trocar_status status = TROCAR_OK;
    trocar_error reason;
    int done = 0;
    memset(outputs, 0, (size_t)steps * sizeof *outputs);
    while (done < steps && status == TROCAR_OK) {
        int end = watch_next_look(done, steps);
        for (; done < end && status == TROCAR_OK; done += status == TROCAR_OK) status = trocar_sim_step(sim, needle, &poses[done], dt, &outputs[done], &reason);
        watch_report(watch, "run", (double)done / steps);
        if (status == TROCAR_OK && done < steps && watch_cancels(watch)) status = fail(&reason, TROCAR_CANCELLED, "cancelled");
    }
    if (status == TROCAR_OK) return status;
    memset(outputs + done, 0, (size_t)(steps - done) * sizeof *outputs);
    return fail(why, status, "step %d: %.900s", done, reason.text);
}
