#include "view/hand/pilot.h"

#include <math.h>
#include <string.h>

#include "common/messages.h"
#include "common/timing.h"
#include "trocar_command_t.h"
#include "view/hand/hole_approach.h"
#include "view/hand/parking_poses.h"

static const int64_t RECENT = 500000000; /* ns, how long a wrench counts as recent */
static const double FAR = 0.5; /* m; a needle whose base is farther than this from its home has been removed */

static const trocar_status_t *status_of(const pilot *p, int needle) { return p->feed->needles[needle].status; }

static bool rests(const pilot *p, int needle) {
    const trocar_status_t *status = status_of(p, needle);
    return status && status->state == TROCAR_STATUS_T_RESTING;
}

/* True if the needle is resting or has no owner. */
static bool may_remove(const pilot *p, int needle) {
    const trocar_status_t *status = status_of(p, needle);
    return rests(p, needle) || (status && status->state == TROCAR_STATUS_T_HELD && subscriber_owner(p->feed, needle) == 0);
}

static void begin_handover(pilot *p, handover what) {
    p->handing = what;
    p->handing_since = monotonic_ns();
}

/* True if the needle's last wrench is at most half a second old and shows the needle in the tissue. There are no wrenches for a needle that is resting or has
   never been held. */
static bool is_in_tissue(const pilot *p, int needle) {
    const needle_feed *n = &p->feed->needles[needle];
    return n->wrench.depth > 0.0 && monotonic_ns() - n->heard < RECENT;
}

/* ---- orders ---- */

/* Sends the needle to a hole that the browser has chosen. Returns false if there is no such hole, or if the needle is not known to be outside the tissue: if it
   has only just been taken, its last wrench may be from before it came to rest. */
static bool order_hole(pilot *p, const float *asked, publisher_order *order) {
    int index = (int)fmaxf(-1, fminf(asked[0], 1000));
    trocar_guide guide = trocar_model_guide(p->model, index);
    double column = asked[1], row = asked[2];
    if (!(column >= 0 && column <= guide.columns - 1 && row >= 0 && row <= guide.rows - 1)) return false;
    *order = (publisher_order){.kind = ORDER_HOLE, .home = hole_home(&guide, column, row, p->needle_length)};
    const trocar_needle_wrench_t *wrench = &p->feed->needles[p->needle].wrench;
    if (wrench->session != p->publisher.session || wrench->depth != 0.0) return false;
    p->has_hole = true;
    p->guide = index;
    p->column = (int)column;
    p->row = (int)row;
    return true;
}

/* Takes a needle. Simply holding one that is in the tissue without an owner would straighten it and reset the tissue. Such a needle is first left to rest, then
   taken. */
static publisher_order order_take(pilot *p, int needle) {
    pose home = p->parking_poses[needle], base;
    publisher_order order = {.kind = ORDER_TAKE, .needle = needle, .rests = rests(p, needle), .home = home, .base = home};
    if (subscriber_base(p->feed, needle, &base) && v3_norm(v3_sub(base.position, home.position)) < FAR) order.base = base;
    if (order.rests) order.home = find_home_of_base(p->model, p->needle_length, order.base, home);
    bool lies = p->lies_down && !order.rests && is_in_tissue(p, needle);
    if (lies) order.kind = ORDER_LAY;
    p->needle = needle;
    p->driving = true;
    p->has_hole = false;
    p->lost = "";
    begin_handover(p, lies ? HANDING_LAID : order.rests ? HANDING_TAKEN : HANDING_NOTHING);
    return order;
}

/* Releases the needle at the browser's request. */
static publisher_order order_release(pilot *p) {
    bool holds = p->driving && p->handing == HANDING_NOTHING && subscriber_owner(p->feed, p->needle) == p->publisher.session;
    bool drops = p->lies_down && holds && !rests(p, p->needle) && is_in_tissue(p, p->needle);
    p->driving = p->has_hole = false;
    begin_handover(p, drops ? HANDING_DROPPED : HANDING_NOTHING);
    return (publisher_order){.kind = drops ? ORDER_LEAVE : ORDER_RELEASE};
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
        order.seeds = (int)fminf(16, fmaxf(1, c[0])); /* fmaxf and fminf turn NaN into one seed */
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
        if (action->needle >= (uint32_t)p->feed->needle_count || !may_remove(p, (int)action->needle)) return;
        order.kind = ORDER_REMOVE;
        order.needle = (int)action->needle;
        break;
    default: order = order_release(p); break;
    }
    publisher_tell(&p->publisher, &order);
}

