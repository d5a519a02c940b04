/* A device on a real network for end-to-end tests. It sends a pose every millisecond and checks every answer. Include after cmocka.h, and run the test in a
   private network namespace. */
#ifndef TROCAR_TESTS_CLIENT_H
#define TROCAR_TESTS_CLIENT_H

#include <sched.h>
#include <stdlib.h>
#include <string.h>
#include <lcm/lcm.h>

#include "common/timing.h"
#include "scene/scene.h"
#include "trocar_command_t.h"
#include "trocar_loop_timing_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_status_t.h"

#define FLAG(name) TROCAR_NEEDLE_WRENCH_T_##name

enum { NEWS_REMEMBERED = 256 };

/* Statistics of the timing messages since the last call of watch(). */
typedef struct {
    int count;
    double lateness_p99[NEWS_REMEMBERED], compute_p99[NEWS_REMEMBERED]; /* s */
    int64_t misses, ticks;           /* as of the first message since then */
} timing_record;

typedef struct {
    device_limits limits;             /* of the scene */
    lcm_t *lcm;
    trocar_needle_wrench_t_subscription_t *wrench_subscription;
    trocar_status_t_subscription_t *status_subscription;
    trocar_loop_timing_t_subscription_t *timing_subscription;
    int64_t session, seq;
    pose base;
    bool sends;                      /* whether a pose is sent every millisecond */
    trocar_needle_wrench_t wrench;   /* newest */
    trocar_status_t *status;
    trocar_loop_timing_t timing;
    int64_t wrenches;
    timing_record record;            /* since watch() */
    double oldest_snapshot;          /* s, largest age of a snapshot since watch() */
    int seen, always;                /* since watch(): flags set in any wrench (seen) and in all of them (always) */
    int told;                        /* flags set in any status since watch() */
    int64_t sent;                    /* ns, time of the last pose, 0 before the first */
    double silence;                  /* s, longest time between two poses since watch() */
    double least, most;              /* N, smallest and largest force since watch() */
} client;

static inline double norm3(const double a[3]) { return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }
static inline double force_of(const client *c) { return norm3(c->wrench.force); }

/* Checks what must hold during every fault: wrenches are finite, and their magnitude and change per tick stay within the device's limits. */
static inline void check_wrench(const client *c, const trocar_needle_wrench_t *w) {
    double step[3], turn[3];
    for (int a = 0; a < 3; a++) {
        assert_true(isfinite(w->force[a]) && isfinite(w->torque[a]));
        step[a] = w->force[a] - c->wrench.force[a];
        turn[a] = w->torque[a] - c->wrench.torque[a];
    }
    assert_true(norm3(w->force) <= c->limits.max_force + 1e-9 && norm3(w->torque) <= c->limits.max_torque + 1e-9);
    if (c->wrenches == 0 || w->tick != c->wrench.tick + 1) return;
    assert_true(norm3(step) <= 1e-3 * c->limits.max_force_rate + 1e-9);
    assert_true(norm3(turn) <= 1e-3 * c->limits.max_torque_rate + 1e-9);
}

static inline void on_wrench(const lcm_recv_buf_t *b, const char *channel, const trocar_needle_wrench_t *w, void *context) {
    (void)b, (void)channel;
    client *c = context;
    check_wrench(c, w);
    c->wrench = *w;
    c->wrenches++;
    c->seen |= w->flags;
    c->always &= w->flags;
    c->least = fmin(c->least, force_of(c));
    c->most = fmax(c->most, force_of(c));
}

static inline void on_status(const lcm_recv_buf_t *b, const char *channel, const trocar_status_t *s, void *context) {
    (void)b, (void)channel;
    client *c = context;
    if (c->status != NULL) trocar_status_t_destroy(c->status);
    c->status = trocar_status_t_copy(s);
    c->told |= s->flags;
}

static inline void on_timing(const lcm_recv_buf_t *b, const char *channel, const trocar_loop_timing_t *t, void *context) {
    (void)b, (void)channel;
    client *c = context;
    timing_record *r = &c->record;
    if (r->count == 0) r->misses = t->misses, r->ticks = t->ticks;
    if (r->count < NEWS_REMEMBERED) {
        r->lateness_p99[r->count] = t->lateness_p99;
        r->compute_p99[r->count++] = t->compute_p99;
    }
    c->timing = *t;
    c->oldest_snapshot = fmax(c->oldest_snapshot, t->snapshot_age);
}

/* Restarts the statistics of wrenches, status messages and timing. */
static inline void watch(client *c) {
    c->seen = c->told = c->record.count = 0;
    c->always = -1;
    c->least = INFINITY;
    c->most = c->oldest_snapshot = c->silence = 0.0;
}

static inline trocar_needle_pose_t next_pose(client *c) {
    const pose *p = &c->base;
    return (trocar_needle_pose_t){
        .utime = wall_us(), .session = c->session, .seq = ++c->seq, .wrench_tick = c->wrench.tick,
        .position = {p->position.x, p->position.y, p->position.z},
        .orientation = {p->orientation.w, p->orientation.x, p->orientation.y, p->orientation.z}};
}

