/* Compares the bare loop with the clock, and tests that the whole haptic thread, running the real model, neither allocates memory nor causes page faults nor
   waits for a slow worker. */
#define _GNU_SOURCE
#include <pthread.h>
#include <sched.h>
#include <stdlib.h>
#include <string.h>

#include "shared/allocator_calls.h"
#include "common/realtime.h"
#include "haptic.h"
#include "remesh/remesh.h"
#include "shared/motion.h"
#include "trocar_needle_wrench_t.h"
#include "worker.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "host.h"

/* --- the bare loop ---------------------------------------------------------------------------------------------- */

enum { TICKS = 200, SLOW_TICK = 50 };

typedef struct { loop_wake wakes[TICKS]; } diary;

/* Records each tick, and oversleeps by a few periods in one of them. */
static bool keep_diary(void *context, const loop_wake *wake) {
    diary *d = context;
    d->wakes[wake->tick] = *wake;
    if (wake->tick == SLOW_TICK) sleep_until(wake->now + 10500000);
    return wake->tick + 1 < TICKS;
}

static void missed_periods_are_skipped_and_counted(void **unused) {
    (void)unused;
    static diary d;
    static loop l;
    triple_buffer records;
    trocar_error why;
    assert_int_equal(triple_buffer_create(&records, sizeof(loop_record), &why), TROCAR_OK);
    l = (loop){.rate_hz = 1000, .tick = keep_diary, .context = &d, .records = &records};
    loop_run(&l);

    assert_int_equal(l.ticks, TICKS);
    assert_true(l.misses >= 10);
    assert_true(d.wakes[SLOW_TICK + 1].late);
    assert_true(d.wakes[SLOW_TICK + 1].elapsed > 0.0109);

    /* Model time follows the clock: deadlines stay multiples of the period, and no tick is repeated. */
    double model = 0.0, missed = 0.0;
    for (int i = 1; i < TICKS; i++) {
        model += d.wakes[i].elapsed;
        missed += d.wakes[i].elapsed / 1e-3 - 1;
        assert_true(d.wakes[i].late == (d.wakes[i].elapsed > 1.5e-3));
    }
    double clock = 1e-9 * (double)(d.wakes[TICKS - 1].now - d.wakes[0].now);
    assert_true(fabs(model - clock) < 0.05); /* on a busy virtual machine, the first and last ticks may each start late */
    assert_true(fabs(missed - (double)l.misses) < 0.5);

    bool fresh;
    const loop_record *record = triple_buffer_read(&records, &fresh); /* of ticks 101..200 */
    assert_true(fresh);
    assert_int_equal(record->ticks, TICKS);
    assert_int_equal(record->lateness.count, TICKS / 2);
    assert_true(record->compute_max_total > 0.0104);
    assert_int_equal(l.lateness.count, TICKS);
    triple_buffer_free(&records);
}

/* --- the haptic thread with model, worker and simulated device --------------------------------------------------- */

enum { RATE = 1000 };

typedef struct {
    host host;
    exchange exchange;
    haptic haptic;
    loop loop;
    worker worker;
    int64_t ticks_wanted, ticks;
    int most_contacts[TROCAR_MAX_NEEDLES];
    thread_usage start, used;    /* haptic thread's usage before its first tick, and since then */
    int64_t wrenches;
} rig;

static int nap_ms;               /* ms, added to each of the worker's answers */

/* The linker replaces the library's own function with this wrapper. */
trocar_status __real_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why) {
    if (nap_ms > 0) sleep_until(monotonic_ns() + nap_ms * (int64_t)1000000);
    return __real_remesher_serve(r, request, snapshot, why);
}

static bool in_contact(const rig *r) {
    for (int n = 0; n < r->haptic.needle_count; n++) {
        if (r->most_contacts[n] < 5) return false;
    }
    return true;
}

