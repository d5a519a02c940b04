/* Tests the measurements of the remeshing benchmark: operations are counted, and the inverse is restored. The times themselves are not checked. */
#include "remeshing.h"

#include "remesh_timing.h"

static void every_method_is_timed(void **state) {
    (void)state;
    for (method = 0; method < REMESH_METHODS; method++)
        for (remesh_change change = 0; change < REMESH_CHANGES; change++) {
            trocar_error why = {""};
            static remesh_timing result;
            remesh_case wanted = {.method = method, .change = change, .contacts = 5, .samples = 4, .seconds = 60.0};
            trocar_status status = remesh_timing_measure(tested_inverse, &wanted, &result, &why);
            if (method == REMESH_NESTED && change == MOVE_NODE) {
                assert_int_equal(status, TROCAR_BAD_INPUT);
                continue;
            }
            if (status != TROCAR_OK) fail_msg("%s", why.text);
            assert_int_equal(result.samples, 4);
            assert_int_equal(result.add.count, 4);
            assert_int_equal(result.remove.count, 4);
            assert_true(histogram_quantile(&result.add, 0.5) > 0.0);
        }
}

static void time_limit_allows_three_samples(void **state) {
    (void)state;
    trocar_error why;
    static remesh_timing result;
    remesh_case wanted = {.method = REMESH_NESTED, .samples = 1000, .seconds = 0.0};
    assert_int_equal(remesh_timing_measure(tested_inverse, &wanted, &result, &why), TROCAR_OK);
    assert_int_equal(result.samples, 3);
}

static void valences_match_the_mesh(void **state) {
    (void)state;
    int counts[MAX_PATCH + 1], sum = 0;
    remesh_timing_valences(tested, counts);
    for (int i = 0; i <= MAX_PATCH; i++) sum += counts[i];
    assert_int_equal(sum, 2 * 9); /* inner nodes, without those on the region boundary */
    assert_int_equal(counts[15], sum); /* each inner node of Kuhn's mesh has 14 neighbours */
    trocar_error why;
    static remesh_timing result;
    remesh_case wanted = {.method = REMESH_IMPLICIT, .change = MOVE_NODE, .touched = 14, .samples = 3, .seconds = 60.0};
    assert_int_equal(remesh_timing_measure(tested_inverse, &wanted, &result, &why), TROCAR_OK);
    assert_int_equal(result.samples, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_method_is_timed),
        cmocka_unit_test(time_limit_allows_three_samples),
        cmocka_unit_test(valences_match_the_mesh),
    };
    return cmocka_run_group_tests(tests, remeshing_create, remeshing_destroy);
}
