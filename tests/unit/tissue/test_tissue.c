/* Compares the stiffness with closed-form results: energy of an element, patch test, bar in tension. Bodies without enough constraints must be refused. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "cube.h"
#include "reference.h"

#include <cmocka.h>

#include "check.h"

static vec3 random_vector(double size) { return cube_random_vector(size); }

/* Creates a random tetrahedron of positive volume that is not too flat. */
static void random_tet(vec3 x[4]) {
    vec3 gradients[4];
    do
        for (int i = 0; i < 4; i++) x[i] = random_vector(1.0);
    while (tet_gradients(x, gradients) < 0.05);
}

/* ---- the element ---- */

static void rigid_motions_need_no_force(void **state) {
    (void)state;
    for (int n = 0; n < 100; n++) {
        vec3 x[4], shift = random_vector(1.0), turn = random_vector(1.0);
        double k[12][12], u[12];
        random_tet(x);
        tet_stiffness(x, 2.0, 0.4, k);
        for (int i = 0; i < 4; i++) {
            vec3 moved = v3_add(shift, v3_cross(turn, x[i]));
            memcpy(u + 3 * i, &moved, sizeof moved);
        }
        for (int p = 0; p < 12; p++) {
            double force = 0.0;
            for (int q = 0; q < 12; q++) force += k[p][q] * u[q];
            assert_close(force, 0.0, 1e-11);
        }
    }
}

/* Returns the energy per volume, mu eps:eps + lambda/2 tr(eps)^2, of the displacement u = G x, where eps is the symmetric part of G. */
static double energy_density(double g[3][3], double e, double nu) {
    double mu = e / 2.0 / (1.0 + nu), bulk = e / 3.0 / (1.0 - 2.0 * nu), lambda = bulk - 2.0 / 3.0 * mu;
    double trace = g[0][0] + g[1][1] + g[2][2], square = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) square += 0.25 * (g[i][j] + g[j][i]) * (g[i][j] + g[j][i]);
    return mu * square + 0.5 * lambda * trace * trace;
}

static void linear_fields_store_the_energy_of_their_strain(void **state) {
    (void)state;
    for (int n = 0; n < 100; n++) {
        vec3 x[4];
        double g[3][3], k[12][12], u[12], unused[4][3], energy = 0.0;
        for (int i = 0; i < 9; i++) g[i / 3][i % 3] = cube_random(-1, 1);
        random_tet(x);
        tet_stiffness(x, 3.0, 0.45, k);
        for (int p = 0; p < 12; p++) u[p] = v3_dot(v3(g[p % 3][0], g[p % 3][1], g[p % 3][2]), x[p / 3]);
        for (int p = 0; p < 12; p++)
            for (int q = 0; q < 12; q++) energy += 0.5 * u[p] * k[p][q] * u[q];
        assert_close(energy / (reference_gradients(x, unused) * energy_density(g, 3.0, 0.45)), 1.0, 1e-11);
    }
}

static void element_equals_b_d_b(void **state) {
    (void)state;
    for (int n = 0; n < 100; n++) {
        vec3 x[4];
        double k[12][12], expected[12][12];
        random_tet(x);
        tet_stiffness(x, 5.0, 0.3, k);
        reference_element(x, 5.0, 0.3, expected);
        for (int p = 0; p < 12; p++)
            for (int q = 0; q < 12; q++) {
                assert_close(k[p][q], expected[p][q], 1e-11);
                assert_close(k[p][q], k[q][p], 1e-13);
            }
    }
}

/* ---- the membrane ---- */

static vec3 random_triangle(vec3 x[3]) {
    vec3 area;
    do {
        for (int i = 0; i < 3; i++) x[i] = random_vector(1.0);
        area = v3_scale(0.5, v3_cross(v3_sub(x[1], x[0]), v3_sub(x[2], x[0])));
    } while (v3_norm(area) < 0.05);
    return area;
}

