/* Nested addition inside elements and on faces. */
#include "remeshing.h"

static void nested_refuses_moved_nodes(void **state) {
    (void)state;
    report why = {""};
    remesher *r = start(REMESH_NESTED);
    while (request.wanted.count == 0) add_nodes(MOVED, 1);
    request.serial++;
    assert_int_equal(remesher_serve(r, &request, &snapshot, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "implicit"));
    remesher_free(r);
}

int main(void) {
    static const remesh_method methods[] = {REMESH_NESTED};
    const struct CMUnitTest tests[] = {cmocka_unit_test(nested_refuses_moved_nodes)};
    int failed = run_remeshing_tests(methods, sizeof methods / sizeof *methods);
    return failed + cmocka_run_group_tests(tests, remeshing_create, remeshing_destroy);
}
