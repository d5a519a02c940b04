/* Implements creation and lockstep stepping (trocar/sim.h). */
#include <stdlib.h>
#include <string.h>

#include "api/ticking.h"
#include "api/worker.h"
#include "api/worker_answer.h"
#include "api/worker_probe.h"
#include "base/cache_line.h"
#include "base/flush_denormals.h"
#include "base/host_log.h"
#include "base/host_watch.h"

_Static_assert(TROCAR_MAX_CONTACTS == (int)MAX_CONTACTS && TROCAR_MAX_JOINTS == NEEDLE_MAX_SEGMENTS + 1 && TROCAR_MAX_NEEDLES == (int)MAX_NEEDLES,
               "limits differ from trocar.h");
_Static_assert(TROCAR_MAX_GUIDES == (int)MAX_GUIDES && TROCAR_MAX_POINTS == (int)MAX_POINTS, "limits differ from trocar.h");
_Static_assert(TROCAR_CONTACT_TISSUE == (int)POINT_TISSUE && TROCAR_CONTACT_TIP == (int)POINT_TIP && TROCAR_CONTACT_GUIDE == (int)POINT_GUIDE, "contact kinds differ from trocar.h");
_Static_assert(TROCAR_EVENT_TOUCHED == (int)EVENT_TOUCHED && TROCAR_EVENT_TRACK_DROPPED == (int)EVENT_TRACK_DROPPED && TROCAR_EVENT_INEXACT == (int)EVENT_INEXACT, "event bits differ from trocar.h");
_Static_assert(TROCAR_MAX_TRACKS == (int)MAX_TRACKS && TROCAR_MAX_TRACK_POINTS == (int)MAX_TRACK_POINTS && NO_MEMBRANE == -1, "limits differ from trocar.h");
_Static_assert(TROCAR_STAGES == (int)TIMED_PARTS && TROCAR_STAGE_WRENCH == (int)TIMED_WRENCH, "stages differ from trocar.h");

/* ---- creation ------------------------------------------------------------------------------------------------------------ */

static trocar_status create_needle(const trocar_sim *sim, sim_needle *needle, trocar_error *why) {
    trocar_status status = link_create(&needle->link, sim->borrows_workspace, why);
    if (status == TROCAR_OK && sim->probe) status = link_create_holds(&needle->link, why);
    if (status != TROCAR_OK) return status;
    return remesher_create(sim->inverse, &needle->remesher, why);
}

static trocar_status create_inverse(trocar_sim *sim, trocar_error *why) {
    trocar_status status = inverse_create_mixed(sim->model->parts.inverse, &sim->mixed, why);
    if (status == TROCAR_OK) status = inverse_create_mixed(sim->model->parts.inverse, &sim->shown, why);
    if (status == TROCAR_OK) status = inverse_create_attached(sim->mixed, &sim->resting.inverse, why);
    sim->inverse = sim->resting.inverse;
    return status;
}

static trocar_status allocate(trocar_sim *sim, trocar_error *why) {
    size_t needles = (size_t)sim->needle_count * sizeof *sim->needles;
    sim->needles = allocate_on_cache_lines(needles); /* also touches the pages, so that the ticking thread does not fault later */
    if (!sim->borrows_workspace) sim->workspace = allocate_on_cache_lines(sizeof *sim->workspace);
    if (!sim->needles || !sim->workspace) return fail(why, TROCAR_NO_MEMORY, "no memory for a simulation");
    trocar_status status = sim_link_create(&sim->link, sim->model->parts.probe_surface >= 0, sim->borrows_workspace, why);
    if (status == TROCAR_OK && !sim->borrows_workspace) status = changing_create(&sim->model->parts, &sim->changing, why);
    if (status == TROCAR_OK) status = create_inverse(sim, why);
    if (status == TROCAR_OK) status = create_probe(sim, why);
    if (status == TROCAR_OK && (sim->needle_count > 1 || sim->model->parts.insertion.creep.count > 0))
        status = needle_pairs_create(inverse_tissue(sim->mixed), sim->model->parts.needle.radius, &sim->pairs, why);
    sim->resting.pairs = sim->pairs;
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) status = create_needle(sim, &sim->needles[i], why);
    return status;
}

trocar_status trocar_sim_create(trocar_model *model, trocar_sim **created, trocar_error *error) {
    trocar_error ignored;
    return sim_create(model, NULL, created, error ? error : &ignored);
}

