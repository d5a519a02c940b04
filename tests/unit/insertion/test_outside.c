/* Tests that a shaft pushed into a body from the side bears no force there and that a flag reports this. A needle that enters tip first does not set the
   flag. */
#include "lockstep.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

/* The needle lies along +x with its tip beyond the far side of the body. It is lowered into the skin, at z = 0, without the tip touching the body. */
static void a_shaft_laid_into_the_body_is_told(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    c.needle.length = 0.4;
    quat along_x = q_unit((quat){1, 0, 1, 0});
    pose start = {v3(-0.2, 0.003, -0.01), along_x};
    lockstep *l = lockstep_create(&c, start);
    assert_true(q_axis(along_x).x > 0.999);
    lockstep_move(l, v3(0, 0, 0.008), 0.1, 1e-3);
    assert_int_equal(l->wrench.events, 0);
    lockstep_move(l, v3(0, 0, 0.022), 0.1, 1e-3);
    assert_int_equal(l->wrench.events, EVENT_OUTSIDE_MODEL);
    assert_true(v3_norm(l->wrench.force) == 0.0);
    lockstep_move(l, v3(0, 0, -0.022), 0.1, 1e-3);
    lockstep_move(l, v3(0, 0, 0), 0.1, 1e-3);
    assert_int_equal(l->wrench.events, 0);
    lockstep_free(l);
}

/* An inserted needle that is moved sideways or further in or out, at any speed, does not set the flag, because its track is known. */
static void an_insertion_is_not(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    for (int i = 0; i < 3; i++) {
        lockstep *l = lockstep_create(&c, lockstep_start());
        double seconds = 0.1 + 0.3 * i;
        vec3 ways[] = {v3(0, 0, 0.03), v3(0.006, 0.004, 0), v3(0, 0, 0.05), v3(-0.01, 0, 0), v3(0, 0, -0.09)};
        for (size_t k = 0; k < sizeof ways / sizeof *ways; k++) {
            int ticks = (int)(seconds * 1000);
            for (int t = 0; t < ticks; t++) {
                lockstep_move(l, v3_scale(1.0 / ticks, ways[k]), 1e-3, 1e-3);
                assert_false(l->wrench.events & EVENT_OUTSIDE_MODEL);
            }
        }
        lockstep_free(l);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_shaft_laid_into_the_body_is_told),
        cmocka_unit_test(an_insertion_is_not),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
