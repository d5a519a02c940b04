/* Tests that the first displacement field, as for a picture, does not wait for the factorisation when two threads need a condensed inverse for the first time
   at once. */
#include <pthread.h>
#include <semaphore.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <time.h>
#include <unistd.h>

#include "condensed/condensed_cache.h"
#include "cube.h"

#include <cmocka.h>

#include "check.h"

enum { REGION = 30, PATIENCE = 20 }; /* s */

/* While `held` is set, factorising waits until the displacement field has been computed. */
static sem_t factoring, drawn;
static bool held, was_drawn;

trocar_status __real_tissue_factor(tissue *t, int count, const int *nodes, trocar_error *why);
trocar_status __wrap_tissue_factor(tissue *t, int count, const int *nodes, trocar_error *why);
trocar_status __wrap_tissue_factor(tissue *t, int count, const int *nodes, trocar_error *why) {
    if (held) {
        struct timespec end;
        sem_post(&factoring);
        clock_gettime(CLOCK_REALTIME, &end);
        end.tv_sec += PATIENCE;
        was_drawn = sem_timedwait(&drawn, &end) == 0;
    }
    return __real_tissue_factor(t, count, nodes, why);
}

static void *prepare(void *context) {
    static trocar_error why;
    return inverse_prepare(context, &why) == TROCAR_OK ? context : NULL;
}

static void a_picture_does_not_wait_for_the_factorisation(void **state) {
    (void)state;
    char directory[] = "/tmp/test_condensed.XXXXXX";
    static cube body;
    int region[REGION];
    trocar_error notice, why;
    tissue t;
    inverse *inv;
    condensed_region wanted = {.count = REGION, .nodes = region, .directory = directory};
    for (int i = 0; i < REGION; i++) region[i] = 3 + 4 * i;
    assert_non_null(mkdtemp(directory));
    assert_int_equal(cube_create(&body, 0.1, &why), TROCAR_OK);
    for (int start = 0; start < 2; start++) { /* the first start computes the inverse; the second maps it from the file, without K */
        assert_int_equal(tissue_define(&body.mesh, body.materials, body.fixed, STRAIN_BY_ELEMENT, &t, &why), TROCAR_OK);
        assert_int_equal(inverse_create_condensed(&t, &wanted, &inv, &notice, &why), TROCAR_OK);
        if (start == 1) break;
        inverse_free(inv);
        tissue_free(&t);
    }
    assert_null(t.stiffness);
    assert_int_equal(unlink(condensed_cache_find(directory, &t, REGION, region, false).path), 0);
    assert_int_equal(rmdir(directory), 0);

    vec3 force[CUBE_NODES], expected[CUBE_NODES], found[CUBE_NODES];
    pthread_t preparation;
    void *prepared;
    double largest = 0.0;
    for (int i = 0; i < CUBE_NODES; i++) force[i] = cube_random_vector(1.0);
    inverse_apply(body.inverse, force, expected);
    for (int i = 0; i < CUBE_NODES; i++) largest = fmax(largest, v3_norm(expected[i]));
    sem_init(&factoring, 0, 0);
    sem_init(&drawn, 0, 0);
    held = true;
    assert_int_equal(pthread_create(&preparation, NULL, prepare, inv), 0);
    sem_wait(&factoring);
    inverse_apply(inv, force, found);
    sem_post(&drawn);
    pthread_join(preparation, &prepared);
    assert_non_null(prepared);
    assert_true(was_drawn);
    for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(found[i], expected[i], 1e-8 * largest);
    assert_non_null(t.factor);
    inverse_free(inv);
    tissue_free(&t);
    cube_free(&body);
    sem_destroy(&factoring);
    sem_destroy(&drawn);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_picture_does_not_wait_for_the_factorisation)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
