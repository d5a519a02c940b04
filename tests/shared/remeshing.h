/* Compares a remeshing method's snapshots with the modified mesh, assembled and inverted from scratch. Shared by the tests of all methods. Include this file
   instead of cmocka.h. */
#ifndef TROCAR_TESTS_REMESHING_H
#define TROCAR_TESTS_REMESHING_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cblas.h>

#include "cube.h"
#include "reference.h"
#include "oracles/remesh_methods.h"

#include <cmocka.h>

#include "check.h"
#include "oracles/refinement_move.h"

enum { MOST_NODES = 1000 };

static cube body;
static const tissue *tested; /* tissue under test, by default the cube's */
static inverse *tested_inverse;
static compliance_snapshot snapshot, before;
static remesh_request request;

static int remeshing_create(void **state) {
    (void)state;
    trocar_error why;
    openblas_set_num_threads(1);
    tested = &body.tissue;
    if (cube_create(&body, 0.1, &why) != TROCAR_OK) return -1;
    tested_inverse = body.inverse;
    return 0;
}

static int remeshing_destroy(void **state) {
    (void)state;
    cube_free(&body);
    return 0;
}

static remesher *start(remesh_method method) {
    remesher *r;
    trocar_error why = {""};
    if (remesher_create_by(tested_inverse, method, &r, &why) != TROCAR_OK) fail_msg("%s", why.text);
    memset(&request, 0, sizeof request);
    return r;
}

static void serve(remesher *r) {
    trocar_error why = {""};
    request.serial++;
    if (remesher_serve(r, &request, &snapshot, &why) != TROCAR_OK) fail_msg("%s", why.text);
}

/* Picks `count` different nodes in random order. */
static inline void choose_window(int count) {
    static int nodes[MOST_NODES];
    int all = tested->mesh->node_count;
    for (int i = 0; i < all; i++) nodes[i] = i;
    for (int i = 0; i < count; i++) {
        int other = i + rand() % (all - i), held = nodes[i];
        nodes[i] = nodes[other];
        nodes[other] = held;
    }
    memcpy(request.window, nodes, count * sizeof *nodes);
    request.window_count = count;
}

typedef enum { INSIDE, ON_FACE, MOVED } kind;

static int add_node(kind wanted, int tet, vec3 x) {
    static uint64_t id;
    switch (wanted) {
    case INSIDE: return refinement_add(tested->mesh, &request.wanted, tet, x, ++id);
    case ON_FACE: return refinement_add_on_face(tested->mesh, &request.wanted, tet, x, ++id);
    default: return refinement_move(tested, &request.wanted, tet, x, ++id);
    }
}

static vec3 point_in(int tet, double margin) {
    double w[4], sum = 0.0;
    for (int i = 0; i < 4; i++) sum += w[i] = cube_random(0.0, 1.0);
    for (int i = 0; i < 4; i++) w[i] = margin + (1.0 - 4.0 * margin) * w[i] / sum;
    return mesh_point(tested->mesh, tet, w);
}

/* Adds nodes of one kind in a few elements, several to each. */
static inline void add_nodes(kind wanted, int count) {
    for (int i = 0; i < count; i++) {
        int tet = (61 * (rand() % 6) + 3) % tested->mesh->tet_count;
        add_node(wanted, tet, point_in(tet, 0.0));
    }
}

/* Adds nodes of every kind that the method supports, some of them close to vertices and edges. */
static inline void add_mixed(remesh_method method, int count) {
    static const double at[4][4] = {{1, 0, 0, 0}, {0.5, 0.5, 0, 0}, {0.3, 0.3, 0.4, 0}, {0, 0.001, 0.999, 0}};
    for (int i = 0; i < count; i++) {
        int tet = rand() % 4 ? (61 * (rand() % 6) + 3) % tested->mesh->tet_count : rand() % tested->mesh->tet_count;
        vec3 x = rand() % 4 ? point_in(tet, 0.0) : mesh_point(tested->mesh, tet, at[rand() % 4]);
        kind wanted = (kind)(rand() % (method == REMESH_NESTED ? 2 : 3));
        if (add_node(wanted, tet, x) < 0) add_node(ON_FACE, tet, x);
    }
}

/* ---- comparison ---- */

/* Returns the refined mesh's node for a handle, or -1 if the handle is not in use. */
static int node_of(int handle) {
    if (handle >= MAX_CONTACTS) return snapshot.window[handle - MAX_CONTACTS];
    if (snapshot.ids[handle] == 0) return -1;
    int moved = request.wanted.nodes[handle].moved;
    return moved >= 0 ? moved : tested->mesh->node_count + refinement_find(&request.wanted, snapshot.ids[handle]);
}

