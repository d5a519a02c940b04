/* Tests the local compliance: it agrees with Kelvin's formulas on a uniform mesh and is continuous across faces, edges and nodes of an irregular one. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "cube.h"
#include "insertion/model/local_compliance.h"
#include "tissue/neighbourhood.h"

#include <cmocka.h>

#include "check.h"

static const double RADIUS = 0.635e-3;

static cube body;
static needle_model needle;
static insertion_model model;

static void create(double irregular, bool one_material) {
    trocar_error why;
    assert_int_equal(cube_shape(&body, irregular, &why), TROCAR_OK);
    if (one_material) body.materials[1] = body.materials[0];
    needle_parameters p = {.length = 0.2, .outer_diameter = 2 * RADIUS, .youngs_modulus = 200e9, .poisson_ratio = 0.3, .segments = 40};
    assert_int_equal(needle_create(&p, &needle, &why), TROCAR_OK);
    model = (insertion_model){.mesh = &body.mesh, .materials = body.materials, .needle = &needle};
    assert_int_equal(local_create(&model, &why), TROCAR_OK);
}

static void destroy(void) {
    local_free(&model);
    cube_free(&body);
}

static lateral_axial local_at(int tet, double resolved) {
    lateral_axial line = local_line_stiffness(&body.materials[body.mesh.region[tet]]), logarithm = local_logarithm(&model, &(resolved_field){.lateral = resolved, .axial = resolved});
    return (lateral_axial){logarithm.lateral / line.lateral, logarithm.axial / line.axial};
}

static void uniform_tissue_matches_kelvin(void **state) {
    (void)state;
    create(0.0, true);
    double e = body.materials[0].youngs_modulus, nu = body.materials[0].poisson_ratio, mu = e / (2.0 * (1.0 + nu));
    for (int n = 0; n < 200; n++) {
        int tet = rand() % body.mesh.tet_count;
        lateral_axial c = local_at(tet, 5.0 * RADIUS);
        assert_close(c.lateral / ((3 - 4 * nu) / (8 * M_PI * mu * (1 - nu)) * log(5.0)), 1.0, 1e-12);
        assert_close(c.axial / (log(5.0) / (2 * M_PI * mu)), 1.0, 1e-12);
    }
    destroy();
}

/* Where the mesh itself resolves the needle's surface, the correction is small. It is never negative. */
static void correction_is_small_on_fine_meshes(void **state) {
    (void)state;
    create(0.0, true);
    lateral_axial fine = local_at(0, 0.4 * RADIUS), coarse = local_at(0, 5.0 * RADIUS);
    assert_true(fine.lateral > 0 && fine.lateral < 0.03 * coarse.lateral);
    assert_true(fine.axial > 0 && fine.axial < 0.03 * coarse.axial);
    destroy();
}

/* Force per metre of displacement of a disc with a radius of 0.635 mm in tissue with E = 20 kPa and nu = 0.45, at the end of a hole and bonded to a surface.
   The values come from finite elements that resolve the disc (tests/verification/references/resolved_needle.json: tip_disc and skin_disc). The last
   argument, the mesh's compliance, is 0. */
static void single_tip_matches_resolved_disc(void **state) {
    (void)state;
    create(0.0, true);
    for (int g = 0; g < 2; g++) body.materials[g].youngs_modulus = 20e3, body.materials[g].poisson_ratio = 0.45;
    trocar_error why;
    local_free(&model);
    assert_int_equal(local_create(&model, &why), TROCAR_OK);
    double scale = RADIUS / 0.635e-3;
    vec3 x = cube_point(&body, 0, 0.1);
    assert_close(1.0 / local_at_tip(&model, 0, x, 0.02, 0.0, 0.0) / (47.5 * scale), 1.0, 0.05);
    assert_close(1.0 / local_at_tip(&model, 0, x, 0.0, 0.0, 0.0) / (32.2 * scale), 1.0, 0.05);
    assert_true(local_at_tip(&model, 0, x, 0.5 * RADIUS, 0.0, 0.0) < local_at_tip(&model, 0, x, 0.0, 0.0, 0.0));
    destroy();
}

