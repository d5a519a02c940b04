#include "view/stream/playback.h"

#include <stdio.h>
#include <stdlib.h>

#include "common/messages.h"
#include "common/viewer_messages.h"
#include "shared/poselog.h"
#include "shared/command_replay.h"
#include "view/stream/subscriber.h"

static const double CLOCK = 1e-6; /* s, resolution of the times in a log */

typedef struct {
    const trocar_scene *scene;
    pose_log poses;
    trocar_model *model;
    trocar_sim *sim;
    viewer_messages messages;
    int probes_done, commands_done; /* probe poses and commands handled so far */
    waiting_drop waiting;
    waiting_change change;
    int refused;             /* commands refused here, although the server had not refused them */
    trocar_error refusal;    /* why the first of them was refused */
    int gaps;
} playback;

static trocar_status prepare(playback *p, const char *path, trocar_error *cut, trocar_error *why) {
    trocar_status status = pose_log_read_to_cut(path, &p->poses, cut, why);
    if (status == TROCAR_OK) status = trocar_model_create(p->scene, NULL, &p->model, why);
    if (status == TROCAR_OK) status = trocar_sim_create(p->model, &p->sim, why);
    if (status == TROCAR_OK) status = viewer_messages_create(&p->messages, p->model, why);
    if (status != TROCAR_OK) return status;
    trocar_pose start = library_pose(pose_of_message(&p->poses.poses[0]));
    return trocar_sim_reset(p->sim, 0, &start, why);
}

static void clean_up(playback *p) {
    end_waiting_change(&p->change);
    viewer_messages_free(&p->messages);
    trocar_sim_free(p->sim);
    trocar_model_free(p->model);
    pose_log_free(&p->poses);
}

static void note_refusal(playback *p, const trocar_error *reason) {
    if (p->refused++ == 0) p->refusal = *reason;
}

/* Executes the changes and seed commands that arrived before this pose. As in the server, a refused command changes nothing. */
static void run_commands(playback *p, int pose) {
    trocar_error reason;
    if (!try_waiting_drop(&p->waiting, p->sim, 0)) note_refusal(p, &p->waiting.reason);
    if (try_waiting_change(&p->change, p->sim, &reason) != TROCAR_OK) note_refusal(p, &reason);
    for (; p->commands_done < p->poses.command_count && p->poses.commands[p->commands_done].next_pose <= pose; p->commands_done++) {
        const logged_command *logged = &p->poses.commands[p->commands_done];
        if (logged->change) {
            if (replay_change(&p->change, p->sim, logged, &reason) != TROCAR_OK) note_refusal(p, &reason);
            continue;
        }
        if (!end_waiting_drop(&p->waiting, p->sim, 0, logged)) note_refusal(p, &p->waiting.reason);
        if (replay_seed_command(&p->waiting, p->sim, 0, logged, &reason) != TROCAR_OK) note_refusal(p, &reason);
    }
}

static void say_refusals(const playback *p) {
    if (p->refused > 0) fprintf(stderr, "trocar-view: %d of %d commands refused; the first: %s\n", p->refused, p->commands_done, p->refusal.text);
}

static trocar_status play_tick(playback *p, int tick, plot_sample *sample, trocar_error *why) {
    double time = pose_log_time(&p->poses, tick), dt = pose_log_interval(&p->poses, tick, trocar_model_rate(p->model), &p->gaps);
    trocar_pose base = library_pose(pose_of_message(&p->poses.poses[tick]));
    trocar_output output;
    run_commands(p, tick);
    trocar_status status = pose_log_move_probe(&p->poses, tick, p->model, p->sim, &p->probes_done, why);
    if (status == TROCAR_OK) status = trocar_sim_step(p->sim, 0, &base, dt, &output, why);
    if (status != TROCAR_OK) return status;
    trocar_needle_wrench_t message = wrench_message(&output);
    *sample = sample_of_wrench(time, &message);
    return TROCAR_OK;
}

/* Adds a picture of the state after the last tick. */
static trocar_status add_picture(playback *p, int tick, timeline *t, trocar_error *why) {
    trocar_sim_take_picture(p->sim, p->messages.picture);
    viewer_messages_make_needle(&p->messages, 0, tick, p->poses.poses[tick].utime);
    trocar_status status = viewer_messages_make_tissue(&p->messages, tick, why);
    if (status != TROCAR_OK) return status;
    viewer_messages_make_tracks(&p->messages, 0, tick);
    const needle_shown needles[] = {{&p->messages.contacts, &p->messages.tracks}};
    trocar_probe probe = trocar_view_probe(trocar_picture_view(p->messages.picture));
    status = timeline_add_picture(t, pose_log_time(&p->poses, tick), needles, 1, &probe, &p->messages.deformation, why);
    if (status != TROCAR_OK || p->poses.command_count == 0) return status;
    viewer_messages_make_seeds(&p->messages, tick);
    return timeline_add_seeds(t, &p->messages.seeds, why);
}

trocar_status playback_run(const trocar_scene *scene, const char *path, timeline *t, trocar_error *cut, trocar_error *why) {
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
    say_refusals(&p);
    clean_up(&p);
    return status;
}

/* Returns the index of the last pose at or before `at`, or -1 if the log ends earlier. */
static int tick_at(const pose_log *poses, double at) {
    int tick = poses->count - 1;
    if (isfinite(at) && pose_log_time(poses, tick) < at - CLOCK) return -1;
    while (tick > 0 && pose_log_time(poses, tick) > at + CLOCK) tick--;
    return tick;
}

trocar_status playback_moment(const trocar_scene *scene, const char *path, double at, timeline *t, trocar_error *cut,
                              trocar_error *why) {
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
    say_refusals(&p);
    clean_up(&p);
    return status;
}
