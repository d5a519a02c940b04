/* Tests boundary-condition switches on the full inverse, one by one and in blocks, and the state after a failed switch. */
#include "remeshing.h"

#include "oracles/remesh_dense.h"

static void expect_failure(remesher *r) {
    trocar_error why = {""};
    request.serial++;
    assert_int_equal(remesher_serve(r, &request, &snapshot, &why), TROCAR_NUMERIC);
    assert_non_null(strstr(why.text, "boundary-condition switch"));
}

static remesher *start_with_nodes(int wanted, int count) {
    remesher *r = start(method = wanted);
    choose_window(30);
    add_mixed(method, count);
    check(r);
    return r;
}

/* Moves a node out of its elements. This inverts them, so there is no valid pivot, and requests with the node must fail. */
static void check_inverted(int wanted) {
    remesher *r = start_with_nodes(wanted, 6);
    int last = request.wanted.count;
    for (int tet = 0; request.wanted.count == last; tet++) add_node(MOVED, tet, point_in(tet, 0.1));
    added_node *node = &request.wanted.nodes[last];
    node->position = v3_axpy(3.0 * CUBE_EDGE, v3(1, 1, 1), node->position);
    expect_failure(r);
    expect_failure(r);
    request.wanted.count--;
    check(r);
    add_mixed(method, 3);
    check(r);
    remesher_free(r);
}

/* Corrupts the matrix so that removing a node fails. The remaining nodes must then be added again from scratch. */
static void check_spoilt(int wanted) {
    remesher *r = start_with_nodes(wanted, 8);
    dense_remesher *dense = (dense_remesher *)r;
    int end = tested->dof_count + 3 * request.wanted.count;
    for (int i = 0; i < end; i++) dense->matrix[(size_t)i * (size_t)dense->ld + (size_t)i] *= -1.0;
    request.wanted.count -= 3;
    check(r);
    add_mixed(method, 3);
    check(r);
    remesher_free(r);
}

static void failed_switch_is_rolled_back(void **state) {
    (void)state;
    static void (*const checks[])(int) = {check_inverted, check_spoilt};
    for (int i = 0; i < 2; i++) {
        checks[i](REMESH_BCS);
        checks[i](REMESH_BCS_BLOCKED);
    }
}

int main(void) {
    static const remesh_method methods[] = {REMESH_BCS, REMESH_BCS_BLOCKED};
    const struct CMUnitTest tests[] = {cmocka_unit_test(failed_switch_is_rolled_back)};
    return run_remeshing_tests(methods, sizeof methods / sizeof *methods) + cmocka_run_group_tests(tests, remeshing_create, remeshing_destroy);
}
