#include "device/implant_player.h"

#include <math.h>
#include <string.h>

#include "common/messages.h"
#include "common/realtime.h"
#include "common/timing.h"
#include "device/implant_watch.h"
#include "device/playing.h"
#include "shared/motion.h"
#include "trocar_client.h"

static const double MEAN_SPEED = 0.065; /* m/s, mean speed of a stroke. A minimum-jerk stroke then peaks at 1.875 times this, 122 mm/s; hands were measured to
                                           peak at 123 mm/s, with a mean of 48 mm/s (docs/validation.md, "A whole implant") */
static const double CLEAR = 0.005;      /* m, distance of the tip from the template before insertion and after withdrawal */
static const double PAUSE = 0.1;        /* s, rest before a needle is left and before a seed is dropped */
static const double FURTHER = 1e-3;     /* m, additional distance by which drop_seed draws the needle back before it tries again */
static const int REPEATS = 5;
static const double AT_TARGET = 0.3e-3; /* m, distance from the displaced target within which the tip is considered to have reached it */
static const int CORRECTIONS = 5;       /* maximum number of approaches to a target; several may be needed because the needle's motion displaces the target */
static const double PATIENCE_TO_SEE = 1.0; /* s without pictures after which the player gives up; the server sends 30 pictures per second */
/* part of the message with which the server refuses a command while a seed is still in the needle: see api_seeds.c */
static const char *const PENDING = "still holds";

typedef struct {
    const implant_plan *plan;
    const implant_play *play;
    implant_summary *summary;
    report *why;
    trocar_client *client;
    trocar_client_wrench wrench;
    int needle;
    int priority;            /* priority of the client's thread; 0 keeps that of the calling thread */
    const char *stage;       /* stage of the implant, for the table: "in" or "out" */
    double began, due;       /* s */
    double heard;            /* s, arrival time of the newest wrench */
    double tip;              /* m, length of the needle beyond the template's face */
    implant_watch watch;
    double left_at[TROCAR_MAX_NEEDLES]; /* m, value of `tip` when each needle was left */
} player;

static const planned_needle *planned(const player *p) { return &p->plan->needles[p->needle]; }

static trocar_status fail_needle(player *p, const char *what, const char *reason) {
    return fail(p->why, TROCAR_SYSTEM, "needle %d in hole %s %s%s%s", p->needle, planned(p)->hole, what, reason ? ": " : "", reason ? reason : "");
}

/* Sleeps until the next period begins, and then receives messages. Missed periods are skipped. */
static trocar_status next_period(player *p) {
    double period = 1.0 / p->play->rate;
    p->due = fmax(p->due + period, playing_now());
    sleep_until((int64_t)(1e9 * p->due));
    implant_watch_look(&p->watch);
    return playing_interrupted() ? fail_needle(p, "was not finished", "interrupted") : TROCAR_OK;
}

static void write_row(const player *p, const pose *base) {
    const trocar_client_wrench *w = &p->wrench;
    vec3 axis = q_axis(base->orientation);
    fprintf(p->play->csv, "%.4f,%d,%s,%s,%.6f,%.5f,%.5f,%.5f,%.5f,%.6f,%d\n", playing_now() - p->began, p->needle, planned(p)->hole, p->stage, p->tip, w->force[0],
            w->force[1], w->force[2], -v3_dot(load_vec3(w->force), axis), w->depth, w->flags);
}

static void note_force(player *p) {
    double force = v3_norm(load_vec3(p->wrench.force));
    if (force <= p->summary->greatest_force) return;
    p->summary->greatest_force = force;
    p->summary->greatest_force_needle = p->needle;
}

