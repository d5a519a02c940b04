/* Compares the change in K due to a contact node with the difference between the matrices assembled with and without it. With all changes applied, K must
   reproduce linear displacements. */
#include "remeshing.h"

#include "refinement/patch.h"

/* Assembles K of the mesh with the first `count` contact nodes. */
static void assemble(const refinement *all, int count, reference *r) {
    refinement some = *all;
    some.count = count;
    reference_build(tested, &some, r);
}

static int entry_of(int node) { return node >= 0 ? node : CUBE_NODES - 1 - node; }

/* Checks that the patch has every entry in which the two matrices differ, except in the rows and columns of fixed nodes. */
static void check_patch(int index) {
    static patch p;
    reference before, after;
    int places[CUBE_NODES + MAX_CONTACTS];
    patch_create(tested, &request.wanted, index, &p);
    assemble(&request.wanted, index, &before);
    assemble(&request.wanted, index + 1, &after);
    for (int i = 0; i < after.node_count; i++) places[i] = -1;
    for (int q = 0; q < p.count; q++) places[entry_of(p.nodes[q])] = q;
    for (int i = 0; i < 3 * after.node_count; i++)
        for (int j = 0; j < 3 * after.node_count; j++) {
            int row = i / 3, column = j / 3, old = before.node_count;
            if (after.fixed[row] || after.fixed[column]) continue;
            double expected = *reference_entry(&after, row, i % 3, column, j % 3), found = 0.0;
            if (row < old && column < old) expected -= *reference_entry(&before, row, i % 3, column, j % 3);
            if (places[row] >= 0 && places[column] >= 0) found = p.change[3 * places[row] + i % 3][3 * places[column] + j % 3];
            assert_close(found, expected, 1e-9 * fabs(*reference_entry(&after, row, 0, row, 0)));
        }
    reference_free(&before);
    reference_free(&after);
}

/* Checks that computing only the columns for an added node's own displacement gives the same as the whole patch. */
static void check_own_columns(int index) {
    static patch p;
    split_columns own;
    patch_create(tested, &request.wanted, index, &p);
    patch_own_columns(tested, &request.wanted, index, &own);
    assert_int_equal(own.count, p.count - 1);
    for (int q = 0; q < p.count; q++) {
        int place = 0;
        while (place < own.count && own.nodes[place] != p.nodes[q]) place++;
        assert_int_equal(place == own.count, q == p.count - 1);
        const mat3 *found = place < own.count ? &own.beside[place] : &own.own;
        for (int a = 0; a < 9; a++) assert_close(found->m[a / 3][a % 3], p.change[3 * q + a / 3][3 * p.count - 3 + a % 3], 1e-12 * fabs(own.own.m[0][0]));
    }
}

static void patch_equals_the_difference_of_two_meshes(void **state) {
    (void)state;
    memset(&request, 0, sizeof request);
    while (request.wanted.count < 24) {
        int tet = rand() % tested->mesh->tet_count, index = request.wanted.count;
        kind wanted = (kind)(index % 3);
        if (add_node(wanted, tet, point_in(tet, 0.02)) < 0) continue;
        bool inner = request.wanted.nodes[index].across_tet >= 0;
        if (wanted == ON_FACE && inner != (index % 2 == 0)) { /* alternately places nodes inside the body and on its surface */
            request.wanted.count--;
            continue;
        }
        check_patch(index);
        if (wanted != MOVED) check_own_columns(index);
    }
}

/* ---- linear fields ---- */

enum { MOST = CUBE_NODES + MAX_CONTACTS, HELD = CUBE_NODES - 1 };
static double stiffness[3 * MOST][3 * MOST]; /* K of all nodes; zero for the fixed node, which is the mesh's last */

static void add_nominal(const tissue *t) {
    const int *starts = t->stiffness->p, *rows = t->stiffness->i;
    const double *values = t->stiffness->x;
    memset(stiffness, 0, sizeof stiffness);
    for (int column = 0; column < t->dof_count; column++)
        for (int k = starts[column]; k < starts[column + 1]; k++) stiffness[rows[k]][column] = stiffness[column][rows[k]] = values[k];
}

static void add_patch(const tissue *t, int index) {
    static patch p;
    patch_create(t, &request.wanted, index, &p);
    for (int i = 0; i < 3 * p.count; i++)
        for (int j = 0; j < 3 * p.count; j++) stiffness[3 * entry_of(p.nodes[i / 3]) + i % 3][3 * entry_of(p.nodes[j / 3]) + j % 3] += p.change[i][j];
}

static bool within(vec3 x) {
    const double least = 1e-9, most = CUBE_EDGE - least;
    return fmin(x.x, fmin(x.y, x.z)) > least && fmax(x.x, fmax(x.y, x.z)) < most;
}

/* Returns the largest nodal force divided by Young's modulus (m^2) under a linear displacement that vanishes at the fixed node, over all nodes (`all`) or
   only over those inside the body. */
