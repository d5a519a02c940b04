/* Tests the worker with a mock simulation that the linker puts in place of the real one. The newest request is served first, and failures are reported once.
   The real simulation's answers are tested in test_api_sim.c. */
#include <pthread.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/timing.h"
#include "common/eventfd_signal.h"
#include "worker.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

enum { BAD_SERIAL = 66, KEPT_SERIAL = 67 };

typedef struct {
    int serial;
    int64_t at;                  /* ns */
} request;

typedef struct {
    exchange exchange;
    worker worker;
    pthread_t thread;
    int requested;               /* eventfd */
    triple_buffer requests;      /* request */
    atomic_int calls, slices, answered;
} fixture;

static fixture fixed;

int __wrap_trocar_sim_work_descriptor(const trocar_sim *sim);
int __wrap_trocar_sim_work_descriptor(const trocar_sim *sim) {
    (void)sim;
    return fixed.requested;
}

/* An answer takes 20 ms, and each request leaves room for ten slices of prefetching, 5 ms each. */
trocar_status __wrap_trocar_sim_work(trocar_sim *sim, trocar_work *done, trocar_error *why);
trocar_status __wrap_trocar_sim_work(trocar_sim *sim, trocar_work *done, trocar_error *why) {
    (void)sim;
    fixture *f = &fixed;
    bool fresh;
    eventfd_t count;
    eventfd_read(f->requested, &count);
    const request *asked = triple_buffer_read(&f->requests, &fresh);
    *done = (trocar_work){.more = 1};
    if (!fresh) {
        sleep_until(monotonic_ns() + 5000000);
        done->more = atomic_fetch_add(&f->slices, 1) % 10 != 9;
        return TROCAR_OK;
    }
    atomic_fetch_add(&f->calls, 1);
    sleep_until(monotonic_ns() + 20000000);
    if (asked->serial == BAD_SERIAL) {
        snprintf(why->text, sizeof why->text, "request %d: no good", BAD_SERIAL);
        return TROCAR_NUMERIC;
    }
    if (asked->serial == KEPT_SERIAL) { /* the needle slips out of the tissue while being released, and is held as before */
        snprintf(why->text, sizeof why->text, "needle 0 cannot be left");
        done->still_held = 1;
        atomic_store(&f->answered, asked->serial);
        return TROCAR_BAD_INPUT;
    }
    done->answered = 1;
    done->latency = monotonic_ns() - asked->at;
    atomic_store(&f->answered, asked->serial);
    return TROCAR_OK;
}

static void ask(fixture *f, int serial) {
    *(request *)triple_buffer_slot(&f->requests) = (request){.serial = serial, .at = monotonic_ns()};
    triple_buffer_publish(&f->requests);
    eventfd_signal(f->requested);
}

/* Waits at most one second until request `serial` has been answered. Returns the last request answered. */
static int answer(fixture *f, int serial) {
    int64_t end = monotonic_ns() + 1000000000;
    do sleep_until(monotonic_ns() + 1000000);
    while (atomic_load(&f->answered) != serial && monotonic_ns() < end);
    return atomic_load(&f->answered);
}

static int open_fixture(void **state) {
    fixture *f = *state = &fixed;
    trocar_error why;
    memset(f, 0, sizeof *f);
    f->requested = eventfd(0, EFD_NONBLOCK);
    assert_int_equal(triple_buffer_create(&f->requests, sizeof(request), &why), TROCAR_OK);
    assert_int_equal(exchange_create(&f->exchange, NULL, &why), TROCAR_OK);
    f->worker = (worker){.exchange = &f->exchange};
    assert_int_equal(pthread_create(&f->thread, NULL, worker_run, &f->worker), 0);
    return 0;
}

static int close_fixture(void **state) {
    fixture *f = *state;
    worker_stop(&f->worker);
    pthread_join(f->thread, NULL);
    exchange_free(&f->exchange);
    triple_buffer_free(&f->requests);
    close(f->requested);
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

static void superseded_requests_are_dropped(void **state) {
    fixture *f = *state;
    for (int serial = 1; serial <= 50; serial++) ask(f, serial);
    assert_int_equal(answer(f, 50), 50);
    assert_true(atomic_load(&f->calls) <= 3);
}

static void failure_keeps_the_last_snapshot_and_is_reported(void **state) {
    fixture *f = *state;
    ask(f, 1);
    assert_int_equal(answer(f, 1), 1);
    ask(f, BAD_SERIAL);
    int64_t end = monotonic_ns() + 1000000000;
    const worker_fault *fault = triple_buffer_read(&f->exchange.faults, NULL);
    for (; !fault->lasts && monotonic_ns() < end; fault = triple_buffer_read(&f->exchange.faults, NULL)) sleep_until(monotonic_ns() + 1000000);
    assert_true(fault->lasts);
    assert_string_equal(fault->why.text, "request 66: no good");
    assert_int_equal(atomic_load(&f->answered), 1);
    ask(f, 2); /* the worker recovers, and the fault is cleared */
    assert_int_equal(answer(f, 2), 2);
    end = monotonic_ns() + 1000000000;
    for (; fault->lasts && monotonic_ns() < end; fault = triple_buffer_read(&f->exchange.faults, NULL)) sleep_until(monotonic_ns() + 1000000);
    assert_false(fault->lasts);
}

/* The refusal is the reply to the client that asked to leave the needle. It must not count as a worker fault, because a fault hides later messages in the
   status. */
static void a_needle_that_cannot_be_left_is_no_fault(void **state) {
    fixture *f = *state;
    ask(f, KEPT_SERIAL);
    assert_int_equal(answer(f, KEPT_SERIAL), KEPT_SERIAL);
    ask(f, 1);
    assert_int_equal(answer(f, 1), 1); /* by now, the worker has finished the previous request */
    assert_false(((const worker_fault *)triple_buffer_read(&f->exchange.faults, NULL))->lasts);
    assert_int_equal(f->worker.failed, 0);
}

static void idle_time_is_used_for_prefetching(void **state) {
    fixture *f = *state;
    ask(f, 1);
    int64_t end = monotonic_ns() + 2000000000;
    while (atomic_load(&f->slices) < 10 && monotonic_ns() < end) sleep_until(monotonic_ns() + 1000000);
    sleep_until(monotonic_ns() + 30000000);
    assert_int_equal(atomic_load(&f->slices), 10);
}

/* Requests take priority over prefetching: they wait only for the slice in progress. */
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

static void stops_without_a_request(void **state) { (void)state; } /* if stopping failed, the teardown would hang */

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_request_is_answered_and_timed, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(superseded_requests_are_dropped, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(failure_keeps_the_last_snapshot_and_is_reported, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_needle_that_cannot_be_left_is_no_fault, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(idle_time_is_used_for_prefetching, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_request_interrupts_looking_ahead, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(stops_without_a_request, open_fixture, close_fixture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
