/* Tests the region of interest, as given in the scene and by default. */
#include "mesh/region_of_interest.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static mesh body;

static int read_body(void **state) {
    (void)state;
    trocar_error why;
    return mesh_read(MESHES "/prostate-570.msh", &body, &why) == TROCAR_OK ? 0 : -1;
}

static int free_body(void **state) {
    (void)state;
    mesh_free(&body);
    return 0;
}

static bool contains(const int *nodes, int count, int node) {
    for (int i = 0; i < count; i++)
        if (nodes[i] == node) return true;
    return false;
}

static void corridor_ends_at_its_end_points(void **state) {
    (void)state;
    roi_config given = {.from = v3(0.005, 0.003, 0.01), .to = v3(0.005, 0.003, 0.07), .radius = 0.02};
    int *nodes, count;
    trocar_error why;
    assert_int_equal(roi_find(&body, &given, -1, &nodes, &count, &why), TROCAR_OK);
    int expected = 0;
    for (int i = 0; i < body.node_count; i++) { /* round ends */
        vec3 x = v3_sub(body.nodes[i], given.from);
        double past = x.z < 0.0 ? x.z : x.z > 0.06 ? x.z - 0.06 : 0.0;
        bool inside = hypot(hypot(x.x, x.y), past) <= 0.02;
        expected += inside;
        assert_true(contains(nodes, count, i) == inside);
    }
    assert_int_equal(count, expected);
    assert_true(count > 10 && count < body.node_count);
    free(nodes);
}

static void regions_and_corridor_are_joined(void **state) {
    (void)state;
    roi_config given = {.region_count = 1, .regions = {"prostate"}, .from = v3(0, 0, 0), .to = v3(0, 0, 0.03), .radius = 0.02};
    int *nodes, count, *gland_only, gland_count;
    trocar_error why;
    assert_int_equal(roi_find(&body, &given, -1, &nodes, &count, &why), TROCAR_OK);
    given.radius = 0.0;
    assert_int_equal(roi_find(&body, &given, -1, &gland_only, &gland_count, &why), TROCAR_OK);
    assert_int_equal(gland_count, body.groups[mesh_find_group(&body, "prostate", 3)].node_count);
    assert_true(count > gland_count);
    for (int i = 0; i < gland_count; i++) assert_true(contains(nodes, count, gland_only[i]));
    for (int i = 1; i < count; i++) assert_true(nodes[i - 1] < nodes[i]);
    free(nodes);
    free(gland_only);
}

static void empty_region_is_refused(void **state) {
    (void)state;
    int *nodes, count;
    trocar_error why;
    roi_config unknown = {.region_count = 1, .regions = {"liver"}}, outside = {.from = v3(1, 1, 1), .to = v3(1, 1, 2), .radius = 0.1};
    assert_int_equal(roi_find(&body, &unknown, -1, &nodes, &count, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "liver"));
    assert_int_equal(roi_find(&body, &outside, -1, &nodes, &count, &why), TROCAR_BAD_INPUT);
}

static void small_mesh_is_entirely_of_interest(void **state) {
    (void)state;
    roi_config nothing = {0};
    int *nodes, count;
    trocar_error why;
    assert_false(roi_given(&nothing));
    assert_int_equal(roi_find(&body, &nothing, -1, &nodes, &count, &why), TROCAR_OK);
    assert_int_equal(count, body.node_count);
    free(nodes);
}

/* Uses a box with its skin at z = 0 and more nodes than a default region contains. */
static void default_region_of_a_large_mesh_is_around_the_skin_normal(void **state) {
    (void)state;
    enum { CELLS = 16, SIDE = CELLS + 1 };
    static const int kuhn[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    mesh m = {.node_count = SIDE * SIDE * SIDE, .tet_count = 6 * CELLS * CELLS * CELLS, .group_count = 2};
    m.groups[0] = (mesh_group){.name = "tissue", .dimension = 3};
    m.groups[1] = (mesh_group){.name = "skin", .dimension = 2};
    m.nodes = malloc((size_t)m.node_count * sizeof *m.nodes);
    m.tets = malloc((size_t)m.tet_count * sizeof *m.tets);
    m.region = calloc((size_t)m.tet_count, sizeof *m.region);
    for (int n = 0; n < m.node_count; n++) m.nodes[n] = v3(0.01 * (n % SIDE), 0.01 * (n / SIDE % SIDE), 0.01 * (n / SIDE / SIDE));
    for (int t = 0; t < m.tet_count; t++) {
        int cell = t / 6, at[3] = {cell % CELLS, cell / CELLS % CELLS, cell / CELLS / CELLS};
        for (int corner = 0; corner < 4; corner++) {
            m.tets[t][corner] = at[0] + SIDE * (at[1] + SIDE * at[2]);
            if (corner < 3) at[kuhn[t % 6][corner]]++;
        }
    }
    int (*skin)[3] = malloc(2 * CELLS * CELLS * sizeof *skin), skin_group[2 * CELLS * CELLS], skin_count = 0;
    for (int t = 0; t < m.tet_count; t++) { /* tetrahedra with three nodes at z = 0 */
        int low[4], found = 0;
        for (int c = 0; c < 4; c++)
            if (m.tets[t][c] < SIDE * SIDE) low[found++] = m.tets[t][c];
        if (found != 3) continue;
        memcpy(skin[skin_count], low, sizeof *skin);
        skin_group[skin_count++] = 1;
    }
    trocar_error why;
    assert_int_equal(skin_count, 2 * CELLS * CELLS);
    assert_int_equal(mesh_finish(&m, skin_count, (const int (*)[3])skin, skin_group, "box", &why), TROCAR_OK);
    roi_config nothing = {0};
    int *nodes, count;
    assert_int_equal(roi_find(&m, &nothing, 1, &nodes, &count, &why), TROCAR_OK);
    assert_int_equal(count, REACH_USUAL);
    double inner = 0.0, outer = INFINITY; /* m, from the axis x = y = 0.08: farthest node inside the region, and nearest outside it */
    for (int i = 0, k = 0; i < m.node_count; i++) {
        double distance = hypot(m.nodes[i].x - 0.08, m.nodes[i].y - 0.08);
        if (k < count && nodes[k] == i) inner = fmax(inner, distance), k++;
        else outer = fmin(outer, distance);
    }
    assert_true(inner <= outer + 1e-12);
    free(nodes);
    assert_int_equal(roi_find(&m, &nothing, -1, &nodes, &count, &why), TROCAR_OK);
    assert_int_equal(count, 0);
    free(nodes);
    free(skin);
    mesh_free(&m);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(corridor_ends_at_its_end_points),
        cmocka_unit_test(regions_and_corridor_are_joined),
        cmocka_unit_test(empty_region_is_refused),
        cmocka_unit_test(small_mesh_is_entirely_of_interest),
        cmocka_unit_test(default_region_of_a_large_mesh_is_around_the_skin_normal),
    };
    return cmocka_run_group_tests(tests, read_body, free_body);
}
