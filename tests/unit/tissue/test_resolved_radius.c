/* Tests measuring the radius that a mesh resolves around a line. The exact fields must satisfy their differential equations, and the radii measured in
   patches must equal those measured in whole meshes. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include "tissue/exact_fields.h"
#include "tissue/resolved_radius.h"

#include <cmocka.h>

#include "check.h"

static const double NU = 0.37;

/* ---- exact fields ---------------------------------------------------------------------------------------------------- */

typedef vec3 (*displacement)(vec3 x);

static vec3 source = {0.1, -0.2, 0.7}, force;
static vec3 mindlin(vec3 x) { return mindlin_displacement(source, force, x, NU); }
static vec3 lateral(vec3 x) { return line_lateral(x.x, x.y, NU); }
static vec3 axial(vec3 x) { return line_axial(x.x, x.y); }

/* Returns the stress for a shear modulus of 1, by central differences. */
static mat3 stress(displacement u, vec3 x) {
    static const double h = 1e-5;
    const vec3 axes[] = {{h, 0, 0}, {0, h, 0}, {0, 0, h}};
    vec3 d[3];
    for (int j = 0; j < 3; j++) d[j] = v3_scale(0.5 / h, v3_sub(u(v3_add(x, axes[j])), u(v3_sub(x, axes[j]))));
    mat3 g = m3_columns(d[0], d[1], d[2]), s;
    double dilatation = g.m[0][0] + g.m[1][1] + g.m[2][2];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) s.m[i][j] = g.m[i][j] + g.m[j][i] + (i == j ? 2.0 * NU / (1.0 - 2.0 * NU) * dilatation : 0.0);
    return s;
}

static vec3 divergence(displacement u, vec3 x) {
    static const double h = 1e-3;
    const vec3 axes[] = {{h, 0, 0}, {0, h, 0}, {0, 0, h}};
    vec3 sum = {0};
    for (int j = 0; j < 3; j++) {
        mat3 front = stress(u, v3_add(x, axes[j])), back = stress(u, v3_sub(x, axes[j]));
        sum = v3_add(sum, v3_scale(0.5 / h, v3(front.m[0][j] - back.m[0][j], front.m[1][j] - back.m[1][j], front.m[2][j] - back.m[2][j])));
    }
    return sum;
}

static void mindlins_solution_is_in_equilibrium_below_a_free_surface(void **state) {
    (void)state;
    for (int k = 0; k < 3; k++) {
        force = v3(k == 0, k == 1, k == 2);
        mat3 s = stress(mindlin, v3(0.5, 0.3, 0.0));
        assert_close_vector(v3(s.m[0][2], s.m[1][2], s.m[2][2]), v3(0, 0, 0), 1e-8);
        assert_close_vector(divergence(mindlin, v3(0.5, 0.3, 0.4)), v3(0, 0, 0), 1e-4);
        vec3 offset = v3(0.4, 0.5, -0.3), deep = v3(0.1, -0.2, 1e5);
        vec3 kelvin = kelvin_displacement(v3(0, 0, 0), force, offset, NU);
        assert_close_vector(mindlin_displacement(deep, force, v3_add(deep, offset), NU), kelvin, 1e-4 * v3_norm(kelvin));
    }
}

static void line_forces_are_in_equilibrium_and_of_unit_size(void **state) {
    (void)state;
    const displacement fields[] = {lateral, axial};
    for (int k = 0; k < 2; k++) {
        int axis = k == 0 ? 0 : 2;
        vec3 x = v3(0.3, -0.4, 0.2), area = v3(0.2, 0.5, -0.7), sum = {0};
        assert_close_vector(divergence(fields[k], x), v3(0, 0, 0), 1e-4);
        mat3 s = stress(fields[k], x);
        assert_close_vector(line_traction(axis, x, area, NU), m3_apply(&s, area), 1e-8);
        for (int i = 0; i < 360; i++) {
            vec3 outward = v3(cos(i * M_PI / 180), sin(i * M_PI / 180), 0);
            sum = v3_add(sum, line_traction(axis, outward, v3_scale(M_PI / 180, outward), NU));
        }
        assert_close_vector(sum, v3(axis == 0 ? -1 : 0, 0, axis == 2 ? -1 : 0), 1e-12);
    }
    assert_close(line_lateral_radius(0.5 * (line_lateral(2.0, 0.0, NU).x + line_lateral(0.0, 2.0, NU).x), NU), 2.0, 1e-12);
    assert_close(line_axial_radius(line_axial(0.0, 2.0).z), 2.0, 1e-12);
}

