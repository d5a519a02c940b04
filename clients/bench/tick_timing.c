#include "bench/tick_timing.h"

#include <math.h>
#include <poll.h>
#include <stdbool.h>

#include "common/messages.h"

static const double PUSH_SPEED = 0.1;      /* m/s, speed of the insertion */
enum { LEAP = 100 };                       /* ticks to wait for the jump after a puncture to end */
static const double ADVANCE_SPEED = 0.02;  /* m/s, speed along the axis in TIMED_ADVANCE */
static const double SWEEP_SPEED = 0.03;    /* m/s, sideways speed in TIMED_SWEEP */

typedef struct {
    trocar_sim *sim;
    trocar_output output;    /* of the last tick */
    const timing_case *wanted;
    double length;           /* m, needle length */
    double spacing;          /* m, spacing of the contact nodes */
    char mesh[1024];         /* path of the mesh file */
} timing_run;

const char *timed_motion_name(timed_motion motion) { return motion == TIMED_ADVANCE ? "advance" : "sweep"; }

static pose displaced(pose base, vec3 by) {
    base.position = v3_add(base.position, q_rotate(base.orientation, by));
    return base;
}

/* Returns a triangle wave at time t (s): period 1 s, slope +-1, rising from 0 at t = 0. */
static double to_and_fro(double t) {
    double phase = t - floor(t);
    return phase < 0.25 ? phase : phase < 0.75 ? 0.5 - phase : phase - 1.0;
}

/* Returns how far the base has moved after t seconds, in m in the needle's frame. */
static vec3 way_after(timed_motion motion, double t) {
    return motion == TIMED_ADVANCE ? v3(0, 0, ADVANCE_SPEED * t) : v3(0, SWEEP_SPEED * to_and_fro(t), 0);
}

/* Runs one tick and writes how long it took, in ns, to `time`. Then does the worker's part, untimed. */
static trocar_status timed_step(timing_run *run, pose base, int64_t *time, trocar_error *why) {
    struct pollfd request = {.fd = trocar_sim_work_descriptor(run->sim), .events = POLLIN};
    trocar_pose at = library_pose(base);
    int64_t start = monotonic_ns();
    trocar_status status = trocar_sim_tick(run->sim, 0, &at, run->wanted->dt, &run->output);
    *time = monotonic_ns() - start;
    if (status != TROCAR_OK) return fail(why, status, "%s: the tick failed: check that the start is a pose and the tick is above 0 and at most 1 s", run->mesh);
    return poll(&request, 1, 0) == 1 ? trocar_sim_work(run->sim, NULL, why) : TROCAR_OK;
}

static bool is_beyond(const trocar_output *output) {
    return output->events & TROCAR_EVENT_EXITED && !(output->events & (TROCAR_EVENT_REENTERED | TROCAR_EVENT_TOUCHED));
}

static trocar_status push_in(timing_run *run, pose *base, trocar_error *why) {
    const timing_case *wanted = run->wanted;
    int most = 0;
    run->output.events = 0;
    for (int tick = 0; !is_beyond(&run->output) && tick * PUSH_SPEED * wanted->dt < run->length; tick++) {
        int64_t unused;
        *base = displaced(wanted->start, v3(0, 0, tick * PUSH_SPEED * wanted->dt));
        trocar_status status = timed_step(run, *base, &unused, why);
        if (status != TROCAR_OK || run->output.contacts >= wanted->contacts) return status;
        if (run->output.contacts > most) most = run->output.contacts;
    }
    return fail(why, TROCAR_BAD_INPUT, "%s: the needle meets %d contact nodes on its way in, not %d: use a finer mesh, or "
                "lower the spacing of %g mm", run->mesh, most, wanted->contacts, 1e3 * run->spacing);
}

/* Lets the needle settle: it may have jumped through a membrane and passed several contact nodes at once. Waits until the jump is over, then retracts the base
   until the surplus contacts have gone. */