trocar_status sim_create(trocar_model *model, insertion_workspace *workspace, trocar_sim **created, trocar_error *why) {
    static const trocar_pose at_origin = {{0, 0, 0}, {1, 0, 0, 0}};
    *created = NULL;
    if (model->mesh_only) return fail(why, TROCAR_BAD_INPUT, "this model has only a mesh: create it without mesh_only");
    trocar_sim *sim = allocate_on_cache_lines(sizeof *sim);
    if (!sim) return fail(why, TROCAR_NO_MEMORY, "no memory for a simulation");
    sim->model = model_share(model);
    sim->elasticity.from = moduli_of(model_share(model));
    sim->elasticity.to = moduli_of(model_share(model));
    sim->view = (trocar_view){.model = model, .sim = sim, .scratch = &sim->field_scratch};
    sim->needle_count = model->parts.config.needle_count;
    sim->workspace = workspace;
    sim->borrows_workspace = workspace != NULL;
    sim->link.work_event = -1;
    trocar_status status = allocate(sim, why);
    const pose start = sim->model->parts.config.probe.start;
    if (status == TROCAR_OK && sim->probe && !isnan(start.position.x)) {
        probe_link_post(&sim->link.probe, start);
        wake_worker(&sim->link);
    }
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) {
        sim->needles[i].link.since_release = RELEASE_TIME;
        status = trocar_sim_reset(sim, i, &at_origin, why);
        sim->needles[i].state.tracks = (track_list){.count = 0}; /* drop any track through the origin: no needle has been inserted yet */
    }
    if (status == TROCAR_OK) *created = sim;
    else trocar_sim_free(sim);
    return status;
}

void trocar_sim_free(trocar_sim *sim) {
    if (!sim) return;
    for (int i = 0; sim->needles && i < sim->needle_count; i++) {
        remesher_free(sim->needles[i].remesher);
        link_free(&sim->needles[i].link);
        free(sim->needles[i].resting);
    }
    probe_free(sim->probe);
    resting_set_free(&sim->resting);
    needle_pairs_free(sim->pairs);
    inverse_free(sim->resting.inverse);
    inverse_free(sim->mixed);
    inverse_free(sim->shown);
    trocar_model_free(sim->elasticity.from.model);
    trocar_model_free(sim->elasticity.to.model);
    free(sim->resting_scratch);
    sim_link_free(&sim->link);
    changing_free(sim->changing);
    free(sim->needles);
    if (!sim->borrows_workspace) free(sim->workspace);
    free(sim->field_scratch);
    trocar_model_free(sim->model);
    model_free_retired();
    free(sim);
}

/* ---- lockstep ------------------------------------------------------------------------------------------------------------ */

trocar_status sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, const after_tick *after, trocar_output *output, trocar_error *why) {
    pose at;
    if (!(dt > 0.0 && dt <= 1.0)) return fail(why, TROCAR_BAD_INPUT, "dt of %g s: above 0 and at most 1 s", dt);
    trocar_status status = check_needle(sim, needle, why);
    if (status == TROCAR_OK) status = check_pose(base, &at, why);
    if (status != TROCAR_OK) return status;
    floating_mode before = flush_denormals();
    sim_needle *n = &sim->needles[needle];
    bool outdated, finite = true;
    trocar_status derived = TROCAR_OK;
    trocar_error reason;
    status = worker_before_tick(sim, needle, &outdated, why);
    adopt_needle(sim, n);
    if (status == TROCAR_OK && link_refuses(&n->link, ON_TICK)) status = fail(why, TROCAR_BAD_INPUT, "needle %d rests: take it first", needle);
    if (status == TROCAR_OK && outdated) status = answer_and_publish(sim, needle, why);
    if (status == TROCAR_OK) {
        const compliance_snapshot *answer = link_answer(&n->link, n->state.request.insertion);
        finite = run_tick(sim, needle, answer, at, dt, output) == TROCAR_OK; /* if not finite, run_tick has restarted the insertion, and the step goes on as
                                                                                usual */
        if (after && finite) {
            tick_input tick = tick_of(sim, needle, answer, dt);
            derived = after->call(&tick, &n->state, sim->workspace, after->context, &reason);
        }
        post_hold(sim, n, answer);
        status = worker_after_tick(sim, needle, answer, dt, why);
    }
    restore_floating_mode(before);
    if (!finite) host_log(&sim->model->log, TROCAR_LOG_WARNING, "needle %d: the result of a step was not finite; its insertion starts over", needle);
    if (status == TROCAR_OK && after && !finite) return fail(why, TROCAR_NUMERIC, "needle %d: the result of the step was not finite; its insertion starts over", needle);
    return status == TROCAR_OK && derived != TROCAR_OK ? fail(why, derived, "%s", reason.text) : status;
}

trocar_status trocar_sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output, trocar_error *error) {
    trocar_error ignored;
    return sim_step(sim, needle, base, dt, NULL, output, error ? error : &ignored);
}

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

void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void)) { sim->clock = sim->workspace->profile.clock = clock; }

void trocar_sim_stages(const trocar_sim *sim, int64_t nanoseconds[TROCAR_STAGES]) {
    memcpy(nanoseconds, sim->workspace->profile.spent, sizeof sim->workspace->profile.spent);
}
