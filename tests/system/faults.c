/* Injects every fault a server must survive into a running one. The server is a child process with all its threads on a real network. A client sends it
   poses and checks every wrench, status and timing message before, during and after the fault. Must run in a private network namespace (see CMakeLists.txt).

   Faults that no message can cause are injected by functions that the linker wraps around the server's own (--wrap). */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "api/api.h" /* access to the state, to put a NaN into it, and to the worker's answers, to delay them inside the library */
#include "coupling/virtual_coupling.h"
#include "server.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "client.h"
#include "trocar_command_reply_t.h"
#include "trocar_seeds_t.h"

#define SCENE MESHES "/figure8.yaml"

/* ---- faults inside the server ----------------------------------------------------------------------------------------- */

/* Shared by client and server. */
typedef struct {
    atomic_bool ready;
    atomic_llong wall_offset;        /* us, offset of the wall clock */
    atomic_int worker_nap;           /* ms, added to each request */
    atomic_int tick_nap;             /* us, added to each tick */
    atomic_int pass_nap;             /* us, added to each Newton iteration */
    atomic_int stall;                /* us, added to the next tick only */
    _Atomic double spike;            /* N along x, added to the model's force */
    atomic_bool poison;              /* if set, the next tick starts with a NaN in the state */
    _Atomic double stiffness;        /* N/m, of the virtual coupling; INFINITY for none */
} injected;

static injected *fault;

int __real_clock_gettime(clockid_t clock, struct timespec *t);
int __wrap_clock_gettime(clockid_t clock, struct timespec *t);
int __wrap_clock_gettime(clockid_t clock, struct timespec *t) {
    int result = __real_clock_gettime(clock, t);
    if (clock == CLOCK_REALTIME && fault != NULL) t->tv_sec += atomic_load(&fault->wall_offset) / 1000000;
    return result;
}

trocar_status __real_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why) {
    int64_t woken = monotonic_ns() + atomic_load(&fault->worker_nap) * INT64_C(1000000);
    while (monotonic_ns() < woken && atomic_load(&fault->worker_nap) > 0) sleep_until(monotonic_ns() + 1000000);
    return __real_remesher_serve(r, request, snapshot, why);
}

trocar_status __real_trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output);
trocar_status __wrap_trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output);
trocar_status __wrap_trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output) {
    if (atomic_exchange(&fault->poison, false)) sim->needles[0].state.base_shift.x = NAN;
    trocar_status status = __real_trocar_sim_tick(sim, needle, base, dt, output);
    output->force[0] += atomic_load(&fault->spike);
    int nap = atomic_load(&fault->tick_nap) + output->passes * atomic_load(&fault->pass_nap) + atomic_exchange(&fault->stall, 0);
    if (nap > 0) sleep_until(monotonic_ns() + nap * INT64_C(1000));
    return status;
}

pose __real_coupling_hold(virtual_coupling *p, const trocar_device_limits *limits, pose hand, double dt, double *compliance);
pose __wrap_coupling_hold(virtual_coupling *p, const trocar_device_limits *limits, pose hand, double dt, double *compliance);
pose __wrap_coupling_hold(virtual_coupling *p, const trocar_device_limits *limits, pose hand, double dt, double *compliance) {
    trocar_device_limits own = *limits;
    own.max_stiffness = atomic_load(&fault->stiffness);
    return __real_coupling_hold(p, &own, hand, dt, compliance);
}

/* ---- the server --------------------------------------------------------------------------------------------------------- */

static int stop_wake;

static void on_stop(int signal) {
    (void)signal;
    eventfd_write(stop_wake, 1);
}

static void say_ready(void) { atomic_store(&fault->ready, true); }

static int run_server(void) {
    server_options options = {.scene_path = SCENE, .allow_non_rt = true};
    trocar_error why;
    server *s;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    stop_wake = eventfd(0, EFD_NONBLOCK);
    signal(SIGTERM, on_stop);
    trocar_status status = server_create(&options, &s, &why);
    if (status == TROCAR_OK) {
        status = server_run(s, stop_wake, say_ready, &why);
        server_free(s);
    }
    if (status != TROCAR_OK) fprintf(stderr, "server: %s\n", why.text);
    return status == TROCAR_OK ? 0 : 1;
}

