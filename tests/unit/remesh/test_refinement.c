/* Compares point location in the refined mesh with a linear search over its elements. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "cube.h"
#include "refinement/refined_mesh.h"

#include <cmocka.h>

#include "check.h"
#include "oracles/refinement_move.h"

static cube body;

static int create(void **state) {
    (void)state;
    trocar_error why;
    return cube_create(&body, 0.1, &why) == TROCAR_OK ? 0 : -1;
}

static int destroy(void **state) {
    (void)state;
    cube_free(&body);
    return 0;
}

static vec3 position(const refinement *r, int corner) {
    return corner >= 0 ? body.mesh.nodes[corner] : r->nodes[-1 - corner].position;
}

/* ---- locating points ---- */

/* Checks that the leaf found for x contains it. `slack` allows for the rounding of x, which affects the weights most where nodes are dense and leaves are
   flat. */
static void assert_leaf_holds(const refinement *r, int active, int tet, vec3 x, double slack) {
    leaf_point p = refinement_locate(&body.mesh, r, active, tet, x);
    vec3 sum = v3(0, 0, 0);
    double total = 0.0;
    for (int i = 0; i < 4; i++) {
        assert_true(p.weights[i] >= -slack);
        assert_true(p.corners[i] >= -active);
        if (p.corners[i] < 0) assert_int_equal(r->nodes[-1 - p.corners[i]].tet, tet);
        sum = v3_axpy(p.weights[i], position(r, p.corners[i]), sum);
        total += p.weights[i];
    }
    assert_close(total, 1.0, 1e-13 + slack);
    assert_close_vector(sum, x, 1e-15);
    for (int q = 0; q < active; q++) { /* the leaf contains no active node */
        vec3 corners[4], gradients[4];
        for (int i = 0; i < 4; i++) corners[i] = position(r, p.corners[i]);
        tet_gradients(corners, gradients);
        double least = 1.0;
        for (int i = 0; i < 4; i++) least = fmin(least, 1.0 + v3_dot(gradients[i], v3_sub(r->nodes[q].position, corners[i])));
        assert_true(least < 1e-9 + slack);
    }
}

static void leaf_contains_its_point(void **state) {
    (void)state;
    refinement r = {0};
    cube_refine(&body, &r, 12, 4);
    for (int n = 0; n < 4000; n++) {
        int tet = (37 * (n % 5) + 11) % body.mesh.tet_count; /* one of the five elements is not refined */
        assert_leaf_holds(&r, n % (r.count + 1), tet, cube_point(&body, tet, 0.0), 1e-13);
    }
    for (int q = 0; q < r.count; q++) assert_leaf_holds(&r, r.count, r.nodes[q].tet, r.nodes[q].position, 1e-13);
}

static void added_node_is_at_the_requested_point(void **state) {
    (void)state;
    refinement r = {0};
    for (int n = 0; n < 20; n++) {
        int tet = 7 * n;
        vec3 x = cube_point(&body, tet, 0.03); /* far enough from the faces not to be shifted */
        refinement_add(&body.mesh, &r, tet, x, 100 + n);
        assert_close_vector(r.nodes[n].position, x, 1e-15);
        assert_int_equal(r.nodes[n].id, 100 + n);
        assert_int_equal(r.nodes[n].tet, tet);
    }
}

/* Nodes on vertices, edges and faces, two at each point, are shifted inwards by a fraction of the leaf's size, so that no element is flat. */
static void nodes_on_corners_edges_and_faces_are_handled(void **state) {
    (void)state;
    refinement r = {0};
    static const double at[5][4] = {{1, 0, 0, 0}, {0.5, 0.5, 0, 0}, {0, 0, 1, 0}, {0.3, 0.3, 0.4, 0}, {0, 0.5, 0, 0.5}};
    for (int n = 0; n < 10; n++) {
        vec3 x = mesh_point(&body.mesh, 200, at[n % 5]);
        refinement_add(&body.mesh, &r, 200, x, n + 1);
        assert_true(v3_norm(v3_sub(r.nodes[n].position, x)) < 0.08 * 2 * CUBE_EDGE / CUBE_CELLS);
        for (int i = 0; i < 4; i++) assert_true(r.nodes[n].at.weights[i] > 0.018);
        assert_leaf_holds(&r, r.count, 200, x, 1e-6);
    }
    for (int n = 0; n < 1000; n++) assert_leaf_holds(&r, r.count, 200, cube_point(&body, 200, 0.0), 1e-6);
}

static void full_refinement_rejects_nodes(void **state) {
    (void)state;
    refinement r = {0};
    cube_refine(&body, &r, 16, 4);
    assert_int_equal(r.count, MAX_CONTACTS);
    assert_int_equal(refinement_add(&body.mesh, &r, 0, cube_point(&body, 0, 0.1), 99), -1);
    assert_int_equal(r.count, MAX_CONTACTS);
}

/* ---- removal ---- */

