/* Compares the per-thread allocation counter with a known number of calls, made here and in a shared library. */
#include <malloc.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <glib.h>

#include "shared/allocator_calls.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static void all_allocator_functions_are_counted(void **unused) {
    (void)unused;
    if (!ALLOCATIONS_ARE_COUNTED) skip();
    int64_t before = allocator_calls();
    void *volatile p = malloc(10);
    p = realloc(p, 1000);
    free(p);
    p = calloc(3, 5);
    free(p);
    p = memalign(64, 100);
    free(p);
    p = aligned_alloc(64, 128);
    free(p);
    void *q = NULL;
    assert_int_equal(posix_memalign(&q, 64, 100), 0);
    assert_int_equal((uintptr_t)q % 64, 0);
    free(q);
    assert_int_equal(allocator_calls() - before, 11);
}

static void calls_from_shared_libraries_are_counted(void **unused) {
    (void)unused;
    if (!ALLOCATIONS_ARE_COUNTED) skip();
    int64_t before = allocator_calls();
    g_free(g_strdup("text")); /* in GLib */
    free(strdup("text"));     /* allocates inside the C library */
    assert_int_equal(allocator_calls() - before, 4);
}

static void *allocate_a_lot(void *counted) {
    for (int i = 0; i < 100; i++) {
        void *volatile p = malloc(10);
        free(p);
    }
    *(int64_t *)counted = allocator_calls();
    return NULL;
}

static void counts_are_per_thread(void **unused) {
    (void)unused;
    if (!ALLOCATIONS_ARE_COUNTED) skip();
    pthread_t thread;
    int64_t theirs = 0;
    assert_int_equal(pthread_create(&thread, NULL, allocate_a_lot, &theirs), 0);
    int64_t before = allocator_calls();
    pthread_join(thread, NULL);
    assert_in_range(theirs, 200, 210);
    assert_true(allocator_calls() - before <= 2);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(all_allocator_functions_are_counted),
        cmocka_unit_test(calls_from_shared_libraries_are_counted),
        cmocka_unit_test(counts_are_per_thread),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
