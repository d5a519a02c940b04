/* Tests what all remeshing methods share: slots, ids and refusals. Each method also has a test of its own. */
#include "remeshing.h"

/* A replacement has the same index in the list but another id. The old node must be removed and the new one added. */
static void ids_are_unique(void **state) {
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

static void remaining_nodes_keep_their_index(void **state) {
    (void)state;
    remesher *r = start(REMESH_NESTED);
    choose_window(40);
    serve(r);
    before = snapshot;
    request.window_count = 50;
    memmove(request.window, request.window + 20, 20 * sizeof *request.window); /* drops the first 20 nodes */
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

static void full_inverse_methods_need_the_dense_inverse(void **state) {
    (void)state;
    inverse *sparse;
    trocar_error why = {""};
    assert_int_equal(inverse_create_sparse(&body.tissue, SPARSE_CACHE, &sparse, &why), TROCAR_OK);
    for (method = 0; method < REMESH_METHODS; method++) {
        remesher *r;
        trocar_status expected = remesh_needs_dense(method) ? TROCAR_BAD_INPUT : TROCAR_OK;
        assert_int_equal(remesher_create_by(sparse, method, &r, &why), expected);
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

static void sparse_inverse_gives_the_same_results(void **state) {
    (void)state;
    inverse *sparse;
    trocar_error why;
    assert_int_equal(inverse_create_sparse(&body.tissue, SPARSE_CACHE, &sparse, &why), TROCAR_OK);
    with_tissue(&body.tissue, sparse, check_with_all);
    inverse_free(sparse);
}

/* Checks that the blocks are correct after nodes have been prepared in advance while contact nodes are present, and after more nodes have been added. */
static void looking_ahead_changes_no_answer(void) {
    for (method = REMESH_NESTED; method <= REMESH_IMPLICIT; method++) {
        remesher *r = start(method);
        choose_window(10);
        add_mixed(method, 6);
        request.tip = v3(-0.1 * CUBE_EDGE, -0.2 * CUBE_EDGE, -0.15 * CUBE_EDGE);
        request.direction = v3_unit(v3(1, 1.1, 1.05));
        assert_false(remesher_look_ahead(r)); /* no request yet */
        serve(r);
        while (remesher_look_ahead(r)) continue;
        choose_window(60);
        add_mixed(method, 4);
        check(r);
        remesher_free(r);
    }
}

static void sparse_inverse_prefetches(void **state) {
    (void)state;
    inverse *sparse;
    trocar_error why;
    assert_int_equal(inverse_create_sparse(&body.tissue, SPARSE_CACHE, &sparse, &why), TROCAR_OK);
    with_tissue(&body.tissue, sparse, looking_ahead_changes_no_answer);
    inverse_free(sparse);
}

enum { HELD = CUBE_NODES / 2 };

/* Returns a condensed inverse for the lower half of `t`, read from its file, so that nothing has been factorised. */
static inverse *lower_half(tissue *t) {
    inverse *condensed = NULL;
    trocar_error notice, why = {""};
    char directory[] = "/tmp/test_remesh.XXXXXX", command[64];
    int held[HELD];
    for (int i = 0; i < HELD; i++) held[i] = i;
    assert_int_equal(tissue_assemble(&body.mesh, body.materials, body.fixed, STRAIN_BY_ELEMENT, t, &why), TROCAR_OK);
    assert_non_null(mkdtemp(directory));
    for (int starts = 0; starts < 2; starts++) {
        inverse_free(condensed);
        cholmod_free_factor(&t->factor, &t->common);
        assert_int_equal(inverse_create_condensed(t, &(condensed_region){.count = HELD, .nodes = held, .directory = directory}, &condensed, &notice, &why), TROCAR_OK);
    }
    assert_null(t->factor);
    snprintf(command, sizeof command, "rm -r %s", directory);
    assert_int_equal(system(command), 0);
    return condensed;
}

/* Nodes outside the condensed region need a factor of the whole matrix. Only requests from the tick justify computing it. */
static void check_costly_nodes(void) {
    remesher *r = start(REMESH_NESTED);
    int outside = CUBE_NODES - 1;
    request.window_count = 60;
    for (int i = 0; i < 60; i++) request.window[i] = CUBE_NODES - 1 - 2 * i;
    serve(r);
    int inside = 0;
    for (int k = 0; k < MAX_WINDOW; k++) inside += snapshot.window[k] >= 0;
    for (int k = 0; k < MAX_WINDOW; k++) assert_true(snapshot.window[k] < HELD);
    assert_null(tested->factor);
    assert_true(inside > 10);
    request.needed = 1;
    serve(r);
    bool there = false;
    for (int k = 0; k < MAX_WINDOW; k++) there |= snapshot.window[k] == outside;
    assert_true(there);
    remesher_free(r);
}

static void costly_nodes_are_skipped_unless_needed(void **state) {
    (void)state;
    tissue t;
    inverse *condensed = lower_half(&t);
    with_tissue(&t, condensed, check_costly_nodes);
    inverse_free(condensed);
    tissue_free(&t);
}

/* Returns an element whose nodes all lie inside the region, or all outside it. */
static int element_of(bool held) {
    for (int tet = 0;; tet++) {
        int found = 0;
        for (int c = 0; c < 4; c++) found += tested->mesh->tets[tet][c] < HELD;
        if (found == (held ? 4 : 0)) return tet;
    }
}

/* Checks that a node whose rows cannot be computed is not added, and that later answers are correct. */
static void check_refusals(void) {
    static const kind kinds[] = {INSIDE, ON_FACE};
    for (method = REMESH_NESTED; method <= REMESH_IMPLICIT; method++)
        for (int k = 0; k < 2; k++) {
            trocar_error why = {""};
            remesher *r = start(method);
            request.window_count = 30;
            for (int i = 0; i < 30; i++) request.window[i] = 2 * i;
            add_node(kinds[k], element_of(true), point_in(element_of(true), 0.1));
            check(r);
            add_node(kinds[k], element_of(false), point_in(element_of(false), 0.1));
            request.serial++;
            assert_int_equal(remesher_serve(r, &request, &snapshot, &why), TROCAR_BAD_INPUT);
            assert_non_null(strstr(why.text, "do not constrain the whole body"));
            request.wanted.count--;
            check(r);
            remesher_free(r);
        }
}

static void errors_of_the_inverse_are_reported(void **state) {
    (void)state;
    tissue t;
    inverse *condensed = lower_half(&t);
    cube_loosen(&t);
    with_tissue(&t, condensed, check_refusals);
    inverse_free(condensed);
    tissue_free(&t);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ids_are_unique),
        cmocka_unit_test(remaining_nodes_keep_their_index),
        cmocka_unit_test(sparse_inverse_gives_the_same_results),
        cmocka_unit_test(sparse_inverse_prefetches),
        cmocka_unit_test(costly_nodes_are_skipped_unless_needed),
        cmocka_unit_test(errors_of_the_inverse_are_reported),
        cmocka_unit_test(full_inverse_methods_need_the_dense_inverse),
    };
    return cmocka_run_group_tests(tests, remeshing_create, remeshing_destroy);
}