static vec3 mapped(double g[3][3], vec3 x) {
    vec3 y;
    for (int i = 0; i < 3; i++) (&y.x)[i] = v3_dot(v3(g[i][0], g[i][1], g[i][2]), x);
    return y;
}

/* Returns the energy of nodal displacements. */
static double triangle_energy(double k[9][9], const vec3 u[3]) {
    double energy = 0.0;
    for (int p = 0; p < 9; p++)
        for (int q = 0; q < 9; q++) {
            energy += 0.5 * (&u[p / 3].x)[p % 3] * k[p][q] * (&u[q / 3].x)[q % 3];
            assert_close(k[p][q], k[q][p], 1e-13);
        }
    return energy;
}

/* The energy per area is that of plane stress: S / (2 (1 - nu^2)) (e11^2 + e22^2 + 2 nu e11 e22 + 2 (1 - nu) e12^2). Displacements along the normal store no
   energy. */
static void triangles_store_the_energy_of_plane_stress(void **state) {
    (void)state;
    for (int n = 0; n < 100; n++) {
        vec3 x[3], u[3], area = random_triangle(x), normal = v3_scale(1.0 / v3_norm(area), area);
        vec3 first = v3_scale(1.0 / v3_norm(v3_sub(x[1], x[0])), v3_sub(x[1], x[0])), second = v3_cross(normal, first);
        double nu = cube_random(0, 0.49), g[3][3], k[9][9];
        for (int i = 0; i < 9; i++) g[i / 3][i % 3] = cube_random(-1, 1);
        for (int i = 0; i < 3; i++) u[i] = v3_axpy(cube_random(-5, 5), normal, mapped(g, x[i]));
        vec3 along_first = mapped(g, first), along_second = mapped(g, second);
        double e11 = v3_dot(first, along_first), e22 = v3_dot(second, along_second), e12 = 0.5 * (v3_dot(first, along_second) + v3_dot(second, along_first));
        double expected = 7.0 / (2.0 * (1.0 - nu * nu)) * (e11 * e11 + e22 * e22 + 2.0 * nu * e11 * e22 + 2.0 * (1.0 - nu) * e12 * e12);
        triangle_stiffness(x, &(membrane_material){.stiffness = 7.0, .poisson_ratio = nu}, k);
        assert_close(triangle_energy(k, u) / (v3_norm(area) * expected), 1.0, 1e-10);
    }
}

static void turned_triangles_store_no_energy(void **state) {
    (void)state;
    for (int n = 0; n < 100; n++) {
        vec3 x[3], u[3], shift = random_vector(1.0), turn = random_vector(1.0);
        double k[9][9];
        random_triangle(x);
        triangle_stiffness(x, &(membrane_material){.stiffness = 7.0, .poisson_ratio = 0.3}, k);
        for (int i = 0; i < 3; i++) u[i] = v3_add(shift, v3_cross(turn, x[i]));
        assert_close(triangle_energy(k, u), 0.0, 1e-12);
    }
}

/* ---- the assembled body ---- */

static void make_uniform(cube *c, double e, double nu, volumetric_strain strain) {
    trocar_error why = {""};
    assert_int_equal(cube_shape(c, 0.1, &why), TROCAR_OK);
    c->materials[0] = c->materials[1] = (region_material){.youngs_modulus = e, .poisson_ratio = nu};
    if (tissue_create(&c->mesh, c->materials, c->fixed, strain, &c->tissue, &why) != TROCAR_OK) fail_msg("%s", why.text);
}