static inline void publish_pose(client *c, const trocar_needle_pose_t *m) { trocar_needle_pose_t_publish(c->lcm, "TROCAR_POSE", m); }

/* Runs the client for one millisecond. */
static inline void step(client *c) {
    static int64_t due;
    int64_t now = monotonic_ns();
    due = due + 1000000 > now ? due + 1000000 : now;
    sleep_until(due);
    if (c->sends) {
        trocar_needle_pose_t m = next_pose(c);
        now = monotonic_ns();
        if (c->sent > 0) c->silence = fmax(c->silence, 1e-9 * (double)(now - c->sent));
        c->sent = now;
        publish_pose(c, &m);
    }
    while (lcm_handle_timeout(c->lcm, 0) > 0) continue;
}

static inline void pass(client *c, double seconds) {
    for (int64_t end = monotonic_ns() + (int64_t)(1e9 * seconds); monotonic_ns() < end;) step(c);
}

/* Steps until the condition holds. Fails after five seconds. */
#define PASS_UNTIL(c, condition)                                                                        \
    do {                                                                                                \
        for (int64_t end_ = monotonic_ns() + 5000000000; !(condition); step(c))                         \
            if (monotonic_ns() > end_) fail_msg("not in 5 s: %s (flags %d)", #condition, (c)->wrench.flags); \
    } while (0)

static inline void command(client *c, int64_t session, int what) {
    trocar_command_t m = {.utime = wall_us(), .session = session, .command = what};
    trocar_command_t_publish(c->lcm, "TROCAR_COMMAND", &m);
}

/* Returns whether the test may check timing, which it may not under sanitizers. */
static inline bool in_time(void) {
    const char *wanted = getenv("TROCAR_CHECK_TIMING");
    return wanted == NULL || strcmp(wanted, "no") != 0;
}

/* Waits for the next status and timing messages, which cover everything up to now. */
static inline void hear_news(client *c) {
    pass(c, 0.25);
    assert_non_null(c->status);
}

static inline int faulty_flags(const client *c) { return c->wrench.flags & ~FLAG(NOT_REALTIME); }

/* Checks the state before each fault and after recovering from it: the needle is at rest, 20 mm deep, and its full force acts. */
static inline void expect_health(client *c) {
    PASS_UNTIL(c, faulty_flags(c) == 0 && c->wrench.pose_seq > 0 && force_of(c) > 0.2);
    int64_t ticks = c->wrench.tick, start = monotonic_ns();
    pass(c, 0.2);
    double rate = 1e9 * (double)(c->wrench.tick - ticks) / (double)(monotonic_ns() - start);
    if (in_time()) assert_true(rate > 0.7 * c->timing.rate_hz);
    PASS_UNTIL(c, faulty_flags(c) == 0 && (c->status->flags & ~FLAG(NOT_REALTIME)) == 0);
    assert_true(fabs(norm3(c->wrench.raw_force) - force_of(c)) < 1e-9);
}

static inline void client_insert(client *c) {
    c->sends = true;
    c->base = (pose){v3(0.005, 0.003, -0.201), {1, 0, 0, 0}};
    PASS_UNTIL(c, c->wrenches > 0);
    command(c, c->session, TROCAR_COMMAND_T_RESET);
    pass(c, 0.05);
    for (int i = 0; i < 210; i++) {
        c->base.position.z += 0.1e-3;
        step(c);
    }
    expect_health(c);
    watch(c);
}

/* Opens the client. Its LCM reader thread inherits the calling thread's priority. */
static inline bool client_open(client *c, const char *scene_path) {
    scene s;
    trocar_error why;
    if (scene_load(scene_path, &s, &why) != TROCAR_OK) return false;
    *c = (client){.session = 77, .limits = s.device};
    sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = 70}); /* it does not matter if this is not permitted */
    c->lcm = lcm_create(NULL);
    if (c->lcm == NULL) return false;
    c->wrench_subscription = trocar_needle_wrench_t_subscribe(c->lcm, "TROCAR_WRENCH", on_wrench, c);
    c->status_subscription = trocar_status_t_subscribe(c->lcm, "TROCAR_STATUS", on_status, c);
    c->timing_subscription = trocar_loop_timing_t_subscribe(c->lcm, "TROCAR_TIMING", on_timing, c);
    return true;
}

static inline void client_close(client *c) {
    trocar_needle_wrench_t_unsubscribe(c->lcm, c->wrench_subscription);
    trocar_status_t_unsubscribe(c->lcm, c->status_subscription);
    trocar_loop_timing_t_unsubscribe(c->lcm, c->timing_subscription);
    lcm_destroy(c->lcm);
    if (c->status != NULL) trocar_status_t_destroy(c->status);
}

#endif
