/* Tests lock-free buffers between two threads running at full speed. Also meant for ThreadSanitizer. */
#include <pthread.h>
#include <sched.h>
#include <string.h>

#include "base/spsc_ring.h"
#include "base/triple_buffer.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

enum { WORDS = 512, ROUNDS = 20000, RING_ROUNDS = 1000000 };

typedef struct { uint64_t words[WORDS]; } block;

static void *write_blocks(void *context) {
    triple_buffer *n = context;
    for (uint64_t round = 1; round <= ROUNDS; round++) {
        block *b = triple_buffer_slot(n);
        for (int i = 0; i < WORDS; i++) b->words[i] = round + (uint64_t)i;
        triple_buffer_publish(n);
        if (round % 64 == 0) sched_yield();
    }
    return NULL;
}

/* Each block read must be consistent and no older than the previous one, and the last block written must arrive. */
static void newest_value_is_never_torn_and_never_older(void **unused) {
    (void)unused;
    triple_buffer n;
    trocar_error why;
    pthread_t writer;
    assert_int_equal(triple_buffer_create(&n, sizeof(block), &why), TROCAR_OK);
    assert_int_equal(pthread_create(&writer, NULL, write_blocks, &n), 0);
    uint64_t last = 0, seen = 0;
    while (last < ROUNDS) {
        bool fresh;
        const block *b = triple_buffer_read(&n, &fresh);
        uint64_t round = b->words[0];
        for (int i = 0; round > 0 && i < WORDS; i++) assert_int_equal(b->words[i], round + (uint64_t)i);
        if (fresh) assert_true(round > last);
        else assert_int_equal(round, last);
        seen += fresh;
        last = round;
    }
    pthread_join(writer, NULL);
    assert_true(seen > 1);
    triple_buffer_free(&n);
}

static void newest_value_is_fresh_once(void **unused) {
    (void)unused;
    triple_buffer n;
    trocar_error why;
    bool fresh;
    assert_int_equal(triple_buffer_create(&n, sizeof(int), &why), TROCAR_OK);
    assert_int_equal(*(const int *)triple_buffer_read(&n, &fresh), 0);
    assert_false(fresh);
    for (int i = 1; i <= 5; i++) {
        *(int *)triple_buffer_slot(&n) = i;
        triple_buffer_publish(&n);
    }
    assert_int_equal(*(const int *)triple_buffer_read(&n, &fresh), 5);
    assert_true(fresh);
    assert_int_equal(*(const int *)triple_buffer_read(&n, &fresh), 5);
    assert_false(fresh);
    triple_buffer_free(&n);
}

/* The slot being read does not change, however often the writer writes. */
static void a_slot_that_is_read_does_not_change(void **unused) {
    (void)unused;
    triple_buffer n;
    trocar_error why;
    assert_int_equal(triple_buffer_create(&n, sizeof(int), &why), TROCAR_OK);
    *(int *)triple_buffer_slot(&n) = 7;
    triple_buffer_publish(&n);
    const int *held = triple_buffer_read(&n, NULL);
    for (int i = 0; i < 10; i++) {
        *(int *)triple_buffer_slot(&n) = 100 + i;
        triple_buffer_publish(&n);
        assert_int_equal(*held, 7);
    }
    triple_buffer_free(&n);
}

static void *push_all(void *context) {
    spsc_ring *r = context;
    for (uint64_t i = 0; i < RING_ROUNDS; i++) {
        uint64_t pair[2] = {i, ~i};
        while (!spsc_ring_push(r, pair)) sched_yield();
    }
    return NULL;
}

static void ring_preserves_all_values_in_order(void **unused) {
    (void)unused;
    spsc_ring r;
    trocar_error why;
    pthread_t writer;
    assert_int_equal(spsc_ring_create(&r, 2 * sizeof(uint64_t), 100, &why), TROCAR_OK);
    assert_int_equal(pthread_create(&writer, NULL, push_all, &r), 0);
    for (uint64_t i = 0; i < RING_ROUNDS; i++) {
        uint64_t pair[2];
        while (!spsc_ring_pop(&r, pair)) sched_yield();
        assert_int_equal(pair[0], i);
        assert_int_equal(pair[1], ~i);
    }
    pthread_join(writer, NULL);
    spsc_ring_free(&r);
}

static void ring_refuses_when_full_and_when_empty(void **unused) {
    (void)unused;
    spsc_ring r;
    trocar_error why;
    int value = 0;
    assert_int_equal(spsc_ring_create(&r, sizeof value, 5, &why), TROCAR_OK);
    assert_int_equal(r.capacity, 8);
    assert_false(spsc_ring_pop(&r, &value));
    for (int i = 0; i < 8; i++) assert_true(spsc_ring_push(&r, &i));
    value = 99;
    assert_false(spsc_ring_push(&r, &value));
    for (int i = 0; i < 8; i++) {
        assert_true(spsc_ring_pop(&r, &value));
        assert_int_equal(value, i);
    }
    assert_false(spsc_ring_pop(&r, &value));
    spsc_ring_free(&r);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(newest_value_is_never_torn_and_never_older),
        cmocka_unit_test(newest_value_is_fresh_once),
        cmocka_unit_test(a_slot_that_is_read_does_not_change),
        cmocka_unit_test(ring_preserves_all_values_in_order),
        cmocka_unit_test(ring_refuses_when_full_and_when_empty),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
