/* Compares displacements of the refined mesh with a dense solution from scratch, and the surplus with the nodal stiffness it follows from. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "cube.h"
#include "reference.h"
#include "refinement/refined_field.h"

#include <cmocka.h>

#include "check.h"

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

static void check_displacement(const refinement *r, const reference *expected) {
    vec3 force[CUBE_NODES + MAX_CONTACTS], u[CUBE_NODES + MAX_CONTACTS];
    static double sum[3 * (CUBE_NODES + MAX_CONTACTS)];
    int nodes = CUBE_NODES + r->count;
    for (int i = 0; i < nodes; i++) force[i] = i % 3 ? cube_random_vector(1.0) : v3(0, 0, 0);
    static vec3 scratch[REFINED_FIELD_SCRATCH * (CUBE_NODES + MAX_CONTACTS)];
    refined_displacement(body.inverse, r, (refined_vectors){force, force + CUBE_NODES}, scratch, (refined_vectors){u, u + CUBE_NODES});
    double largest = 0.0;
    for (int i = 0; i < 3 * nodes; i++) {
        sum[i] = 0.0;
        for (int j = 0; j < 3 * nodes; j++)
            sum[i] += *reference_entry(expected, i / 3, i % 3, j / 3, j % 3) * (&force[j / 3].x)[j % 3];
        largest = fmax(largest, fabs(sum[i]));
    }
    for (int i = 0; i < nodes; i++) assert_close_vector(u[i], v3(sum[3 * i], sum[3 * i + 1], sum[3 * i + 2]), 1e-9 * largest);
}

static void displacements_match_a_direct_solve(void **state) {
    (void)state;
    static const int cases[4][2] = {{1, 1}, {12, 1}, {1, 30}, {5, 10}}; /* nodes per element, number of elements; in every other case, some nodes are on
                                                                           faces */
    for (int c = 0; c < 4; c++) {
        refinement r = {0};
        cube_refine(&body, &r, cases[c][0], cases[c][1]);
        for (int i = 0; i < 10 && c % 2; i++) refinement_add_on_face(&body.mesh, &r, 37 * i + 11, cube_point(&body, 37 * i + 11, 0.0), 100 + i);
        reference expected;
        reference_create(&body.tissue, &r, &expected);
        for (int n = 0; n < 3; n++) check_displacement(&r, &expected);
        reference_free(&expected);
    }
}

/* With the corners of its leaf fixed, a node's compliance is the surplus, so the surplus is the inverse of the node's own stiffness. */
static void surplus_is_the_inverse_of_the_nodal_stiffness(void **state) {
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
        cmocka_unit_test(displacements_match_a_direct_solve),
        cmocka_unit_test(surplus_is_the_inverse_of_the_nodal_stiffness),
        cmocka_unit_test(surplus_vanishes_on_faces),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