static double along(plane_tensor t, double x, double y) { return x * x * t.xx + 2.0 * x * y * t.xy + y * y * t.yy; }

/* The compliance agrees with the formulas whatever the track's direction. */
static void directions_across_are_kept_apart(void **state) {
    (void)state;
    for (int n = 0; n < 200; n++) {
        double v[6];
        for (int i = 0; i < 6; i++) v[i] = rand() / (double)RAND_MAX - 0.5;
        vec3 direction = v3_unit(v3(v[0], v[1], v[2]));
        mat3 frame = frame_along(direction);
        plane_tensor sum = {2.0 + v[3], v[4], 2.0 + v[5]};
        principal_tensor t = plane_principal(sum, direction);
        assert_close(v3_dot(t.easy, direction), 0.0, 1e-12);
        assert_close(v3_norm(t.easy), 1.0, 1e-12);
        for (int i = 0; i < 36; i++) {
            double x = cos(i * M_PI / 36), y = sin(i * M_PI / 36);
            vec3 e = m3_apply(&frame, v3(x, y, 0));
            double easily = v3_dot(e, t.easy), whole = t.least + t.more * easily * easily;
            assert_close(whole, along(sum, x, y), 1e-12);
        }
    }
}

/* Returns the local compliance of a tip 20 mm deep, with force on its end face only. */
static double tip_at(int tet, vec3 x) { return local_at_tip(&model, tet, x, 0.02, 0.0, 0.0); }

static void continuous_across_faces(void **state) {
    (void)state;
    create(0.1, false);
    for (int t = 0; t < body.mesh.tet_count; t++)
        for (int face = 0; face < 4; face++) {
            int across = body.mesh.neighbours[t][face];
            if (across < 0) continue;
            double w[4] = {0.2, 0.3, 0.4, 0.1};
            w[(face + 1) % 4] += w[face];
            w[face] = 0.0;
            vec3 on = mesh_point(&body.mesh, t, w), inside = v3_unit(v3_sub(body.mesh.nodes[body.mesh.tets[t][face]], on));
            assert_close(tip_at(t, on) / tip_at(across, on), 1.0, 1e-12);
            /* moving the point by a micrometre either way may change the value only in proportion */
            assert_close(tip_at(t, v3_axpy(1e-6, inside, on)) / tip_at(across, v3_axpy(-1e-6, inside, on)), 1.0, 2e-3);
        }
    destroy();
}

static bool has_corner(int tet, int node) {
    for (int i = 0; i < 4; i++)
        if (body.mesh.tets[tet][i] == node) return true;
    return false;
}

/* All tetrahedra around an edge give the same value at a point on the edge, and all tetrahedra around a node give the same value at the node. */
static void unique_values_at_edges_and_nodes(void **state) {
    (void)state;
    create(0.1, false);
    for (int n = 0; n < 200; n++) {
        int tet = rand() % body.mesh.tet_count, a = body.mesh.tets[tet][n % 4], b = body.mesh.tets[tet][(n + 1 + n / 4 % 3) % 4];
        double at = n % 5 == 0 ? 1.0 : 0.4; /* a weight of 1 puts the point on node a */
        vec3 x = v3_axpy(at, v3_sub(body.mesh.nodes[a], body.mesh.nodes[b]), body.mesh.nodes[b]);
        double here = tip_at(tet, x);
        int others = 0;
        for (int t = 0; t < body.mesh.tet_count; t++) {
            if (!has_corner(t, a) || (at < 1.0 && !has_corner(t, b))) continue;
            assert_close(tip_at(t, x) / here, 1.0, 1e-12);
            others += t != tet;
        }
        if (cube_inside(a % CUBE_SIDE) && cube_inside(a / CUBE_SIDE % CUBE_SIDE)) assert_true(others > 0);
    }
    destroy();
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(uniform_tissue_matches_kelvin),
        cmocka_unit_test(correction_is_small_on_fine_meshes),
        cmocka_unit_test(single_tip_matches_resolved_disc),
        cmocka_unit_test(directions_across_are_kept_apart),
        cmocka_unit_test(continuous_across_faces),
        cmocka_unit_test(unique_values_at_edges_and_nodes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