static double largest_force(const tissue *t, const mat3 *gradient, bool all) {
    vec3 at[MOST];
    int count = CUBE_NODES + request.wanted.count;
    double u[3 * MOST] = {0}, largest = 0.0;
    memcpy(at, body.mesh.nodes, CUBE_NODES * sizeof *at);
    for (int i = 0; i < request.wanted.count; i++) {
        const added_node *node = &request.wanted.nodes[i];
        at[CUBE_NODES + i] = node->position; /* not used by any element if the node was created by moving another */
        if (node->moved >= 0) at[node->moved] = node->position;
    }
    for (int i = 0; i < count; i++) {
        vec3 there = m3_apply(gradient, v3_sub(at[i], at[HELD]));
        memcpy(u + 3 * i, &there, sizeof there);
    }
    for (int i = 0; i < 3 * count; i++)
        if (all || within(at[i / 3])) largest = fmax(largest, fabs(cblas_ddot(3 * count, stiffness[i], 1, u, 1)));
    return largest / t->materials->youngs_modulus;
}

/* Checks that a rotation causes no force at any node, and uniform strain none at nodes inside the body. */
static void check_linear_fields(volumetric_strain volumetric, int kinds) {
    static const bool fixed[CUBE_NODES] = {[HELD] = true};
    static const mat3 turn = {{{0, -3, 2}, {3, 0, -1}, {-2, 1, 0}}}, strain = {{{2, 1, -1}, {1, -3, 2}, {-1, 2, 4}}};
    region_material even[2] = {body.materials[0], body.materials[0]};
    tissue t;
    trocar_error why;
    assert_int_equal(tissue_assemble(&body.mesh, even, fixed, volumetric, &t, &why), TROCAR_OK);
    tested = &t;
    memset(&request, 0, sizeof request);
    while (request.wanted.count < 30) {
        int tet = rand() % body.mesh.tet_count;
        add_node((kind)(request.wanted.count % kinds), tet, point_in(tet, 0.02));
    }
    add_nominal(&t);
    for (int i = 0; i < request.wanted.count; i++) add_patch(&t, i);
    assert_close(largest_force(&t, &turn, true), 0.0, 1e-12);
    assert_close(largest_force(&t, &strain, false), 0.0, 1e-12);
    assert_true(largest_force(&t, &strain, true) > 1e-5);
    tested = &body.tissue;
    tissue_free(&t);
}

static void linear_fields_match_the_refined_mesh(void **state) {
    (void)state;
    check_linear_fields(STRAIN_BY_ELEMENT, 3);
    check_linear_fields(STRAIN_BY_NODE, 2); /* nodes cannot be moved if strain is averaged at the nodes */
    check_linear_fields(STRAIN_BY_PATCH, 2);
}

/* ---- nodes added within a patch of averaged strain ---- */

/* Adds nodes alternately inside elements and on faces between two elements of the same patch. */
static void add_within_patches(const tissue *t, int count) {
    memset(&request, 0, sizeof request);
    while (request.wanted.count < count) {
        int tet = 7 * (rand() % 40), index = request.wanted.count; /* several nodes are in the same element */
        add_node((kind)(index % 2), tet, point_in(tet, 0.02));
        const added_node *node = &request.wanted.nodes[index];
        bool between = index % 2 == 1 && (node->across_tet < 0 || t->patch[node->across_tet] != t->patch[node->tet]);
        if (between) request.wanted.count--;
    }
}

/* The parts of a split element stay in its patch and do not change the patch's mean strain, so K equals the matrix assembled for the split mesh with all its
   nodes. */
static void split_elements_stay_in_their_patch(void **state) {
    (void)state;
    static const bool fixed[CUBE_NODES] = {[HELD] = true};
    tissue t;
    reference expected;
    trocar_error why;
    assert_int_equal(tissue_assemble(&body.mesh, body.materials, fixed, STRAIN_BY_PATCH, &t, &why), TROCAR_OK);
    tested = &t;
    add_within_patches(&t, 40);
    add_nominal(&t);
    for (int i = 0; i < request.wanted.count; i++) add_patch(&t, i);
    reference_refine(&t, &request.wanted, &expected);
    reference_assemble(&expected, true);
    reference_average_patches(&expected, &t, expected.nodes, expected.tet_count, expected.tets, expected.parent);
    for (int i = 0; i < 3 * expected.node_count; i++)
        for (int j = 0; j < 3 * expected.node_count; j++)
            if (i / 3 != HELD && j / 3 != HELD)
                assert_close(stiffness[i][j], *reference_entry(&expected, i / 3, i % 3, j / 3, j % 3),
                             1e-9 * fabs(*reference_entry(&expected, i / 3, i % 3, i / 3, i % 3)));
    reference_free(&expected);
    tested = &body.tissue;
    tissue_free(&t);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(patch_equals_the_difference_of_two_meshes),
        cmocka_unit_test(linear_fields_match_the_refined_mesh),
        cmocka_unit_test(split_elements_stay_in_their_patch),
    };
    return cmocka_run_group_tests(tests, remeshing_create, remeshing_destroy);
}
