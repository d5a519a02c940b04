/* Tests, for every case, which inverse is chosen and the reason given. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "condensed/inverse_choice.h"

#include <cmocka.h>

static const double ROOM = 64e9; /* bytes */

static void every_choice_has_its_reason(void **state) {
    (void)state;
    static const struct { inverse_facts facts; inverse_choice expected; const char *words; } cases[] = {
        {{.given = INVERSE_SPARSE, .node_count = 10, .dof_count = 30}, INVERSE_SPARSE, "sparse (set in the scene)"},
        {{.given = INVERSE_DENSE, .node_count = 45000, .dof_count = 135000}, INVERSE_DENSE, "dense (set in the scene)"},
        {{.node_count = 572, .dof_count = 1416, .memory = ROOM}, INVERSE_DENSE, "dense (572 nodes: 0.016 GB)"},
        {{.node_count = 45000, .dof_count = 135000, .memory = ROOM, .roi_given = true, .roi_count = 3418}, INVERSE_CONDENSED,
         "condensed (region of 3418 nodes: 0.421 GB; dense would take 146 GB)"},
        {{.node_count = 45000, .dof_count = 135000, .memory = ROOM, .precision = PRECISION_DOUBLE, .roi_given = true, .roi_count = 6196}, INVERSE_CONDENSED,
         "condensed (region of 6196 nodes: 1.38 GB; dense would take 146 GB)"},
        {{.node_count = 45000, .dof_count = 135000, .memory = ROOM, .roi_given = true, .roi_count = 6196}, INVERSE_CONDENSED,
         "condensed (region of 6196 nodes: 0.691 GB; dense would take 146 GB)"},
        {{.node_count = 45000, .dof_count = 135000, .memory = ROOM, .roi_given = true, .roi_count = 20000}, INVERSE_SPARSE,
         "sparse (region of 20000 nodes: condensed would take 7.2 GB, more than 4 GB; dense 146 GB)"},
        {{.node_count = 45000, .dof_count = 135000, .memory = 2e9, .roi_given = true, .roi_count = 7000}, INVERSE_SPARSE,
         "sparse (region of 7000 nodes: condensed would take 0.882 GB, more than 0.5 GB; dense 146 GB)"},
        {{.node_count = 45000, .dof_count = 135000, .memory = 3.5e9, .roi_given = true, .roi_count = 5000}, INVERSE_SPARSE,
         "sparse (region of 5000 nodes: condensed would take 1.8 GB while it is made, more than 1.75 GB; dense 146 GB)"},
        {{.node_count = 45000, .dof_count = 135000, .memory = 3.7e9, .roi_given = true, .roi_count = 5000}, INVERSE_CONDENSED,
         "condensed (region of 5000 nodes: 0.45 GB; dense would take 146 GB)"},
        {{.node_count = 45000, .dof_count = 135000, .memory = ROOM, .roi_count = 3000}, INVERSE_SPARSE,
         "sparse (45000 nodes: dense would take 146 GB, and there is no region_of_interest)"},
        {{.node_count = 3000, .dof_count = 9000, .memory = 2e9, .roi_count = 3000}, INVERSE_SPARSE,
         "sparse (3000 nodes: dense would take 0.648 GB, and there is no region_of_interest)"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        trocar_error about;
        assert_int_equal(inverse_choose(&cases[i].facts, &about), cases[i].expected);
        assert_string_equal(about.text, cases[i].words);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_choice_has_its_reason)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
