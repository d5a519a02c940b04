#include "inverse/lru.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static void the_least_recently_used_key_goes(void **state) {
    (void)state;
    lru c;
    assert_true(lru_create(&c, 10, 3));
    assert_false(lru_touch(&c, 7));
    int seven = lru_claim(&c, 7), two = lru_claim(&c, 2), nine = lru_claim(&c, 9);
    assert_true(seven != two && two != nine && nine != seven);
    assert_true(lru_touch(&c, 7));
    assert_int_equal(lru_claim(&c, 4), two);
    assert_int_equal(lru_claim(&c, 0), nine);
    assert_false(lru_touch(&c, 2) || lru_touch(&c, 9));
    assert_int_equal(c.slot[7], seven);
    assert_int_equal(lru_claim(&c, 2), seven);
    lru_free(&c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_least_recently_used_key_goes)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