/* Solves K u = f, where f are the nodal forces that the stress `sigma` exerts on the outer surface. */
static cholmod_dense *solve_under_stress(cube *c, double sigma[3][3]) {
    tissue *t = &c->tissue;
    cholmod_dense *force = cholmod_zeros(t->dof_count, 1, CHOLMOD_REAL, &t->common);
    for (int b = 0; b < c->mesh.boundary_count; b++) {
        const int *nodes = c->mesh.boundary[b].nodes;
        vec3 p = c->mesh.nodes[nodes[0]], q = c->mesh.nodes[nodes[1]], r = c->mesh.nodes[nodes[2]];
        vec3 area = v3_scale(0.5, v3_cross(v3_sub(q, p), v3_sub(r, p))); /* outward */
        for (int i = 0; i < 3; i++)
            for (int a = 0; a < 3 && t->dof[nodes[i]] >= 0; a++)
                ((double *)force->x)[t->dof[nodes[i]] + a] += (sigma[a][0] * area.x + sigma[a][1] * area.y + sigma[a][2] * area.z) / 3.0;
    }
    cholmod_dense *u = cholmod_solve(CHOLMOD_A, t->factor, force, &t->common);
    cholmod_free_dense(&force, &t->common);
    return u;
}

/* Prescribes the stress of the displacement u = d z, which vanishes on the fixed face. The stress is constant, so any mesh must reproduce it exactly. */
static void check_patch_test(volumetric_strain strain) {
    cube c;
    double e = 20e3, nu = 0.45, mu = e / 2.0 / (1.0 + nu), lambda = e * nu / (1.0 + nu) / (1.0 - 2.0 * nu);
    make_uniform(&c, e, nu, strain);
    for (int n = 0; n < 5; n++) {
        vec3 d = random_vector(0.1);
        double sigma[3][3] = {{lambda * d.z, 0, mu * d.x}, {0, lambda * d.z, mu * d.y}, {mu * d.x, mu * d.y, (lambda + 2 * mu) * d.z}};
        cholmod_dense *u = solve_under_stress(&c, sigma);
        for (int i = 0; i < c.mesh.node_count; i++) {
            if (c.tissue.dof[i] < 0) continue;
            const double *x = (const double *)u->x + c.tissue.dof[i];
            assert_close_vector(v3(x[0], x[1], x[2]), v3_scale(c.mesh.nodes[i].z, d), 1e-13);
        }
        cholmod_free_dense(&u, &c.tissue.common);
    }
    cube_free(&c);
}

static void patch_test(void **state) {
    (void)state;
    check_patch_test(STRAIN_BY_PATCH);
    check_patch_test(STRAIN_BY_NODE);
    check_patch_test(STRAIN_BY_ELEMENT);
}

static void bar_in_tension_elongates_by_f_l_over_e_a(void **state) {
    (void)state;
    cube c;
    double pull = 3.0, e = 10e3; /* pull: N; e: Pa; with nu = 0, the fixed end does not disturb the stress */
    make_uniform(&c, e, 0.0, STRAIN_BY_ELEMENT);
    double sigma[3][3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, pull / (CUBE_EDGE * CUBE_EDGE)}};
    cholmod_dense *u = solve_under_stress(&c, sigma);
    for (int i = CUBE_NODES - CUBE_SIDE * CUBE_SIDE; i < CUBE_NODES; i++)
        assert_close(((double *)u->x)[c.tissue.dof[i] + 2], pull * CUBE_EDGE / (e * CUBE_EDGE * CUBE_EDGE), 1e-13);
    cholmod_free_dense(&u, &c.tissue.common);
    cube_free(&c);
}

/* ---- constraints ---- */

static void assert_refused(cube *c, volumetric_strain strain, const char *words) {
    trocar_error why = {""};
    assert_int_equal(tissue_create(&c->mesh, c->materials, c->fixed, strain, &c->tissue, &why), TROCAR_BAD_INPUT);
    if (!strstr(why.text, words)) fail_msg("\"%s\" lacks \"%s\"", why.text, words);
}