static pid_t server_process;

static int compare(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(const double *values, int count) {
    double sorted[NEWS_REMEMBERED];
    memcpy(sorted, values, (size_t)count * sizeof *values);
    qsort(sorted, (size_t)count, sizeof *sorted, compare);
    return sorted[count / 2];
}

static timing_record calm; /* the loop's timing before the fault */

static int insert(void **state) {
    client *c = *state;
    client_insert(c);
    hear_news(c);
    hear_news(c);
    calm = c->record;
    watch(c);
    return 0;
}

/* Removes all faults. There is no virtual coupling unless a case asks for one, because through a coupling the force also depends on the delay, which varies
   on a busy machine. */
static int mend(void **state) {
    (void)state;
    atomic_store(&fault->stiffness, INFINITY);
    atomic_store(&fault->worker_nap, 0);
    atomic_store(&fault->tick_nap, 0);
    atomic_store(&fault->pass_nap, 0);
    atomic_store(&fault->spike, 0.0);
    return 0;
}

/* Also checks that the fault has not degraded the loop's timing: the median of the reported percentiles is about the same as before. */
static int mend_in_time(void **state) {
    client *c = *state;
    mend(state);
    if (!in_time()) return 0;
    hear_news(c);
    const timing_record *r = &c->record;
    double lateness = median(r->lateness_p99, r->count), lateness_before = median(calm.lateness_p99, calm.count);
    double compute = median(r->compute_p99, r->count), compute_before = median(calm.compute_p99, calm.count);
    int64_t misses = c->timing.misses - r->misses, ticks = c->timing.ticks - r->ticks;
    if (lateness < 3 * lateness_before + 3e-4 && compute < 3 * compute_before + 1e-4 && 20 * misses <= ticks) return 0;
    print_error("lateness p99 %g us, before %g us; compute p99 %g us, before %g us; %lld misses in %lld ticks\n", 1e6 * lateness,
                1e6 * lateness_before, 1e6 * compute, 1e6 * compute_before, (long long)misses, (long long)ticks);
    return -1;
}

/* Checks that no wrench or status had any flags except these and NOT_REALTIME. If the machine stopped this client for more than half the hold time, the
   server may have seen stale poses: stalls come in groups, and another may have delayed the poses on their way. */
static void expect_only(const client *c, int flags) {
    if (c->silence > 0.5 * c->limits.hold_time) flags |= FLAG(STALE) | FLAG(RAMPING);
    assert_int_equal((c->seen | c->told) & ~flags & ~FLAG(NOT_REALTIME), 0);
}

/* ---- the table ---------------------------------------------------------------------------------------------------------- */

static void silence_holds_ramps_and_returns_by_a_ramp(void **state) {
    client *c = *state;
    double force = force_of(c);
    c->sends = false;
    PASS_UNTIL(c, c->wrench.flags & FLAG(STALE));
    int64_t tick = c->wrench.tick;
    assert_true(fabs(c->most - force) < 0.02 * force && force_of(c) > 0.5 * force); /* so far, the force has been held */
    PASS_UNTIL(c, force_of(c) == 0.0);
    assert_in_range(c->wrench.tick - tick, 1, 1e3 * c->limits.ramp_time + 5);
    assert_true(norm3(c->wrench.raw_force) > 0.5 * force); /* the model's own force is still reported */
    hear_news(c);
    assert_true(force_of(c) == 0.0 && c->wrench.flags & c->status->flags & FLAG(STALE));
    expect_only(c, FLAG(STALE) | FLAG(RAMPING));

    c->sends = true;
    PASS_UNTIL(c, force_of(c) > 0.0);
    assert_true(force_of(c) < 0.2 * force && c->wrench.flags & FLAG(RAMPING));
    expect_health(c);
    assert_true(fabs(force_of(c) - force) < 0.1 * force);
}

static void spoil(trocar_needle_pose_t *m, int kind) {
    if (kind == 0) m->position[1] = NAN;
    else if (kind == 1) m->orientation[2] = INFINITY;
    else if (kind == 2) m->orientation[0] = 0.5;
    else if (kind == 3) m->position[0] += 1.0; /* jumps by one metre within a millisecond */
    else m->orientation[0] = cos(0.5), m->orientation[1] = sin(0.5); /* one radian */
}

static void send_spoiled(client *c, int kind) {
    trocar_needle_pose_t m = next_pose(c);
    spoil(&m, kind);
    publish_pose(c, &m);
}

static void impossible_poses_are_refused_and_counted(void **state) {
    client *c = *state;
    double force = force_of(c);
    hear_news(c);
    trocar_status_t before = *c->status;
    watch(c);
    for (int i = 0; i < 500; i++) {
        send_spoiled(c, i % 5);
        step(c);
    }
    assert_true(c->least > 0.9 * force && c->most < 1.1 * force);
    hear_news(c);
    expect_only(c, FLAG(STALE) | FLAG(RAMPING));
    assert_int_equal(c->status->poses_not_finite - before.poses_not_finite, 200);
    assert_int_equal(c->status->poses_not_unit - before.poses_not_unit, 100);
    assert_int_equal(c->status->poses_jumped - before.poses_jumped, 200);
    assert_non_null(strstr(c->status->message, "faster than the scene's limits"));

    c->sends = false; /* from here on, only invalid poses are sent, which do not count as poses */
    for (int i = 0; i < 1000 && force_of(c) > 0.0; i++) {
        send_spoiled(c, i % 3);
        step(c);
    }
    assert_true(force_of(c) == 0.0 && c->wrench.flags & FLAG(STALE));
    c->sends = true;
    expect_health(c);
    expect_only(c, FLAG(STALE) | FLAG(RAMPING));
}

static void a_spike_is_clamped_and_flagged(void **state) {
    client *c = *state;
    int64_t tick = c->wrench.tick;
    atomic_store(&fault->spike, 500.0);
    PASS_UNTIL(c, force_of(c) > 0.99 * c->limits.max_force);
    assert_true(c->wrench.tick - tick >= 8); /* reaching 20 N takes 10 ticks at 2 N per tick */
    assert_true(c->wrench.flags & FLAG(SATURATED));
    assert_true(c->wrench.raw_force[0] > 400.0);
    assert_true(c->wrench.force[0] > 0.99 * c->limits.max_force);
    hear_news(c);
    assert_true(c->status->saturated_ticks > 100 && c->status->flags & FLAG(SATURATED));
    expect_only(c, FLAG(SATURATED));
    atomic_store(&fault->spike, 0.0);
    expect_health(c);
}

/* The insertion has restarted without force. The force returns when the needle moves on. */
static void push_on(client *c) {
    for (int i = 0; i < 50; i++) {
        c->base.position.z += 0.1e-3;
        step(c);
    }
}

static void a_wrench_that_is_no_number_stays_inside(void **state) {
    client *c = *state;
    atomic_store(&fault->spike, (double)NAN);
    PASS_UNTIL(c, force_of(c) == 0.0);
    assert_true(c->wrench.flags & FLAG(UNSTABLE) && c->wrench.raw_force[0] == 0.0);
    hear_news(c);
    assert_true(force_of(c) == 0.0 && c->status->flags & FLAG(UNSTABLE));
    expect_only(c, FLAG(UNSTABLE) | FLAG(RAMPING) | FLAG(SATURATED));
    atomic_store(&fault->spike, 0.0);
    push_on(c);
    expect_health(c);
}

/* A NaN in the state would stay there. Run with a rigidly held base, and with a virtual coupling, whose extension then becomes NaN as well. */
static void a_number_that_is_none_in_the_model_begins_anew(void **state) {
    client *c = *state;
    for (int coupled = 0; coupled < 2; coupled++) {
        atomic_store(&fault->stiffness, coupled ? 500.0 : INFINITY);
        hear_news(c);
        assert_int_equal(c->status->coupling_stiffness > 0.0, coupled);
        atomic_store(&fault->poison, true);
        PASS_UNTIL(c, c->seen & FLAG(UNSTABLE));
        PASS_UNTIL(c, faulty_flags(c) == 0);
        expect_only(c, FLAG(UNSTABLE) | FLAG(RAMPING) | FLAG(SATURATED) | FLAG(ACTIVE) | FLAG(LATE_WORKER)); /* late: earlier answers are not used */
        push_on(c);
        expect_health(c);
        watch(c);
    }
}

static uint32_t draw(void) {
    static uint32_t state = 2463534242u; /* xorshift: Marsaglia 2003 */
    state ^= state << 13;
    state ^= state >> 17;
    return state ^= state << 5;
}

static void publish_noise(client *c, const char *channel) {
    uint8_t bytes[2048];
    unsigned size = draw() % sizeof bytes;
    for (unsigned i = 0; i < size; i++) bytes[i] = (uint8_t)draw();
    lcm_publish(c->lcm, channel, bytes, size);
}

/* Publishes a malformed message. The kinds are: a valid message of another type, one of the right length from another version of the type, one that is too
   short, one that is too long, and random bytes. */
static void publish_malformed(client *c, const char *channel, int kind) {
    trocar_needle_pose_t m = {.session = c->session, .seq = c->seq + 1, .orientation = {1}};
    uint8_t bytes[256] = {0};
    int size = trocar_needle_pose_t_encode(bytes, 0, sizeof bytes, &m);
    bool for_poses = strcmp(channel, "TROCAR_POSE") == 0;
    if (kind == 0 && for_poses) trocar_command_t_publish(c->lcm, channel, &(trocar_command_t){.session = c->session, .command = 1});
    else if (kind == 0) trocar_needle_pose_t_publish(c->lcm, channel, &m);
    else if (kind == 4) publish_noise(c, channel);
    else {
        if (!for_poses) size = trocar_command_t_encode(bytes, 0, sizeof bytes, &(trocar_command_t){.session = c->session, .command = 1});
        if (kind == 1) bytes[7] ^= 1; /* corrupts the type's hash */
        lcm_publish(c->lcm, channel, bytes, (unsigned)(size - (kind == 2) + (kind == 3)));
    }
}

/* Sends datagrams to LCM's port that no LCM library would send: either without a magic number, or with that of a message or a fragment followed by random
   bytes. */
static void send_datagrams(int count) {
    int s = socket(AF_INET, SOCK_DGRAM, 0);
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(7667), .sin_addr.s_addr = inet_addr("239.255.76.67")};
    for (int i = 0; i < count; i++) {
        uint8_t bytes[512];
        size_t size = draw() % sizeof bytes;
        for (size_t k = 0; k < size; k++) bytes[k] = (uint8_t)draw();
        if (i % 3 > 0) memcpy(bytes, i % 3 == 1 ? "LC02" : "LC03", 4);
        else bytes[0] = 0;
        sendto(s, bytes, size, 0, (struct sockaddr *)&to, sizeof to);
    }
    close(s);
}

