#include "view/hand/pose_publisher.h"

#include <errno.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/realtime.h"
#include "common/session.h"
#include "common/timing.h"
#include "common/eventfd_signal.h"
#include "shared/poselog.h"
#include "trocar_command_t.h"
#include "trocar_probe_pose_t.h"
#include "view/hand/hole_approach.h"

enum { ORDERS = 256 };

static const int64_t PERIOD = 1000000;         /* ns */
static const int64_t PROBE_PERIOD = 10000000;  /* ns between probe poses; the server accepts 100 per second */
static const double LONGEST_STEP = 0.01;       /* s, longest time step of the motion */
static const double AT_HOME = 1e-6;            /* m, tolerance for rounding errors */
static const int64_t SILENCE = 250000000;      /* ns without an order before the needle stops */
static const int64_t SERVER_SILENCE = 100000000; /* ns without a wrench before the publisher stops sending poses */

/* Limits for the probe, relative to its pose when the motion began. */
static const rate_control_limits PROBE_LIMITS = {.max_speed = 0.02, .max_turn_rate = 0.3, .ramp = 0.15, .max_sideways = 0.05, .max_back = 0.1, .max_forward = 0.1,
                                                 .max_tilt = 0.35};

trocar_status publisher_create(pose_publisher *p, lcm_t *lcm, double needle_length, trocar_error *why) {
    *p = (pose_publisher){.lcm = lcm, .needle_length = needle_length, .limits = rate_control_defaults(needle_length), .probe_limits = PROBE_LIMITS, .seq = -1, .probe_seq = -1};
    p->session = session_new();
    p->wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (p->wake < 0) return fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    return spsc_ring_create(&p->orders, sizeof(publisher_order), ORDERS, why);
}

void publisher_free(pose_publisher *p) {
    spsc_ring_free(&p->orders);
    if (p->wake >= 0) close(p->wake);
}

void publisher_tell(pose_publisher *p, const publisher_order *order) {
    spsc_ring_push(&p->orders, order);
    eventfd_signal(p->wake);
}

void publisher_hear(pose_publisher *p, int64_t now) { atomic_store_explicit(&p->heard, now, memory_order_release); }

static void publish_command(pose_publisher *p, int32_t what, int needle, int seeds) {
    trocar_command_t m = {.utime = wall_us(), .session = p->session, .command = what, .needle = needle, .seq = ++p->command_seq, .seeds = seeds};
    trocar_command_t_publish(p->lcm, "TROCAR_COMMAND", &m);
}

/* Sends a command for the needle that this thread holds. */
static void publish_own(pose_publisher *p, int32_t what, int seeds) {
    if (p->holding) publish_command(p, what, p->needle, seeds);
}

static void release(pose_publisher *p) {
    publish_own(p, TROCAR_COMMAND_T_RELEASE, 0);
    p->holding = p->waiting = false;
}

static void begin_to_wait(pose_publisher *p, int64_t now) {
    p->waiting = true;
    p->waits_since = now;
}

static void approach(pose_publisher *p, bool goes) { atomic_store_explicit(&p->approaching, goes, memory_order_relaxed); }

static bool approaches(const pose_publisher *p) { return atomic_load_explicit(&p->approaching, memory_order_relaxed); }

static void take(pose_publisher *p, const publisher_order *order, int64_t now) {
    p->holding = true;
    p->has_hole = false;
    p->needle = order->needle;
    p->home = order->home;
    rate_control_begin(&p->drive, p->home, order->base);
    if (!order->rests) return;
    publish_own(p, TROCAR_COMMAND_T_TAKE, 0);
    begin_to_wait(p, now);
}

static bool is_still(const rate_control_command *c) {
    return c->right == 0 && c->up == 0 && c->forward == 0 && c->pitch == 0 && c->yaw == 0 && c->roll == 0;
}

/* True if the command contains no motion but forward motion, which does not interrupt the approach to a hole. */
static bool is_still_or_forward(rate_control_command c) {
    c.forward = fmin(c.forward, 0);
    return is_still(&c);
}

/* Starts to move the probe from the pose that the server reports. Later reports are ignored during the motion, because they lag behind it. */
static void steer_probe(pose_publisher *p, const publisher_order *order, int64_t now) {
    if (!p->probing && is_still(&order->command)) return;
    if (!p->probing) rate_control_begin(&p->probe, order->base, order->base);
    p->probing = true;
    p->probe_command = order->command;
    p->probe_ordered = now;
}

static void start_at_home(pose_publisher *p) {
    rate_control_begin(&p->drive, p->home, p->home);
    approach(p, false);
}

