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

static const double PATIENCE_TO_SEE = 1.0; /* s without messages before the player gives up; the server sends each kind 30 times a second */
/* part of the message with which the server refuses a seed while the previous one is still in the needle; see api_seeds.c */
static const char *const PENDING = "still holds";

typedef struct {
    const implant_plan *plan;
    trocar_operator *op;
    const implant_play *play;
    implant_summary *summary;
    trocar_error *why;
    trocar_client *client;   /* client for the needle in hand, because a client can hold only one; NULL before the first */
    trocar_client_wrench wrench;
    int needle;
    int priority;            /* of the client's thread; 0 keeps the caller's scheduling */
    const char *stage;       /* for the table: "in" while inserting, "out" while drawing back */
    double began, due;       /* s */
    double heard;            /* s, when the newest wrench arrived */
    double tip;              /* m, how far the needle extends beyond the template's face */
    implant_watch *watch;
    double left_at[TROCAR_MAX_NEEDLES]; /* m, `tip` of each needle when it was left */
} player;

static const planned_needle *planned(const player *p) { return &p->plan->needles[p->needle]; }

static trocar_status fail_needle(player *p, const char *what, const char *reason) {
    return fail(p->why, TROCAR_SYSTEM, "needle %d in hole %s %s%s%s", p->needle, planned(p)->hole, what, reason ? ": " : "", reason ? reason : "");
}

/* Sleeps until the next period and receives messages. Skips missed periods. */
static trocar_status next_period(player *p) {
    double period = 1.0 / p->play->rate;
    p->due = fmax(p->due + period, playing_now());
    sleep_until((int64_t)(1e9 * p->due));
    implant_watch_look(p->watch);
    return playing_interrupted() ? fail_needle(p, "was not finished", "interrupted") : TROCAR_OK;
}

static void write_row(const player *p, const trocar_pose *base) {
    const trocar_client_wrench *w = &p->wrench;
    vec3 axis = q_axis(load_pose(base->position, base->orientation).orientation);
    fprintf(p->play->csv, "%.4f,%d,%s,%s,%.6f,%.5f,%.5f,%.5f,%.5f,%.6f,%d\n", playing_now() - p->began, p->needle, planned(p)->hole, p->stage, p->tip, w->force[0],
            w->force[1], w->force[2], -v3_dot(load_vec3(w->force), axis), w->depth, w->flags);
}

static void note_force(player *p) {
    double force = v3_norm(load_vec3(p->wrench.force));
    if (force <= p->summary->greatest_force) return;
    p->summary->greatest_force = force;
    p->summary->greatest_force_needle = p->needle;
}