static void malformed_messages_are_dropped_and_counted(void **state) {
    client *c = *state;
    double force = force_of(c);
    hear_news(c);
    trocar_status_t before = *c->status;
    watch(c);
    for (int i = 0; i < 300; i++) {
        publish_malformed(c, "TROCAR_POSE", i % 5);
        publish_malformed(c, "TROCAR_COMMAND", i % 5);
        send_datagrams(3);
        step(c);
    }
    assert_true(c->least > 0.9 * force && c->most < 1.1 * force);
    hear_news(c);
    assert_int_equal(c->status->poses_malformed - before.poses_malformed, 300);
    assert_int_equal(c->status->commands_refused - before.commands_refused, 300);
    expect_health(c);
    expect_only(c, 0);
}

static void a_flood_does_not_touch_the_loop(void **state) {
    client *c = *state;
    double force = force_of(c);
    hear_news(c);
    trocar_status_t before = *c->status;
    trocar_loop_timing_t calm = c->timing;
    watch(c);
    int64_t sent = 0;
    for (int64_t end = monotonic_ns() + 1000000000; monotonic_ns() < end; step(c)) {
        for (int i = 0; i < 20; i++, sent++) publish_noise(c, "TROCAR_POSE");
    }
    trocar_loop_timing_t busy = c->timing;
    assert_true(busy.ticks > calm.ticks);
    if (in_time()) {
        assert_true((double)(busy.ticks - calm.ticks) > 0.7 * 1e-6 * (double)(busy.utime - calm.utime) * busy.rate_hz);
        assert_true(busy.compute_p50 < 3 * calm.compute_p50 + 100e-6);
    }
    assert_true(c->most < 1.1 * force); /* a busy machine may lose poses, but the force must not grow */
    hear_news(c);
    int64_t counted = c->status->poses_malformed - before.poses_malformed;
    assert_true(counted > 100 && counted <= sent);
    expect_health(c);
    expect_only(c, FLAG(STALE) | FLAG(RAMPING));
}