static bool obey(pose_publisher *p, const publisher_order *order, int64_t now) {
    if (order->kind == ORDER_PROBE) {
        steer_probe(p, order, now);
        return true;
    }
    p->ordered = now;
    switch (order->kind) {
    case ORDER_STEER:
        p->command = order->command;
        if (!is_still_or_forward(order->command)) approach(p, false);
        break;
    case ORDER_TAKE:
        if (p->holding) break;
        approach(p, false);
        p->command = (rate_control_command){0};
        take(p, order, now);
        break;
    case ORDER_RESET:
        publish_own(p, TROCAR_COMMAND_T_RESET, 0);
        start_at_home(p);
        break;
    case ORDER_HOLE:
        p->home = order->home;
        rate_control_begin(&p->drive, p->home, p->drive.base);
        p->has_hole = true;
        approach(p, true);
        break;
    case ORDER_DROP: publish_own(p, TROCAR_COMMAND_T_DROP_SEED, order->seeds); break;
    case ORDER_UNDO: publish_own(p, TROCAR_COMMAND_T_UNDO, 0); break;
    case ORDER_LEAVE:
        publish_own(p, TROCAR_COMMAND_T_LEAVE, 0);
        approach(p, false);
        begin_to_wait(p, now);
        break;
    case ORDER_LAY: publish_command(p, TROCAR_COMMAND_T_LEAVE, order->needle, 0); break;
    case ORDER_PROBE: break;
    case ORDER_GO_ON: p->waiting = false; break;
    case ORDER_REMOVE: publish_command(p, TROCAR_COMMAND_T_RESET, order->needle, 0); break;
    case ORDER_CLEAR:
        publish_command(p, TROCAR_COMMAND_T_CLEAR, order->needle, 0);
        if (p->holding && p->needle == order->needle) start_at_home(p);
        break;
    case ORDER_RELEASE:
    case ORDER_END:
        release(p);
        p->probe_command = (rate_control_command){0};
        break;
    }
    return order->kind != ORDER_END;
}

static void publish_pose(pose_publisher *p) {
    trocar_needle_pose_t m = message_of_pose(p->drive.base, wall_us(), p->session, ++p->seq);
    m.needle = p->needle;
    trocar_needle_pose_t_publish(p->lcm, POSE_CHANNEL, &m);
}

static void publish_probe(pose_publisher *p, int64_t now) {
    const pose *base = &p->probe.base;
    trocar_probe_pose_t m = {.utime = wall_us(), .session = p->session, .seq = ++p->probe_seq,
                             .position = {base->position.x, base->position.y, base->position.z},
                             .orientation = {base->orientation.w, base->orientation.x, base->orientation.y, base->orientation.z}};
    trocar_probe_pose_t_publish(p->lcm, PROBE_CHANNEL, &m);
    p->probe_sent = now;
}

static bool is_at_rest(const rate_control_state *d) { return v3_norm(d->velocity) == 0.0 && v3_norm(d->turn) == 0.0; }

/* Moves the probe. Sends its pose at regular intervals, and once more when it comes to rest. */
static void move_probe(pose_publisher *p, int64_t now, double dt) {
    if (!p->probing) return;
    if (now - p->probe_ordered > SILENCE) p->probe_command = (rate_control_command){0};
    rate_control_step(&p->probe, &p->probe_limits, p->probe_command, dt);
    p->probing = !(is_still(&p->probe_command) && is_at_rest(&p->probe));
    if (!p->probing || now - p->probe_sent >= PROBE_PERIOD) publish_probe(p, now);
}

/* Returns how far the base is ahead of its home, in m along the home pose's axis. */
static double ahead_of_home(const pose_publisher *p) { return v3_dot(v3_sub(p->drive.base.position, p->home.position), q_axis(p->home.orientation)); }

/* Returns the current limits. A needle sent to a hole must stop in front of the template until it is aligned with that hole; otherwise it would enter
   another. */
static rate_control_limits limits_now(const pose_publisher *p) {
    rate_control_limits limits = p->limits;
    if (p->has_hole && ahead_of_home(p) <= AT_HOME && !in_line_with_hole(p->home, p->drive.base, p->needle_length)) limits.max_forward = 0;
    return limits;
}

bool publisher_round(pose_publisher *p, int64_t now, double dt) {
    bool goes_on = true;
    int64_t heard = atomic_load_explicit(&p->heard, memory_order_acquire); /* read before the orders: see publisher_hear */
    for (publisher_order order; goes_on && spsc_ring_pop(&p->orders, &order);) goes_on = obey(p, &order, now);
    bool alive = now - heard <= SERVER_SILENCE;
    p->probing &= alive;
    if (goes_on) move_probe(p, now, dt);
    if (!goes_on || !p->holding) return goes_on;
    p->waiting &= now - p->waits_since < HANDOVER_PATIENCE;
    if (p->waiting || !alive) {
        rate_control_begin(&p->drive, p->home, p->drive.base); /* at rest */
        return true;
    }
    bool silent = now - p->ordered > SILENCE;
    if (silent) p->command = (rate_control_command){0};
    rate_control_limits limits = limits_now(p);
    if (approaches(p) && !silent) approach(p, !approach_step(&p->drive, &limits, dt));
    else rate_control_step(&p->drive, &limits, p->command, dt);
    publish_pose(p);
    return true;
}

/* Requests real-time scheduling, because browsers on the same machine may keep the CPUs busy. */
static void ask_realtime(void) {
    realtime_use_fifo(PRIORITY_DEVICE);
}

void *publisher_run(void *context) {
    pose_publisher *p = context;
    ask_realtime();
    int64_t before = monotonic_ns(), now = before;
    while (publisher_round(p, now, fmin(LONGEST_STEP, 1e-9 * (double)(now - before)))) {
        if (p->holding || p->probing) sleep_until((now / PERIOD + 1) * PERIOD); /* skips missed periods */
        else eventfd_wait(p->wake);
        before = now;
        now = monotonic_ns();
    }
    return NULL;
}
