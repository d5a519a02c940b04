#include "playback.h"

#include <stdlib.h>

#include "feed.h"
#include "messages.h"
#include "poselog.h"
#include "sight.h"

typedef struct {
    const scene *scene;
    pose_log poses;
    simulation simulation;
    sight sight;
    insertion_state *state;
    compliance_snapshot *snapshot;
    timeline *timeline;
    double next_picture;     /* s */
    int gaps;
} playback;

static trocar_status prepare(playback *p, const char *path, report *why) {
    trocar_status status = pose_log_read(path, &p->poses, why);
    if (status == TROCAR_OK) status = simulation_create(&p->scene->simulation, &p->simulation, why);
    if (status != TROCAR_OK) return status;
    p->state = calloc(1, sizeof *p->state);
    p->snapshot = calloc(1, sizeof *p->snapshot);
    if (!p->state || !p->snapshot) status = fail(why, TROCAR_NO_MEMORY, "no memory for the state");
    if (status == TROCAR_OK) status = sight_create(&p->sight, &p->simulation, why);
    if (status != TROCAR_OK) simulation_free(&p->simulation);
    return status;
}

static void clean_up(playback *p) {
    if (p->sight.simulation) {
        sight_free(&p->sight);
        simulation_free(&p->simulation);
    }
    free(p->state);
    free(p->snapshot);
    pose_log_free(&p->poses);
}

static trocar_status add_picture(playback *p, int tick, double time, report *why) {
    sight_take(&p->sight, p->state, tick, p->poses.poses[tick].utime);
    p->next_picture += 1.0 / PLAYBACK_HZ;
    return timeline_add_picture(p->timeline, time, &p->sight.contacts, &p->sight.deformation, why);
}

static trocar_status play_tick(playback *p, int tick, report *why) {
    double time = pose_log_time(&p->poses, tick), dt = pose_log_interval(&p->poses, tick, p->scene->rate_hz, &p->gaps);
    pose base = pose_of_message(&p->poses.poses[tick]);
    insertion_wrench wrench;
    trocar_status status = simulation_step(&p->simulation, p->state, p->snapshot, base, dt, &wrench, why);
    if (status != TROCAR_OK) return status;
    trocar_needle_wrench_t message = wrench_message(&wrench);
    plot_sample sample = sample_of_wrench(time, &message);
    status = timeline_add_sample(p->timeline, &sample, why);
    bool last = tick == p->poses.count - 1;
    return status == TROCAR_OK && (time >= p->next_picture || last) ? add_picture(p, tick, time, why) : status;
}

trocar_status playback_run(const scene *scene, const char *path, timeline *t, report *why) {
    playback p = {.scene = scene, .timeline = t};
    trocar_status status = prepare(&p, path, why);
    if (status == TROCAR_OK) insertion_reset(&p.simulation.insertion, pose_of_message(&p.poses.poses[0]), p.state);
    for (int tick = 0; status == TROCAR_OK && tick < p.poses.count; tick++) status = play_tick(&p, tick, why);
    clean_up(&p);
    return status;
}
