/* What the remesher does whatever the method: places, labels and refusals. The methods are tested one by one. */
#include "remeshing.h"

/* A replaced node has the same place in the list but another id: it must be taken out and put in again. */
static void ids_tell_nodes_apart(void **state) {
    (void)state;
    for (method = 0; method < REMESH_METHODS; method++) {
        remesher *r = start(method);
        choose_window(10);
        add_mixed(method, 5);
        serve(r);
        request.wanted.count = 3;
        add_mixed(method, 2);
        check(r);
        remesher_free(r);
    }
}

static void nodes_that_stay_keep_their_place(void **state) {
    (void)state;
    remesher *r = start(REMESH_NESTED);
    choose_window(40);
    serve(r);
    before = snapshot;
    request.window_count = 50;
    memmove(request.window, request.window + 20, 20 * sizeof *request.window); /* the first 20 leave */
    for (int node = 0, n = 20; n < 50; node++) {
        bool old = false;
        for (int k = 0; k < MAX_WINDOW; k++) old = old || before.window[k] == node;
        if (!old) request.window[n++] = node;
    }
    serve(r);
    for (int k = 0; k < MAX_WINDOW; k++)
        for (int i = 0; i < 20; i++)
            if (before.window[k] == request.window[i]) assert_int_equal(snapshot.window[k], before.window[k]);
    assert_labels_right();
    assert_blocks_right(1e-8);
    remesher_free(r);
}

static void full_inverse_methods_need_the_dense_owner(void **state) {
    (void)state;
    inverse *sparse;
    report why = {""};
    assert_int_equal(inverse_create_sparse(&body.tissue, SPARSE_CACHE, &sparse, &why), TROCAR_OK);
    for (method = 0; method < REMESH_METHODS; method++) {
        remesher *r;
        trocar_status expected = remesh_needs_dense(method) ? TROCAR_BAD_INPUT : TROCAR_OK;
        assert_int_equal(remesher_create(sparse, method, &r, &why), expected);
        if (expected != TROCAR_OK) assert_non_null(strstr(why.text, remesh_name(method)));
        remesher_free(r);
    }
    inverse_free(sparse);
}

static void check_with_all(void) {
    for (method = 0; method < REMESH_METHODS; method++) {
        if (remesh_needs_dense(method)) continue;
        remesher *r = start(method);
        choose_window(40);
        add_mixed(method, 12);
        check(r);
        choose_window(60);
        add_mixed(method, 4);
        check(r);
        remesher_free(r);
    }
}

static void the_sparse_owner_serves_as_well(void **state) {
    (void)state;
    inverse *sparse;
    report why;
    assert_int_equal(inverse_create_sparse(&body.tissue, SPARSE_CACHE, &sparse, &why), TROCAR_OK);
    with_tissue(&body.tissue, sparse, check_with_all);
    inverse_free(sparse);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ids_tell_nodes_apart),
        cmocka_unit_test(nodes_that_stay_keep_their_place),
        cmocka_unit_test(the_sparse_owner_serves_as_well),
        cmocka_unit_test(full_inverse_methods_need_the_dense_owner),
    };
    return cmocka_run_group_tests(tests, remeshing_create, remeshing_destroy);
}