/* Runs one period in which the hand holds the needle at `tip`. */
static trocar_status hold_period(player *p) {
    trocar_status status = next_period(p);
    if (status != TROCAR_OK) return status;
    pose base = planned(p)->entry;
    base.position = v3_axpy(p->tip - p->plan->needle_length, q_axis(base.orientation), base.position);
    trocar_pose hand = library_pose(base);
    trocar_client_publish(p->client, hand.position, hand.orientation);
    if (trocar_client_newest(p->client, &p->wrench)) p->heard = playing_now();
    if (playing_now() - p->heard > p->play->patience)
        return fail_needle(p, "gets no answer", "check that trocar-server runs with the same LCM URL, and that the needle is neither resting nor held by another device; trocar-top shows the "
                           "server's last refusal");
    note_force(p);
    if (p->play->csv) write_row(p, &base);
    return TROCAR_OK;
}

static trocar_status hold(player *p, double seconds) {
    trocar_status status = TROCAR_OK;
    for (double end = playing_now() + seconds; status == TROCAR_OK && playing_now() < end;) status = hold_period(p);
    return status;
}

/* Keeps holding the needle until the server answers, and a little longer while the force ramps up. */
static trocar_status engage(player *p) {
    double asked = p->heard = playing_now();
    trocar_status status;
    do status = hold_period(p);
    while (status == TROCAR_OK && p->heard <= asked);
    return status == TROCAR_OK ? hold(p, p->play->settle) : status;
}

/* Reads the depth marks of a needle for which no poses are sent, using a message that arrives after this call. */
static trocar_status read_depth(player *p) {
    double asked = playing_now();
    trocar_status status = TROCAR_OK;
    while (status == TROCAR_OK && p->watch.seen[p->needle] <= asked) {
        if (playing_now() - asked > PATIENCE_TO_SEE) return fail_needle(p, "cannot be seen", "the server sends no TROCAR_CONTACTS about it");
        status = next_period(p);
    }
    if (status == TROCAR_OK) p->tip = implant_watch_depth(&p->watch, p->needle, planned(p), p->plan->needle_length);
    double drag = p->tip - p->left_at[p->needle];
    if (fabs(drag) > fabs(p->summary->greatest_drag)) {
        p->summary->greatest_drag = drag;
        p->summary->greatest_drag_needle = p->needle;
    }
    return status;
}

/* Returns the depth (m) to which the tip must be moved to drop this seed. */
static double target(const player *p, int seed) {
    double depth = planned(p)->depths[seed];
    return p->play->follow ? depth + implant_watch_shift(&p->watch, planned(p), seed) : depth;
}

static trocar_status stroke(player *p, double to) {
    trocar_status status = TROCAR_OK;
    double from = p->tip, start = playing_now(), duration = fabs(to - from) / (MEAN_SPEED * p->play->speed), t = 0;
    while (status == TROCAR_OK && t < duration) {
        t = playing_now() - start;
        p->tip = from + (to - from) * motion_fraction(0, duration, t);
        status = hold_period(p);
    }
    p->tip = to;
    return status;
}

static trocar_status go_to(player *p, double depth) {
    trocar_status status = stroke(p, depth);
    return status == TROCAR_OK ? hold(p, PAUSE) : status;
}

/* Moves the tip to the depth at which this seed should be dropped, and rests there. If the player follows displaced targets, it corrects the depth,
   because the tissue carries the target along with the needle. */
static trocar_status go_to_target(player *p, int seed) {
    trocar_status status = go_to(p, target(p, seed));
    for (int i = 0; p->play->follow && status == TROCAR_OK && i < CORRECTIONS && fabs(target(p, seed) - p->tip) > AT_TARGET; i++) status = go_to(p, target(p, seed));
    return status;
}

/* Waits for the reply to the last command. If `holding` is true, continues to send poses while waiting; a resting needle must not receive poses,
   because it has no owner. */
static trocar_status await_reply(player *p, bool holding, trocar_client_answer *answer, char reason[256]) {
    trocar_status status = TROCAR_OK;
    while (status == TROCAR_OK && (*answer = trocar_client_reply(p->client, reason, 256)) == TROCAR_CLIENT_WAITING)
        status = holding ? hold_period(p) : next_period(p);
    return status;
}

static trocar_status await_done(player *p, const char *what) {
    char reason[256];
    trocar_client_answer answer = TROCAR_CLIENT_NONE;
    trocar_status status = await_reply(p, false, &answer, reason);
    return status != TROCAR_OK || answer == TROCAR_CLIENT_DONE ? status : fail_needle(p, what, reason);
}