static void a_second_client_is_refused_and_told(void **state) {
    client *c = *state;
    double force = force_of(c);
    hear_news(c);
    trocar_status_t before = *c->status;
    watch(c);
    for (int i = 0; i < 200; i++) {
        trocar_needle_pose_t m = next_pose(c);
        c->seq--;
        m.session = c->session + 1;
        m.position[2] += 0.05;
        publish_pose(c, &m);
        step(c);
    }
    command(c, c->session + 1, TROCAR_COMMAND_T_RESET);
    command(c, c->session + 1, TROCAR_COMMAND_T_RELEASE);
    assert_true(c->least > 0.9 * force && c->most < 1.1 * force);
    hear_news(c);
    assert_int_equal(c->status->owner, c->session);
    assert_int_equal(c->wrench.session, c->session);
    assert_int_equal(c->status->poses_refused - before.poses_refused, 200);
    assert_int_equal(c->status->commands_refused - before.commands_refused, 2);
    assert_non_null(strstr(c->status->message, "another session holds the needle"));
    expect_health(c);
    expect_only(c, 0);
    assert_true(fabs(force_of(c) - force) < 0.1 * force);
}

/* The server's messages about seeds. */
typedef struct {
    int replies, count, pending;
    trocar_command_reply_t reply;    /* the newest reply */
    char message[256];
    float rest[3];                   /* m, the first seed with the tissue at rest */
} seed_news;