static void assert_labels_right(void) {
    assert_int_equal(snapshot.serial, request.serial);
    int used = 0;
    for (int i = 0; i < MAX_CONTACTS; i++) used += snapshot.ids[i] != 0;
    assert_int_equal(used, request.wanted.count);
    for (int i = 0; i < request.wanted.count; i++) {
        int slot = request.wanted.order[i];
        assert_int_equal(snapshot.ids[slot], request.wanted.nodes[slot].id);
    }
    used = 0;
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
    reference_create(tested, &request.wanted, &expected);
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

static remesh_method method; /* under test */

static void check(remesher *r) {
    serve(r);
    assert_labels_right();
    assert_blocks_right(1e-8);
}

/* Adds and removes nodes at random while the window changes at random. */
static void snapshots_equal_an_inversion_from_scratch(void **state) {
    (void)state;
    remesher *r = start(method);
    for (int n = 0; n < 9; n++) {
        int removed = rand() % (request.wanted.count + 1);
        request.wanted.count -= n % 3 == 2 ? removed : removed / 4;
        add_mixed(method, rand() % 8);
        if (n % 2 == 0) choose_window(10 * n);
        check(r);
    }
    remesher_free(r);
}

/* Runs `test` on the prostate, or on a cube whose volumetric strain is averaged at the nodes. */
static inline void with_tissue(const tissue *t, inverse *inv, void (*test)(void)) {
    tested = t;
    tested_inverse = inv;
    test();
    tested = &body.tissue;
    tested_inverse = body.inverse;
}

static void check_averaged(void) {
    remesher *r = start(method);
    choose_window(40);
    add_nodes(ON_FACE, 12);
    add_nodes(INSIDE, 6);
    add_nodes(ON_FACE, 6);
    check(r);
    remesher_free(r);
}

static void check_averaged_by(volumetric_strain volumetric) {
    tissue t;
    inverse *inv;
    trocar_error why;
    assert_int_equal(tissue_create(&body.mesh, body.materials, body.fixed, volumetric, &t, &why), TROCAR_OK);
    assert_int_equal(inverse_create_dense(&t, (inverse_progress){0}, &inv, &why), TROCAR_OK);
    with_tissue(&t, inv, check_averaged);
    inverse_free(inv);
    tissue_free(&t);
}

/* Adding nodes does not change the mean strains at the nominal nodes. */
static void averaged_strain_is_the_nominal_mesh_s(void **state) {
    (void)state;
    check_averaged_by(STRAIN_BY_PATCH);
    check_averaged_by(STRAIN_BY_NODE);
}

static void check_among_fixed(void) {
    remesher *r = start(method);
    choose_window(20);
    for (int i = 0; i < 8; i++) {
        int tet = 11 * i; /* in the lowest layer */
        add_node(i % 2 ? ON_FACE : INSIDE, tet, point_in(tet, 0.1));
        if (method != REMESH_NESTED) assert_int_equal(add_node(MOVED, tet, point_in(tet, 0.1)), -1);
    }
    check(r);
    request.wanted.count = 4;
    check(r);
    remesher_free(r);
}

/* Adds nodes in elements whose corners are all fixed. */
static void nodes_among_fixed_ones(void **state) {
    (void)state;
    tissue t;
    inverse *inv;
    trocar_error why;
    bool fixed[CUBE_NODES];
    for (int n = 0; n < CUBE_NODES; n++) fixed[n] = n < 2 * CUBE_SIDE * CUBE_SIDE;
    assert_int_equal(tissue_create(&body.mesh, body.materials, fixed, STRAIN_BY_ELEMENT, &t, &why), TROCAR_OK);
    assert_int_equal(inverse_create_dense(&t, (inverse_progress){0}, &inv, &why), TROCAR_OK);
    with_tissue(&t, inv, check_among_fixed);
    inverse_free(inv);
    tissue_free(&t);
}

/* Adds nodes of one kind in the elements along a line, each at the midpoint of the line's segment in its element. */
static void add_track(vec3 from, vec3 to) {
    vec3 along = v3_sub(to, from);
    for (surface_hit at = mesh_enter(tested->mesh, from, to); at.tet >= 0;) {
        double chord;
        int face = mesh_exit(tested->mesh, at.tet, at.point, along, &chord);
        if (face < 0 || v3_dot(v3_sub(to, at.point), along) <= 0.0) return;
        if (chord * v3_norm(along) > 1e-3) {
            bool move = method != REMESH_NESTED && request.wanted.count % 3 == 0;
            vec3 end = v3_axpy(chord, along, at.point);
            if (!move || add_node(MOVED, at.tet, end) < 0)
                add_node(request.wanted.count % 2 ? INSIDE : ON_FACE, at.tet, request.wanted.count % 2 ? v3_axpy(0.5 * chord, along, at.point) : end);
        }
        at.point = v3_axpy(chord, along, at.point);
        at.tet = tested->mesh->neighbours[at.tet][face];
    }
}

/* The tracks of two needles cross in the gland, so their nodes share elements. */
static void check_tracks(void) {
    remesher *r = start(method);
    choose_window(60);
    add_track(v3(0.005, 0.003, -0.01), v3(0.004, 0.002, 0.08));
    int first = request.wanted.count;
    add_track(v3(-0.01, 0.003, -0.01), v3(0.02, 0.002, 0.08));
    assert_true(first > 8 && request.wanted.count > first + 8);
    check(r);
    request.wanted.count = first - 2;
    check(r);
    remesher_free(r);
}

static void two_tracks_in_the_prostate(void **state) {
    (void)state;
    mesh m;
    trocar_error why = {""};
    tissue t;
    inverse *inv;
    if (mesh_read(MESHES "/prostate-570.msh", &m, &why) != TROCAR_OK) fail_msg("%s", why.text);
    bool *fixed = calloc((size_t)m.node_count, sizeof *fixed);
    region_material materials[MESH_MAX_GROUPS];
    const mesh_group *held = &m.groups[mesh_find_group(&m, "fixed", 2)];
    for (int k = 0; k < held->node_count; k++) fixed[held->nodes[k]] = true;
    for (int g = 0; g < MESH_MAX_GROUPS; g++) materials[g] = (region_material){.youngs_modulus = 20e3 + 10e3 * g, .poisson_ratio = 0.45};
    assert_int_equal(tissue_create(&m, materials, fixed, STRAIN_BY_ELEMENT, &t, &why), TROCAR_OK);
    assert_int_equal(inverse_create_dense(&t, (inverse_progress){0}, &inv, &why), TROCAR_OK);
    with_tissue(&t, inv, check_tracks);
    inverse_free(inv);
    tissue_free(&t);
    mesh_free(&m);
    free(fixed);
}

static void full_window_and_all_contacts(void **state) {
    (void)state;
    static const kind kinds[] = {INSIDE, ON_FACE};
    for (int k = 0; k < 2; k++) {
        remesher *r = start(method);
        add_nodes(kinds[k], MAX_CONTACTS);
        choose_window(MAX_WINDOW);
        check(r);
        choose_window(MAX_WINDOW); /* a completely different window */
        request.wanted.count = 0;
        add_nodes(kinds[k], MAX_CONTACTS);
        check(r);
        remesher_free(r);
    }
}

/* Requests nodes at points that coincide with nodes, edges and faces of the mesh. */
static void nodes_aimed_at_corners_edges_and_faces(void **state) {
    (void)state;
    static const double at[4][4] = {{1, 0, 0, 0}, {0.5, 0.5, 0, 0}, {0.3, 0.3, 0.4, 0}, {0, 0, 0, 1}};
    for (kind k = INSIDE; k <= ON_FACE; k++) {
        remesher *r = start(method);
        choose_window(20);
        for (int n = 0; n < 4; n++) add_node(k, 100, mesh_point(&body.mesh, 100, at[n]));
        check(r);
        remesher_free(r);
    }
}

/* Nodes are added and removed many times while others stay. Those that stay are compared each time, and the original mesh at the end. */
static void removal_restores_the_original(void **state) {
    (void)state;
    remesher *r = start(method);
    choose_window(60);
    for (int stay = 2; stay >= 0; stay -= 2) {
        request.wanted.count = 0;
        for (int i = 0; i < stay; i++) add_node(i % 2 ? ON_FACE : INSIDE, 40 * i + 3, point_in(40 * i + 3, 0.1));
        serve(r);
        before = snapshot;
        for (int n = 0; n < 10; n++) {
            for (int i = rand() % 10; i >= 0; i--) {
                int tet = rand() % tested->mesh->tet_count;
                add_node((kind)(rand() % (method == REMESH_NESTED ? 2 : 3)), tet, point_in(tet, 0.05));
            }
            serve(r);
            request.wanted.count = stay;
            serve(r);
        }
        double largest = 0.0, worst = 0.0;
        assert_memory_equal(snapshot.window, before.window, sizeof before.window);
        for (int i = 0; i < SNAPSHOT_LD; i++)
            for (int j = 0; j < SNAPSHOT_LD; j++) {
                if (node_of(i / 3) < 0 || node_of(j / 3) < 0) continue;
                largest = fmax(largest, fabs(before.compliance[i * SNAPSHOT_LD + j]));
                worst = fmax(worst, fabs(snapshot.compliance[i * SNAPSHOT_LD + j] - before.compliance[i * SNAPSHOT_LD + j]));
            }
        assert_close(worst / largest, 0.0, 1e-12);
    }
    remesher_free(r);
}

/* Nodes that share elements and faces with others are removed in random order, and some are added in between. Those that stay keep their slots. */
static void nodes_go_in_any_order(void **state) {
    (void)state;
    remesher *r = start(method);
    choose_window(40);
    add_nodes(INSIDE, 8);
    add_nodes(ON_FACE, 10);
    add_nodes(INSIDE, 6);
    check(r);
    for (int n = 0; request.wanted.count > 0; n++) {
        uint64_t id = request.wanted.nodes[request.wanted.order[rand() % request.wanted.count]].id;
        before = snapshot;
        assert_true(refinement_remove(tested->mesh, &request.wanted, id) >= 0);
        assert_int_equal(refinement_find(&request.wanted, id), -1);
        if (n % 5 == 4) add_nodes(n % 2 ? INSIDE : ON_FACE, 1);
        if (n % 8 == 7) choose_window(40);
        serve(r);
        assert_labels_right();
        for (int i = 0; i < MAX_CONTACTS; i++)
            if (before.ids[i] != 0 && before.ids[i] != id) assert_int_equal(snapshot.ids[i], before.ids[i]);
        if (n % 3 == 0) assert_blocks_right(1e-9);
    }
    remesher_free(r);
}

/* Returns the interpolated displacement at one point of the nominal mesh under a force at another, from a matrix inverted from scratch. */
static mat3 nominal_between(const reference *nominal, const added_node *node, const added_node *other) {
    mat3 sum = {{{0}}};
    double w[4], v[4];
    mesh_barycentric(tested->mesh, node->tet, node->position, w);
    mesh_barycentric(tested->mesh, other->tet, other->position, v);
    for (int k = 0; k < 9 * 16; k++) {
        int i = k / 9 / 4, j = k / 9 % 4, a = k % 9 / 3, b = k % 3;
        sum.m[a][b] += w[i] * v[j] * *reference_entry(nominal, tested->mesh->tets[node->tet][i], a, tested->mesh->tets[other->tet][j], b);
    }
    return sum;
}

/* Contacts do not become more compliant when many nodes are added in one element, when nodes are added on faces, or when nodes are moved. */
static void contacts_yield_as_in_the_nominal_mesh(void **state) {
    (void)state;
    static const refinement none = {.count = 0};
    reference nominal;
    remesher *r = start(method);
    reference_create(tested, &none, &nominal);
    for (int n = 0; n < 9; n++) {
        if (n < 3 || n > 6) add_nodes(INSIDE, 9);
        else add_mixed(method, 9);
        if (n == 7) request.wanted.count = 0; /* from here on, nodes on faces are removed */
        if (n == 7) add_nodes(INSIDE, 12);
        for (int k = 0; k < 4; k++) refinement_remove(tested->mesh, &request.wanted, request.wanted.nodes[request.wanted.order[rand() % request.wanted.count]].id);
        serve(r);
        double largest = 0.0, worst = 0.0;
        for (int k = 0; k < request.wanted.count * request.wanted.count; k++) {
            int slot = request.wanted.order[k / request.wanted.count], other = request.wanted.order[k % request.wanted.count];
            mat3 found = compliance_between(&snapshot, slot, other), expected = nominal_between(&nominal, &request.wanted.nodes[slot], &request.wanted.nodes[other]);
            for (int a = 0; a < 9; a++) {
                largest = fmax(largest, fabs(expected.m[a / 3][a % 3]));
                worst = fmax(worst, fabs(found.m[a / 3][a % 3] - expected.m[a / 3][a % 3]));
            }
        }
        assert_close(worst / largest, 0.0, 1e-8);
    }
    reference_free(&nominal);
    remesher_free(r);
}

/* Runs all of these tests with each of the given methods. */
static inline int run_remeshing_tests(const remesh_method *methods, int count) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(snapshots_equal_an_inversion_from_scratch),
        cmocka_unit_test(averaged_strain_is_the_nominal_mesh_s),
        cmocka_unit_test(nodes_among_fixed_ones),
        cmocka_unit_test(two_tracks_in_the_prostate),
        cmocka_unit_test(full_window_and_all_contacts),
        cmocka_unit_test(nodes_aimed_at_corners_edges_and_faces),
        cmocka_unit_test(removal_restores_the_original),
        cmocka_unit_test(nodes_go_in_any_order),
        cmocka_unit_test(contacts_yield_as_in_the_nominal_mesh),
    };
    int failed = 0;
    srand(1);
    for (int m = 0; m < count; m++) {
        method = methods[m];
        failed += cmocka_run_group_tests_name(remesh_name(method), tests, remeshing_create, remeshing_destroy);
    }
    return failed;
}

#endif
