#include "tick_timing.h"

#include <math.h>
#include <stdlib.h>

static const double PUSH_SPEED = 0.1;      /* m/s, on the way in */
enum { LEAP = 100 };                       /* ticks that a puncture may last */
static const double ADVANCE_SPEED = 0.02;  /* m/s */
static const double SWEEP_SPEED = 0.03;    /* m/s */

typedef struct {
    simulation *simulation;
    insertion_state state;
    compliance_snapshot *snapshot;
    tick_output wrench;
    const timing_case *wanted;
} timing_run;

const char *timed_motion_name(timed_motion motion) { return motion == TIMED_ADVANCE ? "advance" : "sweep"; }

static pose displaced(pose base, vec3 by) {
    base.position = v3_add(base.position, q_rotate(base.orientation, by));
    return base;
}

/* A triangular wave: period 1 s, slope +-1, starting upwards from 0. */
static double to_and_fro(double t) {
    double phase = t - floor(t);
    return phase < 0.25 ? phase : phase < 0.75 ? 0.5 - phase : phase - 1.0;
}

/* In the needle's frame, m. */
static vec3 way_after(timed_motion motion, double t) {
    return motion == TIMED_ADVANCE ? v3(0, 0, ADVANCE_SPEED * t) : v3(0, SWEEP_SPEED * to_and_fro(t), 0);
}

/* One tick and its time, ns; then the worker's part, untimed. */
static trocar_status timed_step(timing_run *run, pose base, int64_t *time, report *why) {
    simulation *s = run->simulation;
    int64_t start = monotonic_ns();
    insertion_tick(&(tick_context){.model = &s->insertion, .state = &run->state, .snapshot = run->snapshot, .scratch = s->workspace,
                                   .base = {.pose = base}, .dt = run->wanted->dt, .output = &run->wrench});
    *time = monotonic_ns() - start;
    if (run->snapshot->serial == run->state.request.serial) return TROCAR_OK;
    return remesher_serve(s->remesher, &run->state.request, run->snapshot, why);
}

static trocar_status push_in(timing_run *run, pose *base, report *why) {
    const timing_case *wanted = run->wanted;
    double length = run->simulation->config.needle.length;
    int most = 0;
    for (int tick = 0; run->state.tip.phase != TIP_BEYOND && tick * PUSH_SPEED * wanted->dt < length; tick++) {
        int64_t unused;
        *base = displaced(wanted->start, v3(0, 0, tick * PUSH_SPEED * wanted->dt));
        trocar_status status = timed_step(run, *base, &unused, why);
        if (status != TROCAR_OK || run->wrench.contacts >= wanted->contacts) return status;
        if (run->wrench.contacts > most) most = run->wrench.contacts;
    }
    return fail(why, TROCAR_BAD_INPUT, "%s: the needle meets %d contact nodes on its way in, not %d: take a finer mesh, or "
                "lower the spacing of %g mm", run->simulation->config.mesh_path, most, wanted->contacts,
                1e3 * run->simulation->config.insertion.contact_spacing);
}

/* A membrane's leap leaves several contact nodes behind at once: it is waited for, and the base drawn back until they are gone. */
static trocar_status settle(timing_run *run, pose *base, report *why) {
    const timing_case *wanted = run->wanted;
    int most = (int)(run->simulation->config.needle.length / (PUSH_SPEED * wanted->dt));
    for (int tick = 0; tick < LEAP || (tick < most && run->wrench.contacts > wanted->contacts); tick++) {
        int64_t unused;
        if (tick >= LEAP) *base = displaced(*base, v3(0, 0, -PUSH_SPEED * wanted->dt));
        trocar_status status = timed_step(run, *base, &unused, why);
        if (status != TROCAR_OK) return status;
    }
    return TROCAR_OK;
}

static void record(const tick_output *wrench, int64_t time, tick_timing *result) {
    histogram_add(&result->time, time);
    result->passes += wrench->passes;
    result->switches += wrench->switches;
    result->unstable += (wrench->events & EVENT_UNSTABLE) != 0;
}

/* As long as it has the contacts that it has now: a tick's time grows with them, and a finer mesh has the next one sooner. */
static trocar_status time_motion(timing_run *run, pose from, tick_timing *result, report *why) {
    const timing_case *wanted = run->wanted;
    result->contacts = run->wrench.contacts;
    for (int tick = 1; result->time.count < wanted->ticks; tick++) {
        int64_t time;
        trocar_status status = timed_step(run, displaced(from, way_after(wanted->motion, tick * wanted->dt)), &time, why);
        if (status != TROCAR_OK || run->wrench.contacts != result->contacts) return status;
        record(&run->wrench, time, result);
    }
    return TROCAR_OK;
}

/* From the start once more, where the needle has been in already. */
static trocar_status time_again(timing_run *run, tick_timing *result, report *why) {
    pose base;
    int64_t before = result->time.count;
    insertion_reset(&run->simulation->insertion, run->wanted->start, &run->state);
    trocar_status status = push_in(run, &base, why);
    if (status == TROCAR_OK) status = settle(run, &base, why);
    if (status == TROCAR_OK) status = time_motion(run, base, result, why);
    if (status == TROCAR_OK && result->time.count == before)
        return fail(why, TROCAR_BAD_INPUT, "%s: the needle never keeps %d contacts for a tick: raise the spacing", run->simulation->config.mesh_path,
                    run->wanted->contacts);
    return status;
}

trocar_status tick_timing_measure(simulation *s, const timing_case *wanted, tick_timing *result, report *why) {
    timing_run *run = calloc(1, sizeof *run);
    if (run) run->snapshot = calloc(1, sizeof *run->snapshot);
    if (!run || !run->snapshot) {
        free(run);
        return fail(why, TROCAR_NO_MEMORY, "no memory for a snapshot");
    }
    run->simulation = s;
    run->wanted = wanted;
    *result = (tick_timing){.contacts = 0};
    trocar_status status = TROCAR_OK;
    while (status == TROCAR_OK && result->time.count < wanted->ticks) status = time_again(run, result, why);
    result->passes /= wanted->ticks;
    result->switches /= wanted->ticks;
    free(run->snapshot);
    free(run);
    return status;
}
