/* Snapshots of both remeshing methods against the refined mesh assembled and inverted from scratch. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "cube.h"
#include "reference.h"
#include "remesh.h"

#include <cmocka.h>

#include "check.h"

static cube body;
static compliance_snapshot snapshot, before;
static remesh_request request;

static const remesh_method methods[] = {REMESH_NESTED, REMESH_WOODBURY};

static int create(void **state) {
    (void)state;
    report why;
    return cube_create(&body, 0.1, &why) == TROCAR_OK ? 0 : -1;
}

static int destroy(void **state) {
    (void)state;
    cube_free(&body);
    return 0;
}

static remesher *start(remesh_method method) {
    remesher *r;
    report why = {""};
    if (remesher_create(body.inverse, method, &r, &why) != TROCAR_OK) fail_msg("%s", why.text);
    memset(&request, 0, sizeof request);
    return r;
}

static void serve(remesher *r) {
    report why = {""};
    request.serial++;
    if (remesher_serve(r, &request, &snapshot, &why) != TROCAR_OK) fail_msg("%s", why.text);
}

/* `count` different nodes in random order. */
static void choose_window(int count) {
    int nodes[CUBE_NODES];
    for (int i = 0; i < CUBE_NODES; i++) nodes[i] = i;
    for (int i = 0; i < count; i++) {
        int other = i + rand() % (CUBE_NODES - i), held = nodes[i];
        nodes[i] = nodes[other];
        nodes[other] = held;
    }
    memcpy(request.window, nodes, count * sizeof *nodes);
    request.window_count = count;
}

/* Elements are few, so that several nodes share one. */
static void add_nodes(int count) {
    static uint64_t id;
    for (int i = 0; i < count; i++) {
        int tet = (61 * (rand() % 6) + 3) % body.mesh.tet_count;
        refinement_add(&body.mesh, &request.wanted, tet, cube_point(&body, tet, 0.0), ++id);
    }
}

/* ---- comparison ---- */

/* Node of a handle in the refined mesh, -1 where the handle is not in use. */
static int node_of(int handle) {
    if (handle >= MAX_CONTACTS) return snapshot.window[handle - MAX_CONTACTS];
    return handle < snapshot.added_count ? CUBE_NODES + handle : -1;
}

static void assert_labels_right(void) {
    assert_int_equal(snapshot.serial, request.serial);
    assert_int_equal(snapshot.added_count, request.wanted.count);
    for (int i = 0; i < snapshot.added_count; i++) assert_int_equal(snapshot.ids[i], request.wanted.nodes[i].id);
    int used = 0;
    for (int k = 0; k < MAX_WINDOW; k++) used += snapshot.window[k] >= 0;
    assert_int_equal(used, request.window_count);
    for (int i = 0; i < request.window_count; i++) {
        int found = 0;
        for (int k = 0; k < MAX_WINDOW; k++) found += snapshot.window[k] == request.window[i];
        assert_int_equal(found, 1);
    }
}

static void assert_blocks_right(double tolerance) {
    reference expected;
    reference_create(&body.tissue, &request.wanted, &expected);
    double largest = 0.0;
    for (int i = 0; i < expected.node_count; i++) largest = fmax(largest, *reference_entry(&expected, i, 0, i, 0));
    for (int i = 0; i < 3 * MAX_HANDLES; i++)
        for (int j = 0; j < 3 * MAX_HANDLES; j++) {
            int node = node_of(i / 3), other = node_of(j / 3);
            if (node < 0 || other < 0) continue;
            assert_close(snapshot.compliance[i * SNAPSHOT_LD + j], *reference_entry(&expected, node, i % 3, other, j % 3),
                         tolerance * largest);
        }
    reference_free(&expected);
}

/* ---- tests ---- */