/* ---- segments of a line ---- */

static const line_segment whole_line[] = {{0, -0.3, 0.5}, {1, -0.3, 0.5}, {2, -0.3, 0.5}};
static const line_segment *pushed;
static vec3 segment(vec3 x) { return segment_displacement(pushed, x, NU); }

static void segments_are_kelvins_solution_integrated(void **state) {
    (void)state;
    vec3 x = v3(0.3, -0.4, 0.2), area = v3(0.2, 0.5, -0.7);
    for (int axis = 0; axis < 3; axis++) {
        pushed = &whole_line[axis];
        vec3 unit = v3(axis == 0, axis == 1, axis == 2), sum = {0}, leaving = {0};
        enum { PARTS = 1000, RINGS = 200 };
        for (int i = 0; i < PARTS; i++) sum = v3_axpy(0.8 / PARTS, kelvin_displacement(v3(0, 0, -0.3 + 0.8 * (i + 0.5) / PARTS), unit, x, NU), sum);
        assert_close_vector(segment(x), sum, 1e-6 * v3_norm(sum));
        mat3 s = stress(segment, x);
        assert_close_vector(segment_traction(pushed, x, area, NU), m3_apply(&s, area), 1e-8);
        for (int i = 0; i < RINGS; i++) /* integrates over a sphere around the point */
            for (int j = 0; j < RINGS; j++) {
                double z = -1.0 + 2.0 * (i + 0.5) / RINGS, turn = 2.0 * M_PI * j / RINGS, rho = sqrt(1.0 - z * z);
                vec3 outward = v3(rho * cos(turn), rho * sin(turn), z);
                leaving = v3_add(leaving, segment_traction(pushed, outward, v3_scale(4.0 * M_PI / (RINGS * RINGS), outward), NU));
            }
        assert_close_vector(leaving, v3_scale(-0.8, unit), 1e-4);
    }
}

/* At its end, a half-infinite line moves the tissue half as far as an infinite one, so twice its field differs from the logarithm of the radius only by a
   constant. The fields of the parts of a line add up. */
static void half_a_line_moves_its_end_half_as_far(void **state) {
    (void)state;
    double near = segment_logarithm(0.0, 1e3, 0.5, NU), far = segment_logarithm(0.0, 1e3, 2.0, NU);
    assert_close(2.0 * (far - near), log(4.0), 1e-5);
    assert_close(segment_logarithm(0.0, 0.7, 0.5, NU) + segment_logarithm(0.7, 1e3, 0.5, NU), near, 1e-12);
    double sum = 0.0;
    enum { DIRECTIONS = 12 };
    pushed = &whole_line[0];
    for (int i = 0; i < DIRECTIONS; i++) sum += segment(v3(0.2 * cos(2 * M_PI * i / DIRECTIONS), 0.2 * sin(2 * M_PI * i / DIRECTIONS), -0.3)).x / DIRECTIONS;
    assert_close(segment_logarithm(0.0, 0.8, 0.2, NU), line_lateral_logarithm(sum, NU), 1e-12);
}

/* ---- the patch ------------------------------------------------------------------------------------------------------- */

enum { NX = 10, NZ = 8 };

typedef struct {
    mesh mesh;
    region_material materials[MESH_MAX_GROUPS];
    tissue tissue;
    resolver *resolver;
} block;

