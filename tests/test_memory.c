/* The machine's memory against sysconf. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <unistd.h>

#include "base/memory.h"

#include <cmocka.h>

#include "check.h"

static void is_that_of_the_system(void **state) {
    (void)state;
    double page = (double)sysconf(_SC_PAGESIZE), total = page * (double)sysconf(_SC_PHYS_PAGES);
    assert_close(memory_total(), total, 0.01 * total);
    assert_true(memory_available() > 0.0 && memory_available() < memory_total());
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(is_that_of_the_system)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
