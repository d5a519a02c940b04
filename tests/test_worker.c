/* The worker with a stand-in for the remesher: newest request wins, failures leave the last snapshot in force. */
#include <pthread.h>
#include <string.h>

#include "timing.h"
#include "worker.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

enum { BAD_SERIAL = 66 };

typedef struct {
    exchange exchange;
    worker worker;
    pthread_t thread;
    atomic_int calls, slices;
} fixture;

static trocar_status serve(void *context, const remesh_request *request, compliance_snapshot *snapshot, report *why) {
    fixture *f = context;
    atomic_fetch_add(&f->calls, 1);
    sleep_until(monotonic_ns() + 20000000);
    snapshot->serial = request->serial;
    if (request->serial != BAD_SERIAL) return TROCAR_OK;
    snprintf(why->text, sizeof why->text, "request %d: no good", BAD_SERIAL);
    return TROCAR_NUMERIC;
}

/* Ten slices of 5 ms to each request. */
static bool look_ahead(void *context) {
    fixture *f = context;
    sleep_until(monotonic_ns() + 5000000);
    return atomic_fetch_add(&f->slices, 1) % 10 != 9;
}

static void ask(fixture *f, uint64_t serial) {
    request_sample *sample = triple_buffer_slot(&f->exchange.requests);
    sample->requested = monotonic_ns();
    sample->request.serial = serial;
    triple_buffer_publish(&f->exchange.requests);
    wake(f->exchange.worker_wake);
}

/* Serial of the snapshot in force once it is `serial`, or after a second. */
static uint64_t answer(fixture *f, uint64_t serial) {
    int64_t end = monotonic_ns() + 1000000000;
    const compliance_snapshot *s;
    do {
        sleep_until(monotonic_ns() + 1000000);
        s = triple_buffer_read(&f->exchange.snapshots, NULL);
    } while (s->serial != serial && monotonic_ns() < end);
    return s->serial;
}

static int open_fixture(void **state) {
    static fixture f;
    report why;
    memset(&f, 0, sizeof f);
    assert_int_equal(exchange_create(&f.exchange, &why), TROCAR_OK);
    f.worker = (worker){.exchange = &f.exchange, .serve = serve, .look_ahead = look_ahead, .context = &f};
    assert_int_equal(pthread_create(&f.thread, NULL, worker_run, &f.worker), 0);
    *state = &f;
    return 0;
}

static int close_fixture(void **state) {
    fixture *f = *state;
    worker_stop(&f->worker);
    pthread_join(f->thread, NULL);
    exchange_free(&f->exchange);
    return 0;
}

static void a_request_is_answered_and_timed(void **state) {
    fixture *f = *state;
    ask(f, 1);
    assert_int_equal(answer(f, 1), 1);
    int64_t latency = 0, end = monotonic_ns() + 1000000000;
    while (!spsc_ring_pop(&f->exchange.latencies, &latency) && monotonic_ns() < end) continue;
    assert_true(latency >= 20000000 && latency < 1000000000);
}

static void requests_that_are_overtaken_are_forgotten(void **state) {
    fixture *f = *state;
    for (uint64_t serial = 1; serial <= 50; serial++) ask(f, serial);
    assert_int_equal(answer(f, 50), 50);
    assert_true(atomic_load(&f->calls) <= 3);
}

static void a_failure_keeps_the_last_snapshot_and_is_told(void **state) {
    fixture *f = *state;
    ask(f, 1);
    assert_int_equal(answer(f, 1), 1);
    ask(f, BAD_SERIAL);
    int64_t end = monotonic_ns() + 1000000000;
    while (!atomic_load(&f->worker.failed) && monotonic_ns() < end) sleep_until(monotonic_ns() + 1000000);
    assert_true(atomic_load(&f->worker.failed));
    assert_string_equal(f->worker.why.text, "request 66: no good");
    assert_int_equal(((const compliance_snapshot *)triple_buffer_read(&f->exchange.snapshots, NULL))->serial, 1);
    ask(f, 2); /* and it goes on */
    assert_int_equal(answer(f, 2), 2);
}

static void idle_time_is_used_until_nothing_is_left(void **state) {
    fixture *f = *state;
    ask(f, 1);
    int64_t end = monotonic_ns() + 2000000000;
    while (atomic_load(&f->slices) < 10 && monotonic_ns() < end) sleep_until(monotonic_ns() + 1000000);
    sleep_until(monotonic_ns() + 30000000);
    assert_int_equal(atomic_load(&f->slices), 10);
}

/* A request comes first: it waits for no more than the slice that is under way. */
static void a_request_interrupts_looking_ahead(void **state) {
    fixture *f = *state;
    ask(f, 1);
    assert_int_equal(answer(f, 1), 1);
    while (atomic_load(&f->slices) < 2) sleep_until(monotonic_ns() + 1000000);
    int calls = atomic_load(&f->calls);
    ask(f, 2);
    int slices = atomic_load(&f->slices);
    while (atomic_load(&f->calls) == calls) sleep_until(monotonic_ns() + 100000);
    assert_true(atomic_load(&f->slices) <= slices + 1);
    assert_int_equal(answer(f, 2), 2);
}

static void it_stops_without_a_request(void **state) { (void)state; } /* the teardown would hang */

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_request_is_answered_and_timed, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(requests_that_are_overtaken_are_forgotten, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_failure_keeps_the_last_snapshot_and_is_told, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(idle_time_is_used_until_nothing_is_left, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_request_interrupts_looking_ahead, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(it_stops_without_a_request, open_fixture, close_fixture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