/* Creates Kuhn's structured mesh of 120 x 120 x 100 mm with 1089 nodes, scaled by `scale`. */
static void create(block *b, double scale, double youngs_modulus) {
    static const int orders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    static const char *const region[] = {"tissue"};
    enum { NODES = (NX + 1) * (NX + 1) * (NZ + 1), TETS = 6 * NX * NX * NZ };
    static double nodes[3 * NODES];
    static int32_t tets[4 * TETS];
    static bool fixed[NODES];
    for (int n = 0; n < NODES; n++) {
        nodes[3 * n] = scale * (0.012 * (n % (NX + 1)) - 0.06);
        nodes[3 * n + 1] = scale * (0.012 * (n / (NX + 1) % (NX + 1)) - 0.06);
        nodes[3 * n + 2] = scale * 0.0125 * (n / (NX + 1) / (NX + 1));
    }
    for (int t = 0; t < TETS; t++) {
        int cell = t / 6, at[3] = {cell % NX, cell / NX % NX, cell / NX / NX};
        for (int corner = 0; corner < 4; corner++) {
            tets[4 * t + corner] = at[0] + (NX + 1) * (at[1] + (NX + 1) * at[2]);
            if (corner < 3) at[orders[t % 6][corner]]++;
        }
    }
    trocar_error why;
    for (int i = 0; i < MESH_MAX_GROUPS; i++) b->materials[i] = (region_material){.youngs_modulus = youngs_modulus, .poisson_ratio = 0.45};
    for (int n = 0; n < NODES; n++) fixed[n] = n < (NX + 1) * (NX + 1);
    trocar_mesh given = {.node_count = NODES, .tet_count = TETS, .nodes = nodes, .tets = tets, .region_count = 1, .regions = region};
    assert_int_equal(mesh_from_arrays(&given, &b->mesh, &why), TROCAR_OK);
    assert_int_equal(tissue_assemble(&b->mesh, b->materials, fixed, STRAIN_BY_NODE, &b->tissue, &why), TROCAR_OK);
    assert_int_equal(resolver_create(&b->tissue, &b->resolver, &why), TROCAR_OK);
}

static void destroy(block *b) {
    resolver_free(b->resolver);
    tissue_free(&b->tissue);
    mesh_free(&b->mesh);
}

static resolved_field measure(block *b, vec3 x, vec3 direction) {
    trocar_error why;
    resolved_field field;
    int tet = mesh_locate(&b->mesh, x, -1);
    assert_true(tet >= 0);
    assert_int_equal(resolver_measure(b->resolver, tet, direction, 1, &x, &field, &why), TROCAR_OK);
    return field;
}

/* Returns the geometric mean of the radii, in units of h, over one period of the mesh along z. */
static resolved_field mean_along(block *b, double x, double y) {
    enum { POINTS = 10 };
    double h = cbrt(sqrt(2.0) * 0.012 * 0.012 * 0.0125), lateral_sum = 0.0, axial_sum = 0.0;
    mat3 uneven = {{{0}}};
    for (int i = 0; i < POINTS; i++) {
        resolved_field f = measure(b, v3(x, y, 0.0375 + 0.0125 * (i + 0.5) / POINTS), v3(0, 0, -1));
        lateral_sum += log(f.lateral / h);
        axial_sum += log(f.axial / h);
        m3_add_scaled(&uneven, 1.0 / POINTS, &f.uneven);
    }
    return (resolved_field){.uneven = uneven, .lateral = exp(lateral_sum / POINTS), .axial = exp(axial_sum / POINTS)};
}

/* The expected radii, in units of h, are those of the same lines on the whole mesh, computed by another program with the exact solution on the boundary. */
static void patches_measure_what_the_whole_mesh_resolves(void **state) {
    (void)state;
    static const struct { double x, y, lateral, axial; } whole[] = {{0, 0, 0.150, 0.175}, {0.003, 0, 0.289, 0.314}, {0.006, 0.006, 0.447, 0.474},
                                                                         {0.004, -0.002, 0.459, 0.478}, {0.0031, -0.0027, 0.464, 0.482}};
    block b;
    create(&b, 1.0, 20e3);
    for (size_t i = 0; i < sizeof whole / sizeof *whole; i++) {
        resolved_field f = mean_along(&b, whole[i].x, whole[i].y);
        assert_close(log(f.lateral / whole[i].lateral), 0.0, 0.09);
        assert_close(log(f.axial / whole[i].axial), 0.0, 0.09);
    }
    destroy(&b);
}

/* The expected values at a line's end, and 3 and 6 mm ahead of it, were computed on the whole mesh by tests/verification/references/line_end.py. For lines
   on edges, the tissue outside the 14 mm patch contributes 0.1. */