/* Runs the haptic tick between two rounds of a simulated IO thread, which delivers a pose before the tick and takes the wrench after it. */
static bool rigged_tick(void *context, const loop_wake *wake) {
    rig *r = context;
    if (wake->tick == 0) r->start = thread_usage_now();
    newest_poses *poses = triple_buffer_slot(&r->exchange.poses);
    for (int n = 0; n < r->haptic.needle_count; n++) {
        const pose start = {{0.005 - 0.03 * n, 0.003, -0.205}, {1, 0, 0, 0}}; /* 5 mm in front of the skin */
        poses->needles[n] = (pose_sample){.held = true, .engagement = 1, .session = 1 + n, .seq = wake->tick, .received = wake->now,
                                          .base = motion_pose(motion_find("figure8"), start, 1e-3 * (double)wake->tick)};
    }
    triple_buffer_publish(&r->exchange.poses);

    haptic_tick(&r->haptic, wake);

    trocar_needle_wrench_t wrench;
    while (spsc_ring_pop(&r->exchange.wrenches, &wrench)) {
        r->wrenches++;
        int *most = &r->most_contacts[wrench.needle];
        if (wrench.contacts > *most) *most = wrench.contacts;
    }
    r->ticks = wake->tick + 1;
    const int64_t wanted = in_contact(r) ? r->ticks_wanted : 20 * r->ticks_wanted; /* a busy machine serves additions late */
    if (r->ticks < wanted) return true;
    r->used = thread_usage_since(&r->start);
    return false;
}

static void *haptic_thread(void *context) {
    rig *r = context;
    trocar_error ignored;
    realtime_flush_denormals();
    realtime_touch_stack();
    realtime_set_priority(PRIORITY_HAPTIC, &ignored); /* it does not matter if the priority is not permitted */
    loop_run(&r->loop);
    return NULL;
}

static rig *rig_create(int64_t ticks, const char *needles) {
    rig *r = allocate_on_cache_lines(sizeof *r);
    trocar_error why = {""};
    r->host = host_open_with(MESHES "/figure8.yaml", "needles", needles);
    if (exchange_create(&r->exchange, r->host.model, &why) != TROCAR_OK) fail_msg("%s", why.text);
    trocar_device_limits limits = trocar_scene_device(r->host.scene);
    haptic_init(&r->haptic, r->host.sim, trocar_model_needles(r->host.model), &limits, RATE, 0, &r->exchange);
    r->ticks_wanted = ticks;
    r->loop = (loop){.rate_hz = RATE, .tick = rigged_tick, .context = r, .records = &r->exchange.loops};
    r->worker = (worker){.exchange = &r->exchange, .sim = r->host.sim};
    return r;
}

static void rig_run(rig *r) {
    pthread_t haptic, worker;
    assert_int_equal(pthread_create(&worker, NULL, worker_run, &r->worker), 0);
    assert_int_equal(pthread_create(&haptic, NULL, haptic_thread, r), 0);
    pthread_join(haptic, NULL);
    worker_stop(&r->worker);
    pthread_join(worker, NULL);
}

static void rig_free(rig *r) {
    exchange_free(&r->exchange);
    host_close(&r->host);
    free(r);
}

static void expect_a_quiet_loop(int64_t ticks, const char *needles) {
    rig *r = rig_create(ticks, needles);
    trocar_error why;
    bool locked = realtime_lock_memory(&why) == TROCAR_OK;
    rig_run(r);
    assert_int_equal(r->wrenches, r->ticks * r->haptic.needle_count);
    assert_true(in_contact(r));
    assert_true(r->worker.served > 10);
    assert_int_equal(r->loop.usage.allocations, 0);
    if (locked && ALLOCATIONS_ARE_COUNTED) {
        assert_int_equal(r->used.minor_faults, 0);
        assert_int_equal(r->used.major_faults, 0);
    } else print_message("page faults not tested: %s\n", locked ? "sanitizer" : why.text);
    rig_free(r);
}

static void no_allocations_and_no_page_faults(void **unused) {
    (void)unused;
    expect_a_quiet_loop(2 * RATE, "1");
}

static void nor_with_two_needles(void **unused) {
    (void)unused;
    expect_a_quiet_loop(RATE, "2");
}

static void a_slow_worker_never_stalls_the_loop(void **unused) {
    (void)unused;
    nap_ms = 50; /* per answer, and a tick takes 1 ms */
    rig *r = rig_create(2 * RATE, "1");
    rig_run(r);
    assert_true(r->worker.served > 10 && r->worker.served <= r->ticks / nap_ms + 2); /* only the newest request is answered, so none queue up */
    assert_true(histogram_quantile(&r->loop.compute, 0.99) < (ALLOCATIONS_ARE_COUNTED ? 1e-3 : 20e-3));
    if (ALLOCATIONS_ARE_COUNTED) assert_true(r->loop.misses < RATE / 10); /* the few misses are the machine's doing, not the worker's */
    rig_free(r);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(missed_periods_are_skipped_and_counted),
        cmocka_unit_test(no_allocations_and_no_page_faults),
        cmocka_unit_test(nor_with_two_needles),
        cmocka_unit_test(a_slow_worker_never_stalls_the_loop),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
