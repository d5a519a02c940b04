#include "pilot.h"

#include <math.h>
#include <string.h>

#include "hole_approach.h"
#include "homes.h"
#include "messages.h"
#include "timing.h"
#include "trocar_command_t.h"

static const double FAR = 0.5; /* m from its home: a needle that was removed */

static const trocar_status_t *status_of(const pilot *p, int needle) { return p->feed->needles[needle].status; }

static bool rests(const pilot *p, int needle) {
    const trocar_status_t *status = status_of(p, needle);
    return status && status->state == TROCAR_STATUS_T_RESTING;
}

static void begin_handover(pilot *p, handover what) {
    p->handing = what;
    p->handing_since = monotonic_ns();
}

/* ---- orders ---- */

/* To go to a hole that the browser has chosen. False: there is no such hole, or the needle is not known to be outside of the tissue: of one that
   has just been taken the last wrench may be from before it rested. */
static bool order_hole(const pilot *p, const float *asked, publisher_order *order) {
    trocar_guide guide = trocar_model_guide(p->model, (int)fmaxf(-1, fminf(asked[0], 1000)));
    double column = asked[1], row = asked[2];
    if (!(column >= 0 && column <= guide.columns - 1 && row >= 0 && row <= guide.rows - 1)) return false;
    *order = (publisher_order){.kind = ORDER_HOLE, .home = hole_home(&guide, column, row, p->needle_length)};
    const trocar_needle_wrench_t *wrench = &p->feed->needles[p->needle].wrench;
    return wrench->session == p->publisher.session && wrench->depth == 0.0;
}

static publisher_order order_take(pilot *p, int needle) {
    pose home = p->homes[needle], base;
    publisher_order order = {.kind = ORDER_TAKE, .needle = needle, .rests = rests(p, needle), .home = home, .base = home};
    if (subscriber_base(p->feed, needle, &base) && v3_norm(v3_sub(base.position, home.position)) < FAR) order.base = base;
    if (order.rests) order.home = find_home_of_base(p->model, p->needle_length, order.base, home);
    p->needle = needle;
    p->driving = true;
    begin_handover(p, order.rests ? HANDING_TAKEN : HANDING_NOTHING);
    return order;
}

void pilot_act(pilot *p, const web_action *action) {
    const float *c = action->steer;
    publisher_order order = {.command = {c[0], c[1], c[2], c[3], c[4], c[5]}};
    switch (action->kind) {
    case ACTION_TAKE: order = order_take(p, (int)action->needle); break;
    case ACTION_STEER: order.kind = ORDER_STEER; break;
    case ACTION_RESET: order.kind = ORDER_RESET; break;
    case ACTION_DROP:
        order.kind = ORDER_DROP;
        order.seeds = (int)fminf(16, fmaxf(1, c[0])); /* one if it is no number */
        break;
    case ACTION_UNDO: order.kind = ORDER_UNDO; break;
    case ACTION_PROBE:
        if (!p->feed->probe.placed) return;
        order.kind = ORDER_PROBE;
        order.base = load_pose(p->feed->probe.base.position, p->feed->probe.base.orientation);
        break;
    case ACTION_HOLE:
        if (p->handing != HANDING_NOTHING || !order_hole(p, c, &order)) return;
        break;
    case ACTION_LEAVE:
        if (p->handing != HANDING_NOTHING) return;
        order.kind = ORDER_LEAVE;
        begin_handover(p, HANDING_LEFT);
        break;
    case ACTION_REMOVE:
        if (action->needle >= (uint32_t)p->feed->needle_count || !rests(p, (int)action->needle)) return;
        order.kind = ORDER_REMOVE;
        order.needle = (int)action->needle;
        break;
    default:
        order.kind = ORDER_RELEASE;
        p->driving = false;
        p->handing = HANDING_NOTHING;
        break;
    }
    publisher_tell(&p->publisher, &order);
}

/* ---- changing hands ---- */

/* The server's answer to the hand-over of the driven needle. Its next status may come a while later: until then, a needle that has been left would look as
   if it could be driven without being taken. */
static void heed_reply(pilot *p) {
    const trocar_command_reply_t *reply = p->feed->reply;
    bool is_new = p->feed->replies_heard != p->replies_heeded;
    p->replies_heeded = p->feed->replies_heard;
    if (!is_new || !reply || reply->needle != p->needle || p->handing == HANDING_NOTHING) return;
    bool left = reply->command == TROCAR_COMMAND_T_LEAVE, taken = reply->command == TROCAR_COMMAND_T_TAKE, done = reply->status == TROCAR_COMMAND_REPLY_T_DONE;
    if (!left && !taken) return;
    trocar_status_t *status = p->feed->needles[p->needle].status;
    if (left && done && status) status->state = TROCAR_STATUS_T_RESTING;
    if (left == done) web_let_go(p->web); /* it rests */
    else publisher_tell(&p->publisher, &(publisher_order){.kind = ORDER_GO_ON});
    if (left) p->handing = HANDING_NOTHING; /* that it has been taken is seen in its status a little later */
}

/* Ends a hand-over of which no more is to be expected. */
static void watch_handover(pilot *p) {
    const trocar_status_t *status = status_of(p, p->needle);
    bool taken = p->handing == HANDING_TAKEN && status && status->state == TROCAR_STATUS_T_HELD;
    if (taken || monotonic_ns() - p->handing_since > HANDOVER_PATIENCE) p->handing = HANDING_NOTHING;
}

void pilot_hear(pilot *p) {
    if (p->feed->servers != p->servers) web_let_go(p->web);
    p->servers = p->feed->servers;
    heed_reply(p);
    watch_handover(p);
}

bool pilot_has(const pilot *p, int needle) {
    int64_t owner = subscriber_owner(p->feed, needle);
    const trocar_status_t *status = status_of(p, needle);
    bool held = status == NULL || status->state == TROCAR_STATUS_T_HELD || (needle == p->needle && p->handing != HANDING_NOTHING);
    return subscriber_alive(p->feed) && held && (owner == 0 || owner == p->publisher.session);
}

bool pilot_may_take(const pilot *p, int needle) {
    return pilot_has(p, needle) || (!p->driving && subscriber_alive(p->feed) && rests(p, needle));
}

/* ---- life ---- */

trocar_status pilot_open(pilot *p, lcm_t *lcm, report *why) {
    trocar_status status = publisher_create(&p->publisher, lcm, p->needle_length, why);
    if (status != TROCAR_OK) return status;
    p->feed->session = p->publisher.session;
    int error = pthread_create(&p->thread, NULL, publisher_run, &p->publisher);
    p->running = error == 0;
    if (p->running) return TROCAR_OK;
    publisher_free(&p->publisher);
    return fail(why, TROCAR_SYSTEM, "cannot create a thread: %s", strerror(error));
}

void pilot_close(pilot *p) {
    if (!p->running) return;
    publisher_tell(&p->publisher, &(publisher_order){.kind = ORDER_END});
    pthread_join(p->thread, NULL);
    publisher_free(&p->publisher);
    p->running = false;
}
