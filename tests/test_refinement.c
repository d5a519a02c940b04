/* The refined mesh against plain search over its elements, and its displacements against a dense solve from scratch. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "cube.h"
#include "reference.h"

#include <cmocka.h>

#include "check.h"

static cube body;

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

static vec3 position(const refinement *r, int corner) {
    return corner >= 0 ? body.mesh.nodes[corner] : r->nodes[-1 - corner].position;
}

/* Nodes at random points: `each` in each of some elements, in turns. */
static void add_random(refinement *r, int each, int elements) {
    for (int i = 0; i < each; i++)
        for (int e = 0; e < elements; e++) {
            int tet = (37 * e + 11) % body.mesh.tet_count;
            int expected = r->count;
            assert_int_equal(refinement_add(&body.mesh, r, tet, cube_point(&body, tet, 0.0), expected + 1), expected);
        }
}

/* ---- where points are ---- */

/* `slack` of the weights: rounding of x over the height of the leaf, which shrinks fast where nodes crowd. */
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
    for (int q = 0; q < active; q++) { /* a leaf has no node inside */
        vec3 corners[4], gradients[4];
        for (int i = 0; i < 4; i++) corners[i] = position(r, p.corners[i]);
        tet_gradients(corners, gradients);
        double least = 1.0;
        for (int i = 0; i < 4; i++) least = fmin(least, 1.0 + v3_dot(gradients[i], v3_sub(r->nodes[q].position, corners[i])));
        assert_true(least < 1e-9 + slack);
    }
}

static void a_leaf_holds_its_point(void **state) {
    (void)state;
    refinement r = {0};
    add_random(&r, 12, 4);
    for (int n = 0; n < 4000; n++) {
        int tet = (37 * (n % 5) + 11) % body.mesh.tet_count; /* the fifth is whole */
        assert_leaf_holds(&r, n % (r.count + 1), tet, cube_point(&body, tet, 0.0), 1e-13);
    }
    for (int q = 0; q < r.count; q++) assert_leaf_holds(&r, r.count, r.nodes[q].tet, r.nodes[q].position, 1e-13);
}

static void an_added_node_is_the_point_that_was_asked_for(void **state) {
    (void)state;
    refinement r = {0};
    for (int n = 0; n < 20; n++) {
        int tet = 7 * n;
        vec3 x = cube_point(&body, tet, 0.03); /* not so near a face that it is shifted */
        refinement_add(&body.mesh, &r, tet, x, 100 + n);
        assert_close_vector(r.nodes[n].position, x, 1e-15);
        assert_int_equal(r.nodes[n].id, 100 + n);
        assert_int_equal(r.nodes[n].tet, tet);
    }
}