static void on_reply(const lcm_recv_buf_t *b, const char *channel, const trocar_command_reply_t *m, void *context) {
    (void)b, (void)channel;
    seed_news *news = context;
    news->replies++;
    news->reply = *m;
    snprintf(news->message, sizeof news->message, "%s", m->message);
}

static void on_seeds(const lcm_recv_buf_t *b, const char *channel, const trocar_seeds_t *m, void *context) {
    (void)b, (void)channel;
    seed_news *news = context;
    news->count = m->seed_count;
    news->pending = m->pending[0];
    if (m->seed_count > 0) memcpy(news->rest, m->rest_position[0], sizeof news->rest);
}

/* Sends a seed command and waits for the reply. The command must be refused with the message `words`, or done if that is NULL. */
static void tell(client *c, seed_news *news, trocar_command_t m, const char *words) {
    static int64_t seq = 100;
    int before = news->replies;
    m.utime = wall_us();
    m.seq = ++seq;
    trocar_command_t_publish(c->lcm, "TROCAR_COMMAND", &m);
    PASS_UNTIL(c, news->replies > before);
    assert_true(news->replies == before + 1 && news->reply.seq == seq && news->reply.session == m.session && news->reply.command == m.command);
    if (news->reply.status != (words != NULL ? TROCAR_COMMAND_REPLY_T_REFUSED : TROCAR_COMMAND_REPLY_T_DONE)) fail_msg("status %d: %s", news->reply.status, news->message);
    if (words != NULL && strstr(news->message, words) == NULL) fail_msg("\"%s\" does not say \"%s\"", news->message, words);
}