static trocar_status settle(timing_run *run, pose *base, trocar_error *why) {
    const timing_case *wanted = run->wanted;
    int most = (int)(run->length / (PUSH_SPEED * wanted->dt));
    for (int tick = 0; tick < LEAP || (tick < most && run->output.contacts > wanted->contacts); tick++) {
        int64_t unused;
        if (tick >= LEAP) *base = displaced(*base, v3(0, 0, -PUSH_SPEED * wanted->dt));
        trocar_status status = timed_step(run, *base, &unused, why);
        if (status != TROCAR_OK) return status;
    }
    return TROCAR_OK;
}

static void record(const timing_run *run, int64_t time, tick_timing *result) {
    const trocar_output *output = &run->output;
    int64_t stages[TROCAR_STAGES];
    trocar_sim_stages(run->sim, stages);
    for (int i = 0; i < TROCAR_STAGES; i++) result->stages[i] += 1e-9 * (double)stages[i];
    histogram_add(&result->time, time);
    result->passes += output->passes;
    result->switches += output->switches;
    result->unstable += (output->events & TROCAR_EVENT_UNSTABLE) != 0;
}

/* Times ticks until the number of contacts changes. It must not change, because the time per tick grows with it, and in a finer mesh the next contact comes
   sooner. */
static trocar_status time_motion(timing_run *run, pose from, tick_timing *result, trocar_error *why) {
    const timing_case *wanted = run->wanted;
    result->contacts = run->output.contacts;
    for (int tick = 1; result->time.count < wanted->ticks; tick++) {
        int64_t time;
        double t = tick * wanted->dt;
        pose base = displaced(from, way_after(wanted->motion, t));
        base.orientation = q_multiply(base.orientation, q_exp(v3(0, 0, wanted->turn_rate * t)));
        trocar_status status = timed_step(run, base, &time, why);
        if (status != TROCAR_OK || run->output.contacts != result->contacts) return status;
        record(run, time, result);
    }
    return TROCAR_OK;
}

/* Resets the needle and the tissue, inserts the needle again and times the motion. */
static trocar_status time_again(timing_run *run, tick_timing *result, trocar_error *why) {
    pose base;
    int64_t before = result->time.count;
    trocar_pose start = library_pose(run->wanted->start);
    trocar_status status = trocar_sim_reset(run->sim, 0, &start, why);
    if (status == TROCAR_OK) status = push_in(run, &base, why);
    if (status == TROCAR_OK) status = settle(run, &base, why);
    if (status == TROCAR_OK) status = time_motion(run, base, result, why);
    if (status == TROCAR_OK && result->time.count == before)
        return fail(why, TROCAR_BAD_INPUT, "%s: the needle never keeps %d contacts for a tick: raise the spacing", run->mesh,
                    run->wanted->contacts);
    return status;
}

trocar_status tick_timing_measure(trocar_sim *sim, const trocar_scene *scene, const timing_case *wanted, tick_timing *result, trocar_error *why) {
    timing_run run = {.sim = sim, .wanted = wanted};
    trocar_sim_set_clock(sim, monotonic_ns);
    *result = (tick_timing){.contacts = 0};
    trocar_status status = trocar_scene_get_number(scene, "needle.length", &run.length, why);
    if (status == TROCAR_OK) status = trocar_scene_get_number(scene, "contact.spacing", &run.spacing, why);
    if (status == TROCAR_OK) status = trocar_scene_get(scene, "mesh", run.mesh, sizeof run.mesh, why);
    while (status == TROCAR_OK && result->time.count < wanted->ticks) status = time_again(&run, result, why);
    result->passes /= wanted->ticks;
    result->switches /= wanted->ticks;
    for (int i = 0; i < TROCAR_STAGES; i++) result->stages[i] /= wanted->ticks;
    return status;
}

void tick_timing_add(tick_timing *sum, const tick_timing *part) {
    double before = (double)sum->time.count, added = (double)part->time.count;
    sum->passes = (sum->passes * before + part->passes * added) / (before + added);
    sum->switches = (sum->switches * before + part->switches * added) / (before + added);
    for (int i = 0; i < TROCAR_STAGES; i++) sum->stages[i] = (sum->stages[i] * before + part->stages[i] * added) / (before + added);
    sum->contacts = part->contacts;
    sum->unstable += part->unstable;
    histogram_merge(&sum->time, &part->time);
}
