/* Tests that the shared buffers start out empty and that no wake-up is lost. */
#include <poll.h>

#include "common/eventfd_signal.h"
#include "exchange.h"
#include "intake/safety_limits.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static bool readable(int descriptor) {
    struct pollfd p = {.fd = descriptor, .events = POLLIN};
    return poll(&p, 1, 0) == 1;
}

static void initially_empty(void **unused) {
    (void)unused;
    exchange x;
    trocar_error why;
    bool fresh;
    int64_t latency;
    assert_int_equal(exchange_create(&x, NULL, &why), TROCAR_OK);
    const newest_poses *s = triple_buffer_read(&x.poses, &fresh);
    assert_false(fresh || s->needles[0].held);
    triple_buffer_read(&x.views, &fresh);
    assert_false(fresh);
    assert_false(spsc_ring_pop(&x.latencies, &latency));
    exchange_free(&x);
    exchange_free(&x); /* freeing it twice does no harm */
}

static void wakes_before_the_wait_are_kept(void **unused) {
    (void)unused;
    exchange x;
    trocar_error why;
    assert_int_equal(exchange_create(&x, NULL, &why), TROCAR_OK);
    for (int i = 0; i < 3; i++) eventfd_signal(x.worker_wake);
    assert_false(readable(x.io_wake));
    eventfd_wait(x.worker_wake); /* returns at once */
    assert_false(readable(x.worker_wake));
    exchange_free(&x);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(initially_empty), cmocka_unit_test(wakes_before_the_wait_are_kept)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