static void bad_commands_for_seeds_change_nothing(void **state) {
    client *c = *state;
    seed_news news = {.replies = 0};
    trocar_command_reply_t_subscription_t *replies = trocar_command_reply_t_subscribe(c->lcm, "TROCAR_REPLY", on_reply, &news);
    trocar_seeds_t_subscription_t *seeds = trocar_seeds_t_subscribe(c->lcm, "TROCAR_SEEDS", on_seeds, &news);
    trocar_command_t drop = {.session = c->session, .command = TROCAR_COMMAND_T_DROP_SEED, .seeds = 1}, undo = {.session = c->session, .command = TROCAR_COMMAND_T_UNDO};
    trocar_command_t wrong = drop;
    tell(c, &news, undo, "needle 0 has no dropped seed");
    wrong.session++;
    tell(c, &news, wrong, "another session holds the needle");
    wrong = drop, wrong.needle = 5;
    tell(c, &news, wrong, "refused for needle 5");
    wrong = drop, wrong.seeds = 17;
    tell(c, &news, wrong, "17 seeds: drop 1 to 16 at a time");
    wrong = drop, wrong.seeds = 2, wrong.spacing = NAN;
    tell(c, &news, wrong, "overlap");
    wrong = drop, wrong.seeds = 16;
    tell(c, &news, wrong, "push it farther in");
    double z = c->base.position.z;
    tell(c, &news, drop, NULL);
    tell(c, &news, drop, "still holds 1 of the seeds");
    PASS_UNTIL(c, news.pending == 1);
    for (int64_t end = monotonic_ns() + 5000000000; news.count == 0; step(c)) {
        assert_true(monotonic_ns() < end);
        c->base.position.z -= 0.05e-3;
    }
    assert_true(fabsf(news.rest[0] - (float)c->base.position.x) < 1e-3f && news.rest[2] > 2e-3f && news.rest[2] < (float)z + 0.2f);
    tell(c, &news, undo, NULL);
    PASS_UNTIL(c, news.count == 0 && news.pending == 0);
    for (; c->base.position.z < z; step(c)) c->base.position.z += 0.05e-3;
    trocar_command_reply_t_unsubscribe(c->lcm, replies);
    trocar_seeds_t_unsubscribe(c->lcm, seeds);
    expect_health(c);
}

static void old_and_repeated_poses_are_refused(void **state) {
    client *c = *state;
    hear_news(c);
    int64_t before = c->status->poses_old;
    for (int i = 0; i < 200; i++) {
        step(c);
        trocar_needle_pose_t m = next_pose(c);
        m.seq = --c->seq - i % 3;
        m.position[0] += 1e-4;
        publish_pose(c, &m);
    }
    hear_news(c);
    assert_int_equal(c->status->poses_old - before, 200);
    assert_non_null(strstr(c->status->message, "out of order"));
    expect_health(c);
    expect_only(c, FLAG(STALE) | FLAG(RAMPING));
}

/* Sends one pose with the owner's session and an arbitrary sequence number, then another. */
static void a_forged_number_does_not_lock_the_owner_out(void **state) {
    static const int64_t forged[] = {INT64_MAX, 0, INT64_MIN};
    client *c = *state;
    double force = force_of(c);
    for (size_t k = 0; k <= sizeof forged / sizeof *forged; k++) {
        trocar_needle_pose_t m = next_pose(c);
        c->seq--;
        m.seq = k < 3 ? forged[k] : m.seq + 1000;
        publish_pose(c, &m);
        pass(c, 0.1);
        hear_news(c);
        assert_int_equal(c->status->owner, c->session);
        assert_true(c->wrench.pose_seq > c->seq - 50 && c->wrench.pose_seq <= c->seq); /* the wrench answers a pose from the owner, sent after the forged one */
    }
    assert_true(c->least > 0.9 * force && c->most < 1.1 * force);
    expect_health(c);
    expect_only(c, 0);
}

