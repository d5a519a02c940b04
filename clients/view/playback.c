#include "playback.h"

#include <stdlib.h>

#include "subscriber.h"
#include "messages.h"
#include "poselog.h"
#include "viewer_messages.h"

static const double CLOCK = 1e-6; /* s, of the times in a log */

typedef struct {
    const scene *scene;
    pose_log poses;
    simulation simulation;
    viewer_messages messages;
    insertion_state *state;
    compliance_snapshot *snapshot;
    int gaps;
} playback;

static trocar_status prepare(playback *p, const char *path, report *cut, report *why) {
    trocar_status status = pose_log_read_to_cut(path, &p->poses, cut, why);
    if (status == TROCAR_OK) status = simulation_create(&p->scene->simulation, &p->simulation, why);
    if (status != TROCAR_OK) return status;
    p->state = calloc(1, sizeof *p->state);
    p->snapshot = calloc(1, sizeof *p->snapshot);
    if (!p->state || !p->snapshot) status = fail(why, TROCAR_NO_MEMORY, "no memory for the state");
    if (status == TROCAR_OK) status = viewer_messages_create(&p->messages, &p->simulation, why);
    if (status == TROCAR_OK) insertion_reset(&p->simulation.insertion, pose_of_message(&p->poses.poses[0]), p->state);
    else simulation_free(&p->simulation);
    return status;
}

static void clean_up(playback *p) {
    if (p->messages.simulation) {
        viewer_messages_free(&p->messages);
        simulation_free(&p->simulation);
    }
    free(p->state);
    free(p->snapshot);
    pose_log_free(&p->poses);
}

static trocar_status play_tick(playback *p, int tick, plot_sample *sample, report *why) {
    double time = pose_log_time(&p->poses, tick), dt = pose_log_interval(&p->poses, tick, p->scene->rate_hz, &p->gaps);
    pose base = pose_of_message(&p->poses.poses[tick]);
    insertion_wrench wrench;
    trocar_status status = simulation_step(&p->simulation, p->state, p->snapshot, base, dt, &wrench, why);
    if (status != TROCAR_OK) return status;
    trocar_needle_wrench_t message = wrench_message(&wrench);
    *sample = sample_of_wrench(time, &message);
    return TROCAR_OK;
}

/* Of the tick just played. */
static trocar_status add_picture(playback *p, int tick, timeline *t, report *why) {
    viewer_messages_take(&p->messages, p->state, tick, p->poses.poses[tick].utime);
    return timeline_add_picture(t, pose_log_time(&p->poses, tick), &p->messages.contacts, &p->messages.deformation, why);
}

trocar_status playback_run(const scene *scene, const char *path, timeline *t, report *cut, report *why) {
    playback p = {.scene = scene};
    plot_sample sample;
    double next_picture = 0; /* s */
    trocar_status status = prepare(&p, path, cut, why);
    for (int tick = 0; status == TROCAR_OK && tick < p.poses.count; tick++) {
        status = play_tick(&p, tick, &sample, why);
        if (status == TROCAR_OK) status = timeline_add_sample(t, &sample, why);
        if (status != TROCAR_OK || (sample.time < next_picture && tick < p.poses.count - 1)) continue;
        status = add_picture(&p, tick, t, why);
        next_picture += 1.0 / PLAYBACK_HZ;
    }
    clean_up(&p);
    return status;
}

/* The last pose not after `at`, -1 where all are before it. */
static int tick_at(const pose_log *poses, double at) {
    int tick = poses->count - 1;
    if (isfinite(at) && pose_log_time(poses, tick) < at - CLOCK) return -1;
    while (tick > 0 && pose_log_time(poses, tick) > at + CLOCK) tick--;
    return tick;
}

trocar_status playback_moment(const scene *scene, const char *path, double at, timeline *t, report *cut,
                              report *why) {
    playback p = {.scene = scene};
    plot_sample sample;
    trocar_status status = prepare(&p, path, cut, why);
    int last = status == TROCAR_OK ? tick_at(&p.poses, at) : -1;
    if (status == TROCAR_OK && last < 0)
        status = fail(why, TROCAR_BAD_INPUT, "%s: --at %g s is after the last pose at %g s", path, at,
                      pose_log_time(&p.poses, p.poses.count - 1));
    for (int tick = 0; status == TROCAR_OK && tick <= last; tick++) status = play_tick(&p, tick, &sample, why);
    if (status == TROCAR_OK) status = timeline_add_sample(t, &sample, why);
    if (status == TROCAR_OK) status = add_picture(&p, last, t, why);
    clean_up(&p);
    return status;
}