static trocar_status insert_and_leave(player *p) {
    p->stage = "in";
    p->tip = -CLEAR;
    trocar_status status = engage(p);
    if (status == TROCAR_OK) status = go_to_target(p, 0);
    if (status != TROCAR_OK) return status;
    p->summary->needles++;
    p->left_at[p->needle] = p->tip;
    trocar_client_leave(p->client);
    return await_done(p, "cannot be left");
}

/* Drops a seed. If the tissue has followed the needle while the needle was drawn back, the previous seed is still in the needle, and the server
   refuses to drop the next one. In that case, the hand draws the needle back a little further and tries again. Any other refusal ends the implant. */
static trocar_status drop_seed(player *p) {
    char reason[256];
    trocar_client_answer answer = TROCAR_CLIENT_NONE;
    for (int i = 0; i <= REPEATS; i++) {
        trocar_status status = i == 0 ? TROCAR_OK : stroke(p, p->tip - FURTHER);
        if (status != TROCAR_OK) return status;
        p->summary->repeats += i > 0;
        trocar_client_drop_seeds(p->client, 1, 0);
        status = await_reply(p, true, &answer, reason);
        if (status != TROCAR_OK) return status;
        if (answer != TROCAR_CLIENT_REFUSED || !strstr(reason, PENDING)) break;
    }
    if (answer != TROCAR_CLIENT_DONE) return fail_needle(p, "cannot drop a seed", reason);
    p->summary->seeds++;
    return TROCAR_OK;
}

static trocar_status take_and_draw_back(player *p) {
    const planned_needle *n = planned(p);
    p->stage = "out";
    trocar_client_take(p->client);
    trocar_status status = await_done(p, "cannot be taken");
    if (status == TROCAR_OK) status = read_depth(p);
    if (status == TROCAR_OK) status = engage(p);
    for (int i = 0; status == TROCAR_OK && i < n->seed_count; i++) {
        status = i == 0 || target(p, i) < p->tip ? go_to_target(p, i) : hold(p, PAUSE);
        if (status == TROCAR_OK) status = drop_seed(p);
    }
    return status == TROCAR_OK ? stroke(p, -CLEAR) : status;
}

/* Opens a client for this needle and calls `handle`. A client can hold only one needle, so each needle needs its own client. */
static trocar_status with_needle(player *p, int needle, trocar_status (*handle)(player *)) {
    trocar_client_options options = {.url = p->play->lcm_url, .needle = needle, .priority = p->priority, .without_force = 1};
    char reason[512];
    p->needle = needle;
    p->wrench = (trocar_client_wrench){.membrane = -1};
    p->client = trocar_client_open(&options, reason, sizeof reason);
    if (!p->client) return fail(p->why, TROCAR_SYSTEM, "%s", reason);
    trocar_status status = handle(p);
    trocar_client_close(p->client);
    return status;
}

trocar_status implant_carry_out(const implant_plan *plan, const implant_play *play, implant_summary *summary, report *why) {
    player p = {.plan = plan, .play = play, .summary = summary, .why = why, .began = playing_now()};
    trocar_status status = implant_watch_open(&p.watch, play->lcm_url, plan->node_count, why);
    playing_heed_signals();
    if (play->csv) fputs("t [s],needle,hole,stage,tip [m],fx [N],fy [N],fz [N],against [N],depth [m],flags\n", play->csv);

    *summary = (implant_summary){0};
    if (play->realtime && playing_use_realtime()) p.priority = PRIORITY_DEVICE - 1; /* the client's thread runs at the priority just below that of
                                                                                       this thread */
    for (int i = 0; status == TROCAR_OK && i < plan->needle_count; i++) status = with_needle(&p, i, insert_and_leave);
    for (int i = 0; status == TROCAR_OK && i < plan->needle_count; i++) status = with_needle(&p, i, take_and_draw_back);
    implant_watch_close(&p.watch);
    summary->duration = playing_now() - p.began;
    return status;
}