void pilot_clear(pilot *p, int needle) { publisher_tell(&p->publisher, &(publisher_order){.kind = ORDER_CLEAR, .needle = needle}); }

void pilot_let_go(pilot *p, const char *why) {
    bool drove = p->driving;
    web_let_go(p->web);
    if (drove) p->lost = why;
}

/* ---- hand-over ---- */

static void tell(pilot *p, order_kind kind) { publisher_tell(&p->publisher, &(publisher_order){.kind = kind}); }

/* Handles the server's reply to the command to leave the driven needle. Marks the needle as resting without waiting for its next status; until then, it would
   seem possible to drive it without taking it. */
static void heed_left(pilot *p, bool done) {
    handover was = p->handing;
    trocar_status_t *status = p->feed->needles[p->needle].status;
    if (done && status) status->state = TROCAR_STATUS_T_RESTING;
    p->handing = HANDING_NOTHING;
    if (was == HANDING_LAID && done) {
        publisher_order order = order_take(p, p->needle);
        publisher_tell(&p->publisher, &order);
    } else if (was == HANDING_DROPPED) tell(p, ORDER_RELEASE);
    else if (was == HANDING_LAID || done) web_let_go(p->web);
    else tell(p, ORDER_GO_ON);
}

/* Handles the server's reply to a command that hands over the driven needle. */
static void heed_reply(pilot *p) {
    const trocar_command_reply_t *reply = p->feed->reply;
    bool is_new = p->feed->replies_heard != p->replies_heeded;
    p->replies_heeded = p->feed->replies_heard;
    if (!is_new || !reply || reply->needle != p->needle || p->handing == HANDING_NOTHING) return;
    bool done = reply->status == TROCAR_COMMAND_REPLY_T_DONE;
    if (reply->command == TROCAR_COMMAND_T_LEAVE && p->handing != HANDING_TAKEN) heed_left(p, done);
    else if (reply->command != TROCAR_COMMAND_T_TAKE || p->handing != HANDING_TAKEN) return;
    else if (done) tell(p, ORDER_GO_ON); /* the needle's next status will show it as held */
    else web_let_go(p->web);
}

/* Ends a hand-over once the needle has been taken, or once the server has taken too long to answer. */
static void watch_handover(pilot *p) {
    const trocar_status_t *status = status_of(p, p->needle);
    bool taken = p->handing == HANDING_TAKEN && status && status->state == TROCAR_STATUS_T_HELD;
    if (!taken && monotonic_ns() - p->handing_since <= HANDOVER_PATIENCE) return;
    handover was = p->handing;
    p->handing = HANDING_NOTHING;
    if (was == HANDING_DROPPED) tell(p, ORDER_RELEASE);
    if (was == HANDING_LAID) pilot_let_go(p, "the server did not answer");
}

void pilot_hear(pilot *p) {
    if (p->feed->servers != p->servers) pilot_let_go(p, "another server has started");
    p->servers = p->feed->servers;
    heed_reply(p);
    watch_handover(p);
}

const char *pilot_trouble(const pilot *p, int needle) {
    int64_t owner = subscriber_owner(p->feed, needle);
    const trocar_status_t *status = status_of(p, needle);
    bool held = status == NULL || status->state == TROCAR_STATUS_T_HELD || (needle == p->needle && p->handing != HANDING_NOTHING);
    if (!subscriber_alive(p->feed)) return "nothing was heard from the server for half a second";
    if (owner != 0 && owner != p->publisher.session) return "another client holds it";
    return held ? NULL : "it rests";
}

bool pilot_has(const pilot *p, int needle) { return pilot_trouble(p, needle) == NULL; }

bool pilot_may_take(const pilot *p, int needle) {
    if (!p->driving && p->handing == HANDING_DROPPED) return false; /* wait until the released needle rests */
    return pilot_has(p, needle) || (!p->driving && subscriber_alive(p->feed) && rests(p, needle));
}

/* ---- life ---- */

trocar_status pilot_open(pilot *p, lcm_t *lcm, trocar_error *why) {
    trocar_status status = publisher_create(&p->publisher, lcm, p->needle_length, why);
    if (status != TROCAR_OK) return status;
    p->feed->session = p->publisher.session;
    p->lies_down = find_template(p->model) >= 0;
    p->lost = "";
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