/* Holds the needle at `tip` for one period. */
static trocar_status hold_period(player *p) {
    trocar_status status = next_period(p);
    if (status != TROCAR_OK) return status;
    trocar_pose base = trocar_operator_base(p->op, p->needle, p->tip);
    trocar_client_publish(p->client, base.position, base.orientation);
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

/* Holds the needle until the server answers, and a little longer while the force ramps up. */
static trocar_status engage(player *p) {
    double asked = p->heard = playing_now();
    trocar_status status;
    do status = hold_period(p);
    while (status == TROCAR_OK && p->heard <= asked);
    return status == TROCAR_OK ? hold(p, p->play->settle) : status;
}

/* Reads the depth marks of a needle that nobody is holding, from a message that arrives after this call. */
static trocar_status read_depth(player *p) {
    double asked = playing_now();
    trocar_status status = TROCAR_OK;
    while (status == TROCAR_OK && p->watch->seen[p->needle] <= asked) {
        if (playing_now() - asked > PATIENCE_TO_SEE) return fail_needle(p, "cannot be seen", "the server sends no TROCAR_CONTACTS about it");
        status = next_period(p);
    }
    if (status == TROCAR_OK) p->tip = trocar_operator_depth(p->op, p->needle, &p->watch->bases[p->needle]);
    double drag = p->tip - p->left_at[p->needle];
    if (fabs(drag) > fabs(p->summary->greatest_drag)) {
        p->summary->greatest_drag = drag;
        p->summary->greatest_drag_needle = p->needle;
    }
    return status;
}

static trocar_status move(player *p, double to, double duration, double pause) {
    trocar_status status = TROCAR_OK;
    double from = p->tip, start = playing_now(), t = 0;
    while (status == TROCAR_OK && t < duration) {
        t = playing_now() - start;
        p->tip = from + (to - from) * motion_fraction(0, duration, t);
        status = hold_period(p);
    }
    p->tip = to;
    return status == TROCAR_OK ? hold(p, pause) : status;
}

/* Waits for the reply to the last command. If `holding` is true, keeps sending poses meanwhile. A resting needle must not get any, because nobody owns it. */
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

/* Closes the previous needle's client and opens one for this needle. */
static trocar_status pick_up(player *p, int needle, const char *stage) {
    trocar_client_options options = {.url = p->play->lcm_url, .needle = needle, .priority = p->priority, .without_force = 1};
    char reason[512];
    if (p->client) trocar_client_close(p->client);
    p->needle = needle;
    p->stage = stage;
    p->wrench = (trocar_client_wrench){.membrane = -1};
    p->client = trocar_client_open(&options, reason, sizeof reason);
    return p->client ? TROCAR_OK : fail(p->why, TROCAR_SYSTEM, "%s", reason);
}

static trocar_status start(player *p, int needle, double depth) {
    trocar_status status = pick_up(p, needle, "in");
    p->tip = depth;
    return status == TROCAR_OK ? engage(p) : status;
}

static trocar_status leave(player *p) {
    p->summary->needles++;
    p->left_at[p->needle] = p->tip;
    trocar_client_leave(p->client);
    return await_done(p, "cannot be left");
}

static trocar_status take(player *p, int needle) {
    trocar_status status = pick_up(p, needle, "out");
    if (status != TROCAR_OK) return status;
    trocar_client_take(p->client);
    status = await_done(p, "cannot be taken");
    if (status == TROCAR_OK) status = read_depth(p);
    return status == TROCAR_OK ? engage(p) : status;
}

/* Drops seeds. If the tissue moved with the needle as it was drawn back, an earlier seed is still inside and the server refuses; `refused` is then set, for
   the operator to see. Any other refusal ends the implant. */
static trocar_status drop(player *p, int count, double spacing, bool *refused) {
    char reason[256];
    trocar_client_answer answer = TROCAR_CLIENT_NONE;
    trocar_client_drop_seeds(p->client, count, spacing);
    trocar_status status = await_reply(p, true, &answer, reason);
    if (status != TROCAR_OK) return status;
    *refused = answer == TROCAR_CLIENT_REFUSED && strstr(reason, PENDING);
    p->summary->repeats += *refused;
    if (answer == TROCAR_CLIENT_DONE) p->summary->seeds += count;
    return answer == TROCAR_CLIENT_DONE || *refused ? TROCAR_OK : fail_needle(p, "cannot drop a seed", reason);
}

static trocar_status perform(player *p, const trocar_operator_action *action, bool *refused) {
    *refused = false;
    switch (action->act) {
    case TROCAR_OPERATOR_START: return start(p, action->needle, action->depth);
    case TROCAR_OPERATOR_MOVE: return move(p, action->depth, action->duration, action->pause);
    case TROCAR_OPERATOR_LEAVE: return leave(p);
    case TROCAR_OPERATOR_TAKE: return take(p, action->needle);
    case TROCAR_OPERATOR_DROP: return drop(p, action->seeds, action->spacing, refused);
    default: return TROCAR_OK;
    }
}

/* Does what the operator decides until the implant is finished. */
static trocar_status carry_out(player *p) {
    trocar_operator_action action = {.act = TROCAR_OPERATOR_START};
    bool refused = false;
    for (;;) {
        trocar_operator_sight sight = {p->tip, p->watch->displacements, refused};
        trocar_status status = trocar_operator_next(p->op, &sight, &action, p->why);
        if (status == TROCAR_OK) status = perform(p, &action, &refused);
        if (status != TROCAR_OK || action.act == TROCAR_OPERATOR_FINISHED) return status;
    }
}

/* Waits up to PATIENCE_TO_SEE for the server to report all seeds. */
static trocar_status see_seeds(player *p) {
    double began = playing_now();
    trocar_status status = TROCAR_OK;
    while (status == TROCAR_OK && p->watch->seed_count < p->summary->seeds && playing_now() - began < PATIENCE_TO_SEE) status = next_period(p);
    return status;
}

trocar_status implant_carry_out(const implant_plan *plan, trocar_operator *op, const implant_play *play, implant_watch *watch, implant_summary *summary,
                                trocar_error *why) {
    player p = {.plan = plan, .op = op, .play = play, .watch = watch, .summary = summary, .why = why, .began = playing_now()};
    playing_heed_signals();
    if (play->csv) fputs("t [s],needle,hole,stage,tip [m],fx [N],fy [N],fz [N],against [N],depth [m],flags\n", play->csv);

    *summary = (implant_summary){0};
    if (play->realtime && playing_use_realtime()) p.priority = PRIORITY_DEVICE - 1; /* just below this thread */
    trocar_status status = carry_out(&p);
    if (p.client) trocar_client_close(p.client);
    summary->duration = playing_now() - p.began;
    return status == TROCAR_OK ? see_seeds(&p) : status;
}
