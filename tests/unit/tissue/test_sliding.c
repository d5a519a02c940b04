/* Tests surfaces on which the tissue slides: which nodes are split, and the stiffness matrix, against exact solutions for uniform stress. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/lame.h"
#include "mesh/sliding_surface.h"
#include "public/cube_mesh.h"
#include "tissue/tissue.h"

#include <cmocka.h>

static const double TILT = 0.3;        /* the layers of nodes are z = constant + TILT x */
static const int CUT = 2;              /* layer of nodes in which the surface lies */
static const double PITCH = 0.008;     /* m, distance between the cube's nodes */
static trocar_error why;

static bool on_layer(int node) { return node / (SIDE * SIDE) == CUT; }
static int column(int node) { return node % SIDE; }
static int row(int node) { return node / SIDE % SIDE; }
static bool inside(int node) { return column(node) > 0 && column(node) < BOXES && row(node) > 0 && row(node) < BOXES; }

/* Makes the cube of two regions, "below" and "above" the surface "between", which is tilted. `part`: leaves out the triangles at the cube's edge. */
static void make_cube(mesh *m, bool part) {
    static cube_mesh cube;
    static int32_t region[CUBE_TETS], triangles[4 * CUBE_TETS][3], surface[4 * CUBE_TETS];
    static const char *const regions[] = {"below", "above"}, *const surfaces[] = {"between"};
    static const int FACE[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
    int count = 0;
    cube_create(&cube);
    for (int n = 0; n < CUBE_NODES; n++) cube.nodes[n][2] += TILT * cube.nodes[n][0];
    for (int t = 0; t < CUBE_TETS; t++) {
        region[t] = 0;
        for (int c = 0; c < 4; c++)
            if (cube.tets[t][c] / (SIDE * SIDE) > CUT) region[t] = 1;
        for (int f = 0; f < 4 && region[t] == 0; f++) {
            const int32_t *v = cube.tets[t];
            bool on = true, at_edge = false;
            for (int k = 0; k < 3; k++) {
                on = on && on_layer(v[FACE[f][k]]);
                at_edge = at_edge || !inside(v[FACE[f][k]]);
            }
            if (!on || (part && at_edge)) continue;
            for (int k = 0; k < 3; k++) triangles[count][k] = v[FACE[f][k]];
            surface[count++] = 0;
        }
    }
    trocar_mesh given = {.node_count = CUBE_NODES, .tet_count = CUBE_TETS, .nodes = cube.nodes[0], .tets = cube.tets[0], .region_count = 2, .regions = regions,
                         .tet_region = region, .triangle_count = count, .triangles = triangles[0], .triangle_surface = surface, .surface_count = 1, .surfaces = surfaces};
    if (mesh_from_arrays(&given, m, &why) != TROCAR_OK) fail_msg("%s", why.text);
}

static sliding_surface between(const mesh *m, const char *beside) {
    return (sliding_surface){mesh_find_group(m, "between", 2), beside ? mesh_find_group(m, beside, 3) : -1};
}

static void let_slide(mesh *m) {
    sliding_surface surface = between(m, "above");
    if (mesh_let_slide(m, 1, &surface, "cube", &why) != TROCAR_OK) fail_msg("%s", why.text);
}

/* ---- mesh ---------------------------------------------------------------------------------------------------------------- */

static bool in_group(const mesh *m, const char *name, int node) {
    const mesh_group *g = &m->groups[mesh_find_group(m, name, -1)];
    return bsearch(&node, g->nodes, (size_t)g->node_count, sizeof node, compare_nodes) != NULL;
}

static void both_sides_get_nodes_of_their_own(void **state) {
    (void)state;
    mesh m;
    make_cube(&m, false);
    let_slide(&m);
    assert_int_equal(m.node_count, CUBE_NODES + SIDE * SIDE);
    assert_int_equal(m.pair_count, SIDE * SIDE);
    for (int t = 0; t < m.tet_count; t++)
        for (int c = 0; c < 4; c++) { /* the copies replace the layer's nodes on one side only */
            int node = m.tets[t][c];
            assert_true(in_group(&m, m.region[t] == 0 ? "below" : "above", node));
            if (node >= CUBE_NODES || on_layer(node)) assert_false(in_group(&m, m.region[t] == 0 ? "above" : "below", node));
        }
    for (int n = CUBE_NODES; n < m.node_count; n++) {
        vec3 apart = v3_sub(m.nodes[n], m.nodes[m.original[n]]);
        assert_true(on_layer(m.original[n]) && v3_dot(apart, apart) == 0.0 && m.anatomical[n] && in_group(&m, "between", n));
        assert_true(m.node_size[n] == m.node_size[m.original[n]]);
    }
    mesh_free(&m);
}

static void pairs_have_the_surfaces_area_and_normal(void **state) {
    (void)state;
    mesh m;
    make_cube(&m, false);
    let_slide(&m);
    double side = BOXES * PITCH, area = side * side * sqrt(1.0 + TILT * TILT), sum = 0.0;
    vec3 normal = v3_unit(v3(-TILT, 0, 1));
    for (int i = 0; i < m.pair_count; i++) {
        const node_pair *pair = &m.pairs[i];
        bool up = in_group(&m, "below", pair->nodes[0]);
        assert_true(m.original[pair->nodes[0]] == m.original[pair->nodes[1]] && in_group(&m, up ? "above" : "below", pair->nodes[1]));
        assert_true(fabs(v3_dot(pair->normal, normal) - (up ? 1.0 : -1.0)) < 1e-12);
        sum += pair->area;
    }
    assert_true(fabs(sum - area) < 1e-12 * area);
    mesh_free(&m);
}

static void neighbours_across_the_surface_remain_but_are_not_bonded(void **state) {
    (void)state;
    mesh m, whole;
    make_cube(&whole, false);
    make_cube(&m, false);
    let_slide(&m);
    int slides = 0;
    for (int t = 0; t < m.tet_count; t++)
        for (int f = 0; f < 4; f++) {
            int other = m.neighbours[t][f];
            bool apart = other >= 0 && m.region[t] != m.region[other];
            assert_int_equal(other, whole.neighbours[t][f]);
            assert_int_equal(mesh_slides(&m, t, f), apart);
            assert_int_equal(mesh_bonded(&m, t, f), apart ? -1 : other);
            slides += apart;
        }
    assert_int_equal(slides, 4 * BOXES * BOXES);
    assert_int_equal(m.boundary_count, whole.boundary_count);
    for (int i = 0; i < m.boundary_count; i++)
        for (int k = 0; k < 3; k++) {
            const boundary_face *f = &m.boundary[i];
            bool used = false;
            for (int c = 0; c < 4; c++) used = used || m.tets[f->tet][c] == f->nodes[k];
            assert_true(used && m.original[f->nodes[k]] == whole.boundary[i].nodes[k]);
        }
    mesh_free(&m);
    mesh_free(&whole);
}

/* Around the rim of a surface that ends inside the tissue, the elements on both sides are still connected. */
static void nodes_at_the_rim_are_not_split(void **state) {
    (void)state;
    enum { INNER = BOXES - 3 };
    mesh m;
    make_cube(&m, true);
    let_slide(&m);
    assert_int_equal(m.node_count, CUBE_NODES + INNER * INNER);
    assert_int_equal(m.pair_count, INNER * INNER);
    for (int n = CUBE_NODES; n < m.node_count; n++) {
        int node = m.original[n];
        assert_true(column(node) > 1 && column(node) < BOXES - 1 && row(node) > 1 && row(node) < BOXES - 1);
    }
    mesh_free(&m);
}

static void a_surface_that_cannot_slide_is_refused(void **state) {
    (void)state;
    mesh m;
    make_cube(&m, false);
    for (int t = 0; t < m.tet_count; t++) m.region[t] = 0; /* the surface now lies within one region */
    sliding_surface surface = between(&m, NULL);
    assert_int_equal(mesh_let_slide(&m, 1, &surface, "cube", &why), TROCAR_BAD_INPUT);
    assert_string_equal(why.text, "sliding: no face of \"between\" in cube lies between two regions");
    mesh_free(&m);
}

/* ---- stiffness ------------------------------------------------------------------------------------------------------------ */

static const double NORMAL = 3e6; /* N/m^3, so soft that the overlap is as large as the tissue's deformation */

/* Uniform stress: pressure on the surface, stress in its plane below and above it, and shear along it (Pa). The stresses in the plane make the two sides slide
   by different distances at different places, so that only a surface without shear stiffness is then in equilibrium. */
static const struct { double pressure, in_plane[2], shear, shear_stiffness; } LOADS[] = {{400.0, {700.0, -500.0}, 0.0, 0.0}, {0.0, {0.0, 0.0}, 250.0, 2e6}};

static region_material material(int side) { return (region_material){.youngs_modulus = side ? 4e3 : 25e3, .poisson_ratio = side ? 0.3 : 0.45}; }

/* Returns the displacement. The two sides overlap by pressure / NORMAL and slide by shear / shear_stiffness. */
static vec3 exact(int load, int side, vec3 x) {
    vec3 n = v3_unit(v3(-TILT, 0, 1)), t = v3(0, 1, 0), b = v3_cross(n, t), from = v3_sub(x, v3(0, 0, CUT * PITCH));
    region_material m = material(side);
    double along_n = -LOADS[load].pressure, along_t = LOADS[load].in_plane[side], e = m.youngs_modulus, nu = m.poisson_ratio, height = v3_dot(n, from);
    vec3 u = v3_scale((along_n - nu * along_t) / e * height, n);
    u = v3_axpy((along_t - nu * along_n) / e * v3_dot(t, from), t, u);
    u = v3_axpy(-nu * (along_n + along_t) / e * v3_dot(b, from), b, u);
    u = v3_axpy(LOADS[load].shear / shear_modulus(e, nu) * height, b, u);
    if (side == 0) return u;
    u = v3_axpy(-LOADS[load].pressure / NORMAL, n, u);
    return LOADS[load].shear_stiffness > 0.0 ? v3_axpy(LOADS[load].shear / LOADS[load].shear_stiffness, b, u) : u;
}

static void check_equilibrium(int load, volumetric_strain strain) {
    mesh m;
    tissue t;
    make_cube(&m, false);
    let_slide(&m);
    region_material materials[MESH_MAX_GROUPS] = {[0] = material(0), [1] = material(1)};
    sliding_material sliding[MESH_MAX_GROUPS] = {[2] = {NORMAL, LOADS[load].shear_stiffness}};
    bool *fixed = calloc((size_t)m.node_count, sizeof *fixed);
    fixed[0] = true; /* tissue_define requires a fixed node; the body is translated so that this one stays where it is */
    if (tissue_define(&m, materials, fixed, strain, &t, &why) != TROCAR_OK) fail_msg("%s", why.text);
    t.sliding = sliding;
    if (tissue_stiffness(&t, &why) != TROCAR_OK) fail_msg("%s", why.text);
    cholmod_dense *u = cholmod_zeros((size_t)t.dof_count, 1, CHOLMOD_REAL, &t.common), *f = cholmod_zeros((size_t)t.dof_count, 1, CHOLMOD_REAL, &t.common);
    double one[2] = {1, 0}, zero[2] = {0, 0}, largest = 0.0;
    for (int n = 0; n < m.node_count; n++) {
        vec3 at = v3_sub(exact(load, in_group(&m, "above", n), m.nodes[n]), exact(load, 0, m.nodes[0]));
        if (t.dof[n] >= 0) memcpy((double *)u->x + t.dof[n], &at, sizeof at);
    }
    cholmod_sdmult(t.stiffness, 0, one, zero, u, f, &t.common);
    int checked = 0;
    for (int n = 0; n < m.node_count; n++) {
        const double *force = (double *)f->x + t.dof[n];
        int place = m.original[n], layer = place / (SIDE * SIDE);
        if (!inside(place) || layer == 0 || layer == BOXES) continue;
        for (int k = 0; k < 3; k++) largest = fmax(largest, fabs(force[k]));
        checked++;
    }
    print_message("%d nodes, largest force %.2g N\n", checked, largest);
    assert_int_equal(checked, (BOXES - 1) * (BOXES - 1) * BOXES);
    assert_true(largest < 1e-9 * PITCH * PITCH * (LOADS[load].pressure + LOADS[load].shear));
    cholmod_free_dense(&u, &t.common);
    cholmod_free_dense(&f, &t.common);
    tissue_free(&t);
    free(fixed);
    mesh_free(&m);
}

static void uniform_stress_is_an_equilibrium(void **state) {
    (void)state;
    for (int load = 0; load < 2; load++)
        for (int strain = STRAIN_BY_PATCH; strain <= STRAIN_BY_ELEMENT; strain++) check_equilibrium(load, (volumetric_strain)strain);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(both_sides_get_nodes_of_their_own),
        cmocka_unit_test(pairs_have_the_surfaces_area_and_normal),
        cmocka_unit_test(neighbours_across_the_surface_remain_but_are_not_bonded),
        cmocka_unit_test(nodes_at_the_rim_are_not_split),
        cmocka_unit_test(a_surface_that_cannot_slide_is_refused),
        cmocka_unit_test(uniform_stress_is_an_equilibrium),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
