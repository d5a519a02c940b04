/* Tests nested addition of nodes inside elements and on faces. */
#include "remeshing.h"

static void nested_refuses_moved_nodes(void **state) {
    (void)state;
    trocar_error why = {""};
    remesher *r = start(REMESH_NESTED);
    while (request.wanted.count == 0) add_nodes(MOVED, 1);
    request.serial++;
    assert_int_equal(remesher_serve(r, &request, &snapshot, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "implicit"));
    remesher_free(r);
}

/* Compares all numbers in two snapshots that answer the same request. */
static void assert_same_bits(const compliance_snapshot *a, const compliance_snapshot *b) {
    assert_memory_equal(a->ids, b->ids, sizeof a->ids);
    assert_memory_equal(a->window, b->window, sizeof a->window);
    for (int i = 0; i < 3 * MAX_HANDLES; i++)
        for (int j = 0; j < 3 * MAX_HANDLES; j++)
            if (node_of(i / 3) >= 0 && node_of(j / 3) >= 0) assert_true(a->compliance[i * SNAPSHOT_LD + j] == b->compliance[i * SNAPSHOT_LD + j]);
    for (int i = 0; i < request.wanted.count; i++)
        for (int j = 0; j < request.wanted.count; j++) {
            mat3 x = compliance_between(a, request.wanted.order[i], request.wanted.order[j]), y = compliance_between(b, request.wanted.order[i], request.wanted.order[j]);
            assert_memory_equal(&x, &y, sizeof x);
        }
}

/* Stored values are bit-identical whether they were computed when the contact nodes were added, or later, when nodes entered the window or were needed
   outside it. A second remesher that continues from a snapshot gives exactly the first one's answers. */
static void another_one_goes_on_to_the_bit(void **state) {
    (void)state;
    static compliance_snapshot other;
    remesher *r = start(REMESH_NESTED), *second = start(REMESH_NESTED);
    trocar_error why = {""};
    for (int n = 0; n < 12; n++) {
        choose_window(n % 4 == 3 ? 4 : 20 + 6 * n);
        add_nodes(ON_FACE, 3);
        if (n % 3 == 2) add_nodes(INSIDE, 2);
        serve(r);
        assert_int_equal(remesher_resume(second, &request, &snapshot, &why), TROCAR_OK);
        add_nodes(ON_FACE, 2);
        for (int step = 0; step < 2; step++) {
            serve(r);
            assert_int_equal(remesher_serve(second, &request, &other, &why), TROCAR_OK);
            assert_same_bits(&snapshot, &other);
            choose_window(30); /* once more, with a different window */
        }
        request.wanted.count -= n % 2 ? 0 : 3; /* the last nodes */
    }
    remesher_free(r);
    remesher_free(second);
}

int main(void) {
    static const remesh_method methods[] = {REMESH_NESTED};
    const struct CMUnitTest tests[] = {cmocka_unit_test(nested_refuses_moved_nodes), cmocka_unit_test(another_one_goes_on_to_the_bit)};
    int failed = run_remeshing_tests(methods, sizeof methods / sizeof *methods);
    return failed + cmocka_run_group_tests(tests, remeshing_create, remeshing_destroy);
}