/* The reset removes the needle at once, although its owner sends no more poses. The hand feels the force ramp down. */
static void a_reset_needs_no_pose_to_take_effect(void **state) {
    client *c = *state;
    assert_true(norm3(c->wrench.raw_force) > 0.2 && c->wrench.depth > 0.01);
    c->sends = false;
    command(c, c->session, TROCAR_COMMAND_T_RESET);
    PASS_UNTIL(c, c->wrench.depth == 0.0);
    double largest = 0.0, last = force_of(c);
    assert_true(norm3(c->wrench.raw_force) == 0.0 && c->wrench.contacts == 0);
    for (int64_t tick = c->wrench.tick; last > 0.0; last = force_of(c)) {
        PASS_UNTIL(c, c->wrench.tick > tick);
        largest = fmax(largest, (last - force_of(c)) / (double)(c->wrench.tick - tick));
        tick = c->wrench.tick;
    }
    assert_true(largest < 0.1); /* N; the force rate limit alone would allow 2 N per tick */
    hear_news(c);
    assert_true(c->wrench.depth == 0.0 && c->status->owner == c->session);
    client_insert(c);
}

static void wall_clocks_may_jump(void **state) {
    client *c = *state;
    double force = force_of(c);
    static const long long jumps[] = {3600, -86400, 0}; /* s */
    for (size_t i = 0; i < sizeof jumps / sizeof *jumps; i++) {
        int64_t utime = c->wrench.utime, now = monotonic_ns();
        long long before = atomic_load(&fault->wall_offset);
        atomic_store(&fault->wall_offset, 1000000 * jumps[i]);
        pass(c, 0.2);
        double moved = 1e-6 * (double)(c->wrench.utime - utime) - 1e-9 * (double)(monotonic_ns() - now);
        assert_true(fabs(moved - (double)jumps[i] + 1e-6 * (double)before) < 1.0); /* the clock really has jumped */
    }
    hear_news(c);
    assert_int_equal(c->seen & (FLAG(SATURATED) | FLAG(UNSTABLE) | FLAG(OVERRUN)), 0);
    assert_true(c->most < 1.1 * force);
    assert_true(c->status->pose_age < 1.0 && c->timing.round_trip_max < 1.0);
    expect_health(c);
}

static void a_late_worker_does_not_stop_the_loop(void **state) {
    client *c = *state;
    hear_news(c);
    int64_t misses = c->timing.misses, ticks = c->timing.ticks;
    atomic_store(&fault->worker_nap, 400);
    for (int i = 0; i < 700; i++) {
        c->base.position.z += 0.05e-3;
        step(c);
    }
    assert_true(c->seen & c->told & FLAG(LATE_WORKER));
    assert_true(c->oldest_snapshot > 0.3);
    assert_int_equal(c->seen & FLAG(OVERRUN), 0);
    assert_true(c->timing.ticks > ticks);
    if (in_time()) assert_true(c->timing.misses - misses < 100);
    atomic_store(&fault->worker_nap, 0);
    expect_health(c);
}

/* The worker answers nothing while the needle is inserted, starting in front of the skin. Then it answers everything at once. */
static void without_a_worker_the_tip_has_force(void **state) {
    client *c = *state;
    atomic_store(&fault->worker_nap, 100000);
    c->base = (pose){v3(-0.011, 0.007, -0.201), {1, 0, 0, 0}};
    command(c, c->session, TROCAR_COMMAND_T_RESET);
    pass(c, 0.05);
    for (int i = 0; i < 1500; i++) {
        c->base.position.z += 0.02e-3;
        step(c);
        if (i == 300) watch(c); /* the tip is 5 mm below the skin */
    }
    assert_true(c->least > 0.1 && c->seen & FLAG(LATE_WORKER));
    assert_true(c->wrench.depth > 0.02 && c->oldest_snapshot > 1.0);
    double largest = 0.0;
    atomic_store(&fault->worker_nap, 0);
    for (int64_t end = monotonic_ns() + 1000000000; monotonic_ns() < end;) {
        double before = force_of(c);
        int64_t tick = c->wrench.tick;
        step(c);
        if (c->wrench.tick == tick + 1) largest = fmax(largest, fabs(force_of(c) - before));
    }
    print_message("force changes by %.4f N in a tick at most\n", largest);
    assert_true(largest < 0.05);
    expect_health(c);
    expect_only(c, FLAG(LATE_WORKER) | FLAG(RAMPING));
}