/* Removes many nodes in a few elements one by one, in random order. The leaves must remain a partition, and no other node may move. */
static void removed_nodes_leave_the_others_where_they_are(void **state) {
    (void)state;
    refinement r = {0};
    cube_refine(&body, &r, 8, 4);
    for (int n = 0; n < 12; n++) refinement_add_on_face(&body.mesh, &r, 37 * (n % 4) + 11, cube_point(&body, 37 * (n % 4) + 11, 0.0), 100 + n);
    while (r.count > 0) {
        static refinement before;
        before = r;
        int position = (7 * r.count) % before.count, slot = before.order[position];
        assert_int_equal(refinement_remove(&body.mesh, &r, before.nodes[slot].id), slot);
        assert_int_equal(r.count, before.count - 1);
        for (int i = 0; i < r.count; i++) {
            int kept = before.order[i + (i >= position)];
            assert_int_equal(r.order[i], kept);
            assert_int_equal(r.nodes[kept].id, before.nodes[kept].id);
            assert_memory_equal(&r.nodes[kept].position, &before.nodes[kept].position, sizeof(vec3));
            assert_false(refinement_hangs_on(&r.nodes[kept], UINT64_C(1) << slot));
        }
        for (int n = 0; n < 100; n++) {
            int tet = 37 * (n % 4) + 11;
            vec3 x = cube_point(&body, tet, 0.0);
            leaf_point p = refinement_locate(&body.mesh, &r, r.count, tet, x);
            vec3 sum = v3(0, 0, 0);
            for (int i = 0; i < 4; i++) {
                assert_true(p.weights[i] > -1e-9);
                sum = v3_axpy(p.weights[i], refinement_position(&body.mesh, &r, r.count, p.corners[i]), sum);
            }
            assert_close_vector(sum, x, 1e-15);
        }
    }
}

static void freed_slots_are_used_again(void **state) {
    (void)state;
    refinement r = {0};
    cube_refine(&body, &r, 16, 4);
    assert_int_equal(refinement_remove(&body.mesh, &r, 12), 11);
    assert_int_equal(refinement_remove(&body.mesh, &r, 12), -1);
    assert_int_equal(refinement_remove(&body.mesh, &r, 4), 3);
    assert_int_equal(refinement_span(&r), MAX_CONTACTS);
    assert_int_equal(refinement_add(&body.mesh, &r, 300, cube_point(&body, 300, 0.1), 99), 3);
    assert_int_equal(refinement_add(&body.mesh, &r, 301, cube_point(&body, 301, 0.1), 100), 11);
    assert_int_equal(refinement_add(&body.mesh, &r, 302, cube_point(&body, 302, 0.1), 101), -1);
    assert_int_equal(refinement_find(&r, 100), MAX_CONTACTS - 1);
}

/* A node that was added after another had been moved may not fit into the mesh without that move. */
static void moved_nodes_go_last_first(void **state) {
    (void)state;
    refinement r = {0};
    int tet = 200, moved = -1;
    refinement_add(&body.mesh, &r, tet, cube_point(&body, tet, 0.1), 1);
    for (int n = 0; n < 500 && moved < 0; n++) moved = refinement_move(&body.tissue, &r, n, mesh_point(&body.mesh, n, (double[]){0.8, 0.1, 0.1, 0}), 2);
    assert_int_equal(moved, 1);
    assert_int_equal(refinement_remove(&body.mesh, &r, 1), -1);
    assert_int_equal(refinement_remove(&body.mesh, &r, 2), 1);
    assert_int_equal(refinement_remove(&body.mesh, &r, 1), 0);
}

/* ---- explicit mesh ---- */

static double volume_of(const refined_mesh *m, int tet) {
    const int *c = m->tets[tet];
    vec3 a = v3_sub(m->nodes[c[1]], m->nodes[c[0]]), b = v3_sub(m->nodes[c[2]], m->nodes[c[0]]), d = v3_sub(m->nodes[c[3]], m->nodes[c[0]]);
    return v3_dot(v3_cross(a, b), d) / 6.0;
}

static void children_partition_their_parent(void **state) {
    (void)state;
    refinement r = {0};
    refined_mesh out;
    trocar_error why;
    cube_refine(&body, &r, 10, 5);
    for (int i = 0; i < 4; i++) refinement_add(&body.mesh, &r, 11, body.mesh.nodes[body.mesh.tets[11][i]], 90 + i);
    assert_int_equal(refined_mesh_create(&body.mesh, &r, &out, &why), TROCAR_OK);
    assert_int_equal(out.node_count, CUBE_NODES + r.count);
    assert_int_equal(out.tet_count, body.mesh.tet_count + 3 * r.count);
    double *sum = calloc(body.mesh.tet_count, sizeof *sum);
    for (int e = 0; e < out.tet_count; e++) {
        assert_true(volume_of(&out, e) > 0);
        sum[out.parent[e]] += volume_of(&out, e);
    }
    for (int e = 0; e < body.mesh.tet_count; e++) assert_close(sum[e] / mesh_volume(&body.mesh, e), 1.0, 1e-12);
    free(sum);
    refined_mesh_free(&out);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(leaf_contains_its_point),
        cmocka_unit_test(added_node_is_at_the_requested_point),
        cmocka_unit_test(nodes_on_corners_edges_and_faces_are_handled),
        cmocka_unit_test(full_refinement_rejects_nodes),
        cmocka_unit_test(removed_nodes_leave_the_others_where_they_are),
        cmocka_unit_test(freed_slots_are_used_again),
        cmocka_unit_test(moved_nodes_go_last_first),
        cmocka_unit_test(children_partition_their_parent),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