/* K is singular if too few nodes are fixed. If elements had no stiffness against some kind of strain, it would be singular in more cases. */
static void check_loose_bodies(volumetric_strain strain) {
    cube c;
    trocar_error why;
    assert_int_equal(cube_shape(&c, 0.1, &why), TROCAR_OK);
    memset(c.fixed, 0, sizeof c.fixed);
    assert_refused(&c, strain, "no node is fixed");
    for (int i = 0; i < CUBE_NODES; i += 17) { /* the body can rotate about this single fixed node */
        c.fixed[i] = true;
        assert_refused(&c, strain, "do not constrain");
        for (int j = 3; j < CUBE_NODES; j += 29) { /* the body can rotate about the line through the two fixed nodes */
            if (i == j) continue;
            c.fixed[j] = true;
            assert_refused(&c, strain, "do not constrain");
            c.fixed[j] = false;
        }
        c.fixed[i] = false;
    }
    c.fixed[0] = c.fixed[CUBE_CELLS] = c.fixed[CUBE_NODES - 1] = true; /* three fixed nodes that are not in line are enough */
    assert_int_equal(tissue_create(&c.mesh, c.materials, c.fixed, strain, &c.tissue, &why), TROCAR_OK);
    tissue_free(&c.tissue);
    memset(c.fixed, 1, sizeof c.fixed);
    assert_refused(&c, strain, "every node is fixed");
    cube_free(&c);
}

static void loose_bodies_are_refused(void **state) {
    (void)state;
    check_loose_bodies(STRAIN_BY_PATCH);
    check_loose_bodies(STRAIN_BY_ELEMENT);
}

/* Creates a mesh of two cubes that do not touch. */
static void pair_of(cube *one, cube *two, mesh *pair) {
    trocar_error why;
    assert_int_equal(cube_shape(one, 0.1, &why), TROCAR_OK);
    assert_int_equal(cube_shape(two, 0.1, &why), TROCAR_OK);
    *pair = (mesh){.node_count = 2 * CUBE_NODES, .tet_count = 2 * one->mesh.tet_count, .group_count = 2};
    memcpy(pair->groups, (mesh_group[2]){{.name = "a", .dimension = 3}, {.name = "b", .dimension = 3}}, 2 * sizeof(mesh_group));
    pair->nodes = malloc(pair->node_count * sizeof *pair->nodes);
    pair->tets = malloc(pair->tet_count * sizeof *pair->tets);
    pair->region = calloc(pair->tet_count, sizeof *pair->region);
    for (int i = 0; i < pair->node_count; i++)
        pair->nodes[i] = i < CUBE_NODES ? one->mesh.nodes[i] : v3_add(two->mesh.nodes[i - CUBE_NODES], v3(3 * CUBE_EDGE, 0, 0));
    for (int t = 0; t < pair->tet_count; t++)
        for (int v = 0; v < 4; v++)
            pair->tets[t][v] = t < one->mesh.tet_count ? one->mesh.tets[t][v] : CUBE_NODES + two->mesh.tets[t - one->mesh.tet_count][v];
    assert_int_equal(mesh_finish(pair, 0, NULL, NULL, "pair", &why), TROCAR_OK);
}

static void each_part_must_be_constrained(void **state) {
    (void)state;
    cube one, two;
    mesh pair;
    pair_of(&one, &two, &pair);
    bool fixed[2 * CUBE_NODES] = {0};
    tissue t;
    trocar_error why = {""};
    memcpy(fixed, one.fixed, sizeof one.fixed);
    assert_int_equal(tissue_create(&pair, one.materials, fixed, STRAIN_BY_ELEMENT, &t, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "every part of the mesh"));
    memcpy(fixed + CUBE_NODES, two.fixed, sizeof two.fixed);
    assert_int_equal(tissue_create(&pair, one.materials, fixed, STRAIN_BY_ELEMENT, &t, &why), TROCAR_OK);
    tissue_free(&t);
    mesh_free(&pair);
    cube_free(&one);
    cube_free(&two);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rigid_motions_need_no_force),
        cmocka_unit_test(linear_fields_store_the_energy_of_their_strain),
        cmocka_unit_test(element_equals_b_d_b), cmocka_unit_test(triangles_store_the_energy_of_plane_stress), cmocka_unit_test(turned_triangles_store_no_energy),
        cmocka_unit_test(patch_test),
        cmocka_unit_test(bar_in_tension_elongates_by_f_l_over_e_a),
        cmocka_unit_test(loose_bodies_are_refused),
        cmocka_unit_test(each_part_must_be_constrained),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