static void overruns_in_a_row_ramp_down(void **state) {
    client *c = *state;
    hear_news(c);
    int64_t misses = c->timing.misses;
    atomic_store(&fault->tick_nap, 2500);
    PASS_UNTIL(c, c->wrench.flags & FLAG(OVERRUN) && force_of(c) == 0.0);
    hear_news(c);
    assert_true(c->timing.misses - misses > 40);
    assert_true(c->timing.compute_p50 > 2e-3);
    assert_true(c->status->flags & FLAG(OVERRUN));
    atomic_store(&fault->tick_nap, 0);
    expect_health(c);
}

/* Each tick takes more than half its period, so a loop that ran two steps to catch up would stay late forever. */
static void a_stall_makes_no_other_tick_late(void **state) {
    client *c = *state;
    atomic_store(&fault->pass_nap, 600);
    hear_news(c);
    int64_t misses = c->timing.misses;
    atomic_store(&fault->stall, 5000);
    pass(c, 0.1);
    hear_news(c);
    assert_true(c->timing.misses - misses >= 4);
    misses = c->timing.misses;
    hear_news(c);
    if (in_time()) assert_true(c->timing.misses - misses < 50);
    atomic_store(&fault->pass_nap, 0);
    expect_health(c);
}

/* ---- start and end ------------------------------------------------------------------------------------------------------ */

static int start(void **state) {
    static client c;
    fault = mmap(NULL, sizeof *fault, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (fault == MAP_FAILED || mend(state) != 0) return -1;
    server_process = fork();
    if (server_process == 0) _exit(run_server());
    for (int i = 0; i < 1000 && !atomic_load(&fault->ready); i++) usleep(20000);
    *state = &c;
    return atomic_load(&fault->ready) && client_open(&c, SCENE) ? 0 : -1;
}

/* After all these faults, the server still stops cleanly, and the wrench ramps down to zero. */
static int stop(void **state) {
    client *c = *state;
    int status = 0;
    if (kill(server_process, SIGTERM) != 0) return -1;
    for (int i = 0; i < 2000 && waitpid(server_process, &status, WNOHANG) == 0; i++) step(c);
    bool at_rest = force_of(c) == 0.0;
    client_close(c);
    return WIFEXITED(status) && WEXITSTATUS(status) == 0 && at_rest ? 0 : -1;
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(silence_holds_ramps_and_returns_by_a_ramp, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(impossible_poses_are_refused_and_counted, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(a_spike_is_clamped_and_flagged, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(a_wrench_that_is_no_number_stays_inside, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(a_number_that_is_none_in_the_model_begins_anew, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(malformed_messages_are_dropped_and_counted, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(a_flood_does_not_touch_the_loop, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(a_second_client_is_refused_and_told, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(bad_commands_for_seeds_change_nothing, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(old_and_repeated_poses_are_refused, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(a_forged_number_does_not_lock_the_owner_out, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(a_reset_needs_no_pose_to_take_effect, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(wall_clocks_may_jump, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(a_late_worker_does_not_stop_the_loop, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(without_a_worker_the_tip_has_force, insert, mend_in_time),
        cmocka_unit_test_setup_teardown(overruns_in_a_row_ramp_down, insert, mend),
        cmocka_unit_test_setup_teardown(a_stall_makes_no_other_tick_late, insert, mend),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