/* On vertices, edges and faces, twice each: shifted inside by a fraction of the leaf, so that nothing is flat. */
static void nodes_on_corners_edges_and_faces_break_nothing(void **state) {
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

static void a_full_refinement_takes_no_more(void **state) {
    (void)state;
    refinement r = {0};
    add_random(&r, 16, 4);
    assert_int_equal(r.count, MAX_CONTACTS);
    assert_int_equal(refinement_add(&body.mesh, &r, 0, cube_point(&body, 0, 0.1), 99), -1);
    assert_int_equal(r.count, MAX_CONTACTS);
}

/* ---- written out ---- */

static double volume_of(const refined_mesh *m, int tet) {
    const int *c = m->tets[tet];
    vec3 a = v3_sub(m->nodes[c[1]], m->nodes[c[0]]), b = v3_sub(m->nodes[c[2]], m->nodes[c[0]]), d = v3_sub(m->nodes[c[3]], m->nodes[c[0]]);
    return v3_dot(v3_cross(a, b), d) / 6.0;
}

static void children_fill_their_parent(void **state) {
    (void)state;
    refinement r = {0};
    refined_mesh out;
    report why;
    add_random(&r, 10, 5);
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

/* ---- displacements ---- */

static void check_displacement(const refinement *r, const reference *expected) {
    vec3 force[CUBE_NODES + MAX_CONTACTS], u[CUBE_NODES + MAX_CONTACTS];
    static double sum[3 * (CUBE_NODES + MAX_CONTACTS)];
    int nodes = CUBE_NODES + r->count;
    for (int i = 0; i < nodes; i++) force[i] = i % 3 ? cube_random_vector(1.0) : v3(0, 0, 0);
    static vec3 scratch[7 * (CUBE_NODES + MAX_CONTACTS)];
    refinement_displacement(body.inverse, r, force, force + CUBE_NODES, scratch, u, u + CUBE_NODES);
    double largest = 0.0;
    for (int i = 0; i < 3 * nodes; i++) {
        sum[i] = 0.0;
        for (int j = 0; j < 3 * nodes; j++)
            sum[i] += *reference_entry(expected, i / 3, i % 3, j / 3, j % 3) * (&force[j / 3].x)[j % 3];
        largest = fmax(largest, fabs(sum[i]));
    }
    for (int i = 0; i < nodes; i++) assert_close_vector(u[i], v3(sum[3 * i], sum[3 * i + 1], sum[3 * i + 2]), 1e-9 * largest);
}

static void displacements_equal_a_solve_from_scratch(void **state) {
    (void)state;
    static const int cases[4][2] = {{1, 1}, {12, 1}, {1, 30}, {5, 10}}; /* nodes in each element, elements; then, in every second case, on faces */
    for (int c = 0; c < 4; c++) {
        refinement r = {0};
        add_random(&r, cases[c][0], cases[c][1]);
        for (int i = 0; i < 10 && c % 2; i++) refinement_add_on_face(&body.mesh, &r, 37 * i + 11, cube_point(&body, 37 * i + 11, 0.0), 100 + i);
        reference expected;
        reference_create(&body.tissue, &r, &expected);
        for (int n = 0; n < 3; n++) check_displacement(&r, &expected);
        reference_free(&expected);
    }
}

/* The surplus is what a node moves with its leaf's corners held: the inverse of its own stiffness. */
static void surplus_is_the_inverse_of_the_nodes_own_stiffness(void **state) {
    (void)state;
    for (int n = 0; n < 50; n++) {
        refinement r = {0};
        int tet = 7 * n;
        const region_material *material = &body.materials[body.mesh.region[tet]];
        refinement_add(&body.mesh, &r, tet, cube_point(&body, tet, 0.02), 1);
        mat3 own = {{{0}}};
        for (int i = 0; i < 4; i++) {
            vec3 x[4];
            double k[12][12];
            for (int v = 0; v < 4; v++) x[v] = v == i ? r.nodes[0].position : body.mesh.nodes[body.mesh.tets[tet][v]];
            reference_element(x, material->youngs_modulus, material->poisson_ratio, k);
            for (int a = 0; a < 9; a++) own.m[a / 3][a % 3] += k[3 * i + a / 3][3 * i + a % 3];
        }
        leaf_point at = refinement_locate(&body.mesh, &r, 0, tet, r.nodes[0].position);
        mat3 d = surplus_compliance(&body.tissue, &r, tet, &at), product = m3_multiply(&d, &own);
        for (int a = 0; a < 9; a++) assert_close(product.m[a / 3][a % 3], a % 4 == 0 ? 1.0 : 0.0, 1e-10);
    }
}

static void surplus_vanishes_on_faces(void **state) {
    (void)state;
    refinement none = {0};
    leaf_point at = {{0, 0, 0, 0}, {0.3, 0.3, 0.4, 0.0}}, inside = {{0, 0, 0, 0}, {0.25, 0.25, 0.25, 0.25}};
    memcpy(at.corners, body.mesh.tets[50], sizeof at.corners);
    memcpy(inside.corners, body.mesh.tets[50], sizeof inside.corners);
    mat3 face = surplus_compliance(&body.tissue, &none, 50, &at), middle = surplus_compliance(&body.tissue, &none, 50, &inside);
    for (int a = 0; a < 3; a++) assert_true(face.m[a][a] >= 0.0 && face.m[a][a] < 1e-6 * middle.m[a][a]);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_leaf_holds_its_point),
        cmocka_unit_test(an_added_node_is_the_point_that_was_asked_for),
        cmocka_unit_test(nodes_on_corners_edges_and_faces_break_nothing),
        cmocka_unit_test(a_full_refinement_takes_no_more),
        cmocka_unit_test(children_fill_their_parent),
        cmocka_unit_test(displacements_equal_a_solve_from_scratch),
        cmocka_unit_test(surplus_is_the_inverse_of_the_nodes_own_stiffness),
        cmocka_unit_test(surplus_vanishes_on_faces),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