static void snapshots_equal_an_inversion_from_scratch(void **state) {
    (void)state;
    for (int m = 0; m < 2; m++) {
        remesher *r = start(methods[m]);
        for (int n = 0; n < 12; n++) {
            int removed = rand() % (request.wanted.count + 1);
            request.wanted.count -= n % 3 == 2 ? removed : removed / 4;
            add_nodes(rand() % 8);
            if (n % 2 == 0) choose_window(8 * n);
            serve(r);
            assert_labels_right();
            assert_blocks_right(1e-8);
        }
        remesher_free(r);
    }
}

static void full_window_and_all_contacts(void **state) {
    (void)state;
    for (int m = 0; m < 2; m++) {
        remesher *r = start(methods[m]);
        add_nodes(MAX_CONTACTS);
        choose_window(MAX_WINDOW);
        serve(r);
        assert_labels_right();
        assert_blocks_right(1e-8);
        choose_window(MAX_WINDOW); /* another one, all at once */
        request.wanted.count = 0;
        add_nodes(MAX_CONTACTS);
        serve(r);
        assert_labels_right();
        assert_blocks_right(1e-8);
        remesher_free(r);
    }
}

/* A node that was asked for at a point on the tissue's own nodes, edges and faces. */
static void nodes_aimed_at_corners_edges_and_faces(void **state) {
    (void)state;
    static const double at[4][4] = {{1, 0, 0, 0}, {0.5, 0.5, 0, 0}, {0.3, 0.3, 0.4, 0}, {0, 0, 0, 1}};
    for (int m = 0; m < 2; m++) {
        remesher *r = start(methods[m]);
        choose_window(20);
        for (int n = 0; n < 4; n++)
            refinement_add(&body.mesh, &request.wanted, 100, mesh_point(&body.mesh, 100, at[n]), n + 1);
        serve(r);
        assert_blocks_right(1e-8);
        remesher_free(r);
    }
}

static void removal_restores_the_original(void **state) {
    (void)state;
    static const double tolerance[] = {1e-12, 1e-9};
    for (int m = 0; m < 2; m++) {
        remesher *r = start(methods[m]);
        choose_window(60);
        serve(r);
        before = snapshot;
        for (int n = 0; n < 20; n++) { /* in and out again, as often as one likes */
            add_nodes(1 + rand() % 20);
            serve(r);
            request.wanted.count = 0;
            serve(r);
        }
        double largest = 0.0;
        for (int i = 0; i < SNAPSHOT_LD; i++) largest = fmax(largest, before.compliance[i * SNAPSHOT_LD + i]);
        assert_memory_equal(snapshot.window, before.window, sizeof before.window);
        for (int i = 3 * MAX_CONTACTS; i < SNAPSHOT_LD; i++)
            for (int j = 3 * MAX_CONTACTS; j < SNAPSHOT_LD; j++)
                if (snapshot.window[i / 3 - MAX_CONTACTS] >= 0 && snapshot.window[j / 3 - MAX_CONTACTS] >= 0)
                    assert_close(snapshot.compliance[i * SNAPSHOT_LD + j], before.compliance[i * SNAPSHOT_LD + j], tolerance[m] * largest);
        remesher_free(r);
    }
}

/* A replaced node has the same place in the list but another id: it must be taken out and put in again. */
static void ids_tell_nodes_apart(void **state) {
    (void)state;
    for (int m = 0; m < 2; m++) {
        remesher *r = start(methods[m]);
        choose_window(10);
        add_nodes(5);
        serve(r);
        request.wanted.count = 3;
        add_nodes(2);
        serve(r);
        assert_labels_right();
        assert_blocks_right(1e-8);
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

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(snapshots_equal_an_inversion_from_scratch),
        cmocka_unit_test(full_window_and_all_contacts),
        cmocka_unit_test(nodes_aimed_at_corners_edges_and_faces),
        cmocka_unit_test(removal_restores_the_original),
        cmocka_unit_test(ids_tell_nodes_apart),
        cmocka_unit_test(nodes_that_stay_keep_their_place),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