static void patches_measure_where_a_line_ends_what_the_whole_mesh_does(void **state) {
    (void)state;
    static const struct { double x, y, ahead, more, within; } whole[] = {
        {0, 0, 0.0, -0.027, 0.03}, {0, 0, 0.003, 0.351, 0.12}, {0, 0, 0.006, 0.340, 0.12},
        {0.0031, -0.0027, 0.0, -0.018, 0.03}, {0.0031, -0.0027, 0.003, 0.043, 0.03}, {0.0031, -0.0027, 0.006, 0.062, 0.03}};
    enum { POINTS = 10 };
    block b;
    create(&b, 1.0, 20e3);
    for (size_t i = 0; i < sizeof whole / sizeof *whole; i++) {
        double mean = 0.0;
        for (int k = 0; k < POINTS; k++) {
            resolved_field f = measure(&b, v3(whole[i].x, whole[i].y, 0.0375 + 0.0125 * (k + 0.5) / POINTS), v3(0, 0, -1));
            mean += line_end_at(&f.end, whole[i].ahead) / POINTS;
        }
        assert_close(mean, whole[i].more, whole[i].within);
    }
    resolved_field f = measure(&b, v3(0, 0, 0.05), v3(0, 0, -1));
    assert_true(line_end_at(&f.end, f.end.reach) == 0.0 && line_end_at(&f.end, INFINITY) == 0.0);
    assert_true(line_end_at(&(line_end){.more = {1, 1, 1, 1}}, -5e-7) == 0.0); /* the point is at the surface, with no tissue ahead of it */
    assert_true(line_end_at(&f.end, 0.0) == f.end.more[0] && line_end_at(&f.end, -1.0) == f.end.more[0]);
    destroy(&b);
}

/* Tests a line in a plane of mesh faces, y = 0, pushed within that plane and across it. */
static void directions_across_differ_as_on_the_whole_mesh(void **state) {
    (void)state;
    static const double within = 0.252, across = 0.331;
    block b;
    create(&b, 1.0, 20e3);
    resolved_field f = mean_along(&b, 0.003, 0.0);
    assert_close(log(f.lateral / within) + f.uneven.m[0][0], 0.0, 0.09);
    assert_close(log(f.lateral / across) + f.uneven.m[1][1], 0.0, 0.09);
    assert_close(f.uneven.m[0][0] + f.uneven.m[1][1], 0.0, 1e-12);
    assert_close(f.uneven.m[2][2], 0.0, 1e-12);
    resolved_field turned = mean_along(&b, 0.0, 0.003); /* must give the same, because the mesh is symmetric */
    assert_close(turned.uneven.m[1][1], f.uneven.m[0][0], 0.02);
    destroy(&b);
}

/* The radius scales with the mesh and does not depend on its stiffness. The compliance at a point, for a shear modulus of 1, scales inversely. */
static void radii_scale_with_the_mesh(void **state) {
    (void)state;
    block small, large;
    create(&small, 1.0, 20e3);
    create(&large, 3.0, 7e3);
    vec3 x = v3(0.0031, -0.0027, 0.05), direction = v3_unit(v3(0.2, 0.1, -1.0));
    resolved_field a = measure(&small, x, direction), b = measure(&large, v3_scale(3.0, x), direction);
    assert_close(b.lateral / a.lateral, 3.0, 1e-6);
    assert_close(b.axial / a.axial, 3.0, 1e-6);
    assert_close(a.point / b.point, 3.0, 1e-6);
    resolved_field back = measure(&small, x, v3_scale(-1.0, direction));
    assert_close(back.lateral / a.lateral, 1.0, 1e-9);
    assert_close(back.axial / a.axial, 1.0, 1e-9);
    assert_close(back.point / a.point, 1.0, 1e-9);
    destroy(&small);
    destroy(&large);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(mindlins_solution_is_in_equilibrium_below_a_free_surface),
        cmocka_unit_test(line_forces_are_in_equilibrium_and_of_unit_size),
        cmocka_unit_test(segments_are_kelvins_solution_integrated),
        cmocka_unit_test(half_a_line_moves_its_end_half_as_far),
        cmocka_unit_test(patches_measure_what_the_whole_mesh_resolves),
        cmocka_unit_test(patches_measure_where_a_line_ends_what_the_whole_mesh_does),
        cmocka_unit_test(directions_across_differ_as_on_the_whole_mesh),
        cmocka_unit_test(radii_scale_with_the_mesh),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
