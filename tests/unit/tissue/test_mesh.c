/* Compares the mesh functions with known results for a box and with a linear search over all elements. */
#include <float.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "mesh/mesh.h" /* before cmocka.h, whose macro hides `fail` */

#include <cmocka.h>

#include "check.h"

/* ---- a structured box, 6 tets (Kuhn) a cell; half of them inside out, their nodes in mixed order ---- */

enum { CELLS = 4 };
static const vec3 BOX = {0.08, 0.1, 0.12}; /* m, a box with one corner at the origin */

typedef struct { int count; int (*nodes)[3]; int *group; } triangle_list;

static int grid_node(int i, int j, int k) { return i + (CELLS + 1) * (j + (CELLS + 1) * k); }

static void fill_nodes(mesh *m) {
    int side = CELLS + 1;
    m->node_count = side * side * side;
    m->nodes = malloc(m->node_count * sizeof *m->nodes);
    for (int n = 0; n < m->node_count; n++)
        m->nodes[n] = v3(BOX.x * (n % side) / CELLS, BOX.y * (n / side % side) / CELLS, BOX.z * (n / side / side) / CELLS);
}

/* Splits each cell into Kuhn's six tetrahedra. Their nodes lie on the paths along the edges from one corner to the opposite one, one path for each order of
   the axes. */
static void fill_tets(mesh *m) {
    static const int orders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    m->tet_count = 6 * CELLS * CELLS * CELLS;
    m->tets = malloc(m->tet_count * sizeof *m->tets);
    m->region = calloc(m->tet_count, sizeof *m->region);
    for (int t = 0; t < m->tet_count; t++) {
        int cell = t / 6, at[3] = {cell % CELLS, cell / CELLS % CELLS, cell / CELLS / CELLS};
        for (int corner = 0; corner < 4; corner++) {
            m->tets[t][(corner + t) % 4] = grid_node(at[0], at[1], at[2]);
            if (corner < 3) at[orders[t % 6][corner]]++;
        }
    }
}

/* Returns whether x lies on the named surface: the face z = 0 for group 1 ("skin"), otherwise the inner plane halfway along x ("wall"). */
static bool on_surface(vec3 x, int group) { return group == 1 ? x.z == 0 : fabs(x.x - 0.5 * BOX.x) < 1e-12; }

static triangle_list surface_triangles(const mesh *m) {
    triangle_list list = {0, malloc(4 * m->tet_count * sizeof *list.nodes), malloc(4 * m->tet_count * sizeof *list.group)};
    for (int t = 0; t < m->tet_count; t++)
        for (int face = 0; face < 4; face++)
            for (int group = 1; group <= 2; group++) {
                int corners[3], n = 0, on = 0;
                for (int v = 0; v < 4; v++)
                    if (v != face) corners[n++] = m->tets[t][v];
                for (int v = 0; v < 3; v++) on += on_surface(m->nodes[corners[v]], group);
                if (on < 3) continue;
                memcpy(list.nodes[list.count], corners, sizeof corners);
                list.group[list.count++] = group;
            }
    return list;
}

static void draft_box(mesh *m) {
    memset(m, 0, sizeof *m);
    fill_nodes(m);
    fill_tets(m);
    m->group_count = 3;
    m->groups[0] = (mesh_group){.name = "block", .dimension = 3};
    m->groups[1] = (mesh_group){.name = "skin", .dimension = 2};
    m->groups[2] = (mesh_group){.name = "wall", .dimension = 2};
}

/* Creates the first `count` of three tetrahedra that share the face of nodes 0, 1 and 2. */
static void draft_fan(mesh *m, int count) {
    static const vec3 nodes[6] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, 0, -1}, {0.1, 0.1, 3}};
    *m = (mesh){.node_count = 3 + count, .tet_count = count, .group_count = 1, .groups = {{.name = "fan", .dimension = 3}}};
    m->nodes = malloc(m->node_count * sizeof *m->nodes);
    memcpy(m->nodes, nodes, m->node_count * sizeof *nodes);
    m->tets = malloc(count * sizeof *m->tets);
    m->region = calloc(count, sizeof *m->region);
    for (int t = 0; t < count; t++) memcpy(m->tets[t], (int[4]){0, 1, 2, 3 + t}, sizeof *m->tets);
}

static void drop_unused_nodes(mesh *m) {
    int *index = calloc(m->node_count, sizeof *index), kept = 0;
    for (int t = 0; t < m->tet_count; t++)
        for (int v = 0; v < 4; v++) index[m->tets[t][v]] = 1;
    for (int n = 0; n < m->node_count; n++)
        if (index[n]) {
            index[n] = kept;
            m->nodes[kept++] = m->nodes[n];
        }
    for (int t = 0; t < m->tet_count; t++)
        for (int v = 0; v < 4; v++) m->tets[t][v] = index[m->tets[t][v]];
    m->node_count = kept;
    free(index);
}

static trocar_status finish(mesh *m, trocar_error *why) { return mesh_finish(m, 0, NULL, NULL, "box", why); }

static void make_box(mesh *m) {
    draft_box(m);
    triangle_list list = surface_triangles(m);
    trocar_error why = {""};
    trocar_status status = mesh_finish(m, list.count, (const int(*)[3])list.nodes, list.group, "box", &why);
    free(list.nodes);
    free(list.group);
    if (status != TROCAR_OK) fail_msg("%s", why.text);
}

static double uniform(double low, double high) { return low + (high - low) * rand() / RAND_MAX; }

static vec3 random_point(double margin) {
    return v3(uniform(-margin, BOX.x + margin), uniform(-margin, BOX.y + margin), uniform(-margin, BOX.z + margin));
}

static bool in_box(vec3 x) { return x.x >= 0 && x.x <= BOX.x && x.y >= 0 && x.y <= BOX.y && x.z >= 0 && x.z <= BOX.z; }

/* ---- structure ---- */

static void tets_have_positive_volume_and_fill_the_box(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    double total = 0;
    for (int t = 0; t < m.tet_count; t++) {
        assert_true(mesh_volume(&m, t) > 0);
        total += mesh_volume(&m, t);
    }
    assert_close(total / (BOX.x * BOX.y * BOX.z), 1.0, 1e-12);
    mesh_free(&m);
}

static void neighbours_are_mutual_and_share_three_nodes(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    int outer = 0;
    for (int t = 0; t < m.tet_count; t++)
        for (int face = 0; face < 4; face++) {
            int other = m.neighbours[t][face], back = 0, shared = 0;
            if (other < 0 && ++outer) continue;
            for (int i = 0; i < 4; i++) {
                back += m.neighbours[other][i] == t;
                for (int v = 0; v < 4; v++) shared += v != face && m.tets[t][v] == m.tets[other][i];
            }
            assert_int_equal(back, 1);
            assert_int_equal(shared, 3);
        }
    assert_int_equal(outer, 6 * 2 * CELLS * CELLS); /* two triangles for each square on the box's six faces */
    assert_int_equal(m.boundary_count, outer);
    mesh_free(&m);
}

/* By the divergence theorem, the outward boundary encloses the box's volume, and its area vectors add up to zero. */
static void boundary_is_counter_clockwise_from_outside(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    double volume = 0;
    for (int b = 0; b < m.boundary_count; b++) {
        const int *v = m.boundary[b].nodes;
        vec3 p = m.nodes[v[0]], q = m.nodes[v[1]], r = m.nodes[v[2]];
        vec3 normal = v3_cross(v3_sub(q, p), v3_sub(r, p));
        vec3 outward = v3_sub(p, m.nodes[m.tets[m.boundary[b].tet][m.boundary[b].face]]);
        assert_true(v3_dot(normal, outward) > 0);
        volume += v3_dot(p, v3_cross(q, r)) / 6.0;
    }
    assert_close(volume / (BOX.x * BOX.y * BOX.z), 1.0, 1e-12);
    mesh_free(&m);
}

static void named_faces_are_marked_on_both_sides(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    int skin = 0, wall = 0;
    for (int t = 0; t < m.tet_count; t++)
        for (int face = 0; face < 4; face++)
            for (int group = 1; group <= 2; group++) {
                int on = 0;
                for (int v = 0; v < 4; v++) on += v != face && on_surface(m.nodes[m.tets[t][v]], group);
                assert_int_equal(m.face_groups[t][face] >> group & 1, on == 3);
                *(group == 1 ? &skin : &wall) += on == 3;
            }
    assert_int_equal(skin, 2 * CELLS * CELLS);
    assert_int_equal(wall, 2 * 2 * CELLS * CELLS); /* an inner surface has a tetrahedron on each side */
    assert_int_equal(mesh_find_group(&m, "wall", 2), 2);
    assert_int_equal(mesh_find_group(&m, "wall", -1), 2);
    assert_int_equal(mesh_find_group(&m, "wall", 3), -1);
    mesh_free(&m);
}

static void node_size_is_the_edge_of_the_regular_tet(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    double volume = BOX.x * BOX.y * BOX.z / (6 * CELLS * CELLS * CELLS); /* all tetrahedra have the same volume */
    for (int n = 0; n < m.node_count; n++) assert_close(m.node_size[n], cbrt(6 * sqrt(2) * volume), 1e-12);
    mesh_free(&m);
}

/* ---- points ---- */

static void gradients_reproduce_a_linear_field(void **state) {
    (void)state;
    vec3 corners[4] = {{0.1, 0, 0}, {1, 0.2, 0}, {0.3, 1, 0.1}, {0, 0.1, 2}}, slope = {3, -2, 0.5}, gradients[4], sum = {0, 0, 0};
    mat3 edges = m3_columns(v3_sub(corners[1], corners[0]), v3_sub(corners[2], corners[0]), v3_sub(corners[3], corners[0]));
    assert_close(tet_gradients(corners, gradients), m3_determinant(&edges) / 6, 1e-15);
    for (int i = 0; i < 4; i++) sum = v3_axpy(v3_dot(slope, corners[i]), gradients[i], sum);
    assert_true(v3_norm(v3_sub(sum, slope)) < 1e-14);
}

static void weights_reproduce_the_point(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    for (int i = 0; i < 1000; i++) {
        double w[4];
        int t = rand() % m.tet_count;
        vec3 x = random_point(0.05);
        mesh_barycentric(&m, t, x, w);
        assert_close(w[0] + w[1] + w[2] + w[3], 1.0, 1e-13);
        assert_true(v3_norm(v3_sub(mesh_point(&m, t, w), x)) < 1e-14);
    }
    mesh_free(&m);
}

/* Returns whether x is inside, judging by the signs of the four volumes between x and the faces. Does not use barycentric weights. */
static bool holds(const mesh *m, int t, vec3 x) {
    for (int i = 0; i < 4; i++) {
        vec3 c[4];
        for (int v = 0; v < 4; v++) c[v] = v == i ? x : m->nodes[m->tets[t][v]];
        if (v3_dot(v3_sub(c[1], c[0]), v3_cross(v3_sub(c[2], c[0]), v3_sub(c[3], c[0]))) < -1e-18) return false;
    }
    return true;
}

static void locate_finds_the_containing_tet(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    for (int i = 0; i < 3000; i++) {
        vec3 x = random_point(0.01);
        int t = mesh_locate(&m, x, i % 2 ? rand() % m.tet_count : -1);
        assert_int_equal(t >= 0, in_box(x));
        if (t >= 0) assert_true(holds(&m, t, x));
    }
    for (int n = 0; n < m.node_count; n++) { /* despite rounding, nodes are found inside the closed box */
        int t = mesh_locate(&m, m.nodes[n], rand() % m.tet_count);
        assert_true(t >= 0 && holds(&m, t, m.nodes[n]));
    }
    mesh_free(&m);
}

/* In a body with a slot, the straight walk ends at the slot, but a point behind it must still be found. */
static void locate_finds_the_far_side_of_a_slot(void **state) {
    (void)state;
    mesh m;
    draft_box(&m);
    int kept = 0;
    for (int t = 0; t < m.tet_count; t++) {
        int cell = t / 6, i = cell % CELLS, k = cell / CELLS / CELLS;
        if (i >= CELLS / 2 - 1 && i <= CELLS / 2 && k < CELLS - 1) continue; /* leaves a slot open at z = 0, which makes the body U-shaped */
        memmove(m.tets[kept++], m.tets[t], sizeof m.tets[t]);
    }
    m.tet_count = kept;
    drop_unused_nodes(&m);
    trocar_error why;
    assert_int_equal(finish(&m, &why), TROCAR_OK);
    vec3 left = v3(0.1 * BOX.x, 0.4 * BOX.y, 0.1 * BOX.z), right = v3(0.9 * BOX.x, 0.4 * BOX.y, 0.1 * BOX.z);
    int from = mesh_locate(&m, left, -1), to = mesh_locate(&m, right, from);
    assert_true(from >= 0 && holds(&m, from, left));
    assert_true(to >= 0 && holds(&m, to, right));
    assert_int_equal(mesh_locate(&m, v3(0.5 * BOX.x, 0.4 * BOX.y, 0.1 * BOX.z), from), -1);

    surface_hit hit = mesh_enter(&m, v3(0.5 * BOX.x, 0.4 * BOX.y, 0.1 * BOX.z), right); /* from inside the slot into the far leg */
    assert_true(hit.hit);
    assert_close(hit.point.x, 0.75 * BOX.x, 1e-14);
    vec3 before = v3(-BOX.x, left.y, left.z), behind = v3(2 * BOX.x, left.y, left.z); /* both legs are on the path; the hit is on the nearer one */
    assert_close(mesh_enter(&m, before, behind).point.x, 0, 1e-14);
    assert_close(mesh_enter(&m, behind, before).point.x, BOX.x, 1e-14);
    mesh_free(&m);
}

/* ---- rays ---- */

/* On a walk from face to face through the box, the lengths in the elements add up to the distance at which the line leaves the box. */
static void exit_walk_traverses_the_box(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    for (int i = 0; i < 500; i++) {
        vec3 x = random_point(-0.001), d = v3(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
        double leave = fmin(fmin((d.x > 0 ? BOX.x - x.x : -x.x) / d.x, (d.y > 0 ? BOX.y - x.y : -x.y) / d.y),
                            (d.z > 0 ? BOX.z - x.z : -x.z) / d.z);
        double walked = 0;
        int steps = 0;
        for (int t = mesh_locate(&m, x, -1); t >= 0; steps++) {
            double part;
            int face = mesh_exit(&m, t, v3_axpy(walked, d, x), d, &part);
            assert_in_range(face, 0, 3);
            walked += part;
            t = m.neighbours[t][face];
            assert_true(steps < m.tet_count);
        }
        assert_close(walked, leave, 1e-12);
    }
    double part;
    assert_int_equal(mesh_exit(&m, 0, v3(0, 0, 0), v3(0, 0, 0), &part), -1);
    mesh_free(&m);
}

static void start_slightly_outside_a_face_is_treated_as_on_it(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    double w[4] = {-1e-9, 0.4, 0.3, 0.3 + 1e-9}, distance = -1;
    vec3 x = mesh_point(&m, 0, w), away = v3_sub(x, m.nodes[m.tets[0][0]]);
    assert_int_equal(mesh_exit(&m, 0, x, away, &distance), 0);
    assert_close(distance, 0.0, 0.0);
    mesh_free(&m);
}

/* Returns the fraction of the segment at which it enters the whole box, computed by the slab method, or infinity. */
static double enters_box(vec3 a, vec3 b) {
    double from[3] = {a.x, a.y, a.z}, to[3] = {b.x, b.y, b.z}, size[3] = {BOX.x, BOX.y, BOX.z}, enter = -DBL_MAX, leave = DBL_MAX;
    for (int i = 0; i < 3; i++) {
        double s = (0 - from[i]) / (to[i] - from[i]), t = (size[i] - from[i]) / (to[i] - from[i]);
        enter = fmax(enter, fmin(s, t));
        leave = fmin(leave, fmax(s, t));
    }
    return enter <= leave && enter >= 0 && enter <= 1 ? enter : INFINITY;
}

static void segments_enter_at_the_surface_of_the_box(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    int hits = 0;
    for (int i = 0; i < 20000; i++) {
        vec3 a = random_point(0.1), b = random_point(0.1);
        double expected = enters_box(a, b);
        surface_hit hit = mesh_enter(&m, a, b);
        assert_int_equal(hit.hit, isfinite(expected));
        if (!hit.hit) continue;
        hits++;
        assert_close(hit.fraction, expected, 1e-12);
        assert_int_equal(m.neighbours[hit.tet][hit.face], -1);
        double w[4]; /* barycentric weights, which show that the hit is on the reported face */
        mesh_barycentric(&m, hit.tet, hit.point, w);
        for (int v = 0; v < 4; v++) assert_true(v == hit.face ? fabs(w[v]) < 1e-12 : w[v] > -1e-12);
    }
    assert_true(hits > 1000);
    mesh_free(&m);
}

/* Aims rays exactly at every node, edge and diagonal of the skin, where several triangles meet. No ray may pass between triangles. */
static void no_ray_passes_between_triangles(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    for (int i = 1; i < 8 * CELLS; i++)
        for (int j = 1; j < 8 * CELLS; j++) {
            vec3 at = v3(BOX.x * i / (8 * CELLS), BOX.y * j / (8 * CELLS), 0);
            vec3 slant = v3(uniform(-0.02, 0.02), uniform(-0.02, 0.02), 0.05);
            surface_hit straight = mesh_enter(&m, v3_sub(at, v3(0, 0, 0.05)), v3_add(at, v3(0, 0, 0.01)));
            surface_hit oblique = mesh_enter(&m, v3_sub(at, slant), v3_add(at, slant));
            assert_true(straight.hit && oblique.hit);
            assert_true(v3_norm(v3_sub(straight.point, at)) < 1e-14 && v3_norm(v3_sub(oblique.point, at)) < 1e-14);
        }
    mesh_free(&m);
}

static void tip_resting_on_the_skin_enters_in_the_next_step(void **state) {
    (void)state;
    mesh m;
    make_box(&m);
    vec3 before = v3(0.031, 0.047, -0.01), on = v3(0.031, 0.047, 0), inside = v3(0.031, 0.047, 0.001);
    assert_true(mesh_enter(&m, before, on).hit);
    assert_true(mesh_enter(&m, on, inside).hit);
    assert_false(mesh_enter(&m, inside, before).hit); /* outward */
    assert_false(mesh_enter(&m, on, before).hit);
    assert_false(mesh_enter(&m, before, before).hit);
    mesh_free(&m);
}

/* ---- invalid meshes ---- */

static void assert_refused(mesh *m, const char *words) {
    trocar_error why = {""};
    assert_int_equal(finish(m, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "box: "));
    if (!strstr(why.text, words)) fail_msg("%s lacks %s", why.text, words);
    mesh_free(m);
}

static void bad_meshes_are_refused(void **state) {
    (void)state;
    mesh m;
    draft_fan(&m, 3); /* the third tetrahedron shares the face between the first two */
    assert_refused(&m, "share the face");

    draft_fan(&m, 2);
    m.nodes[4] = v3(0.2, 0.2, 2); /* moves the node to the first tetrahedron's side of the shared face */
    assert_refused(&m, "overlap");

    draft_box(&m); /* moves an inner node onto the opposite face of its tetrahedron */
    const int *v = m.tets[100];
    m.nodes[v[0]] = v3_scale(1.0 / 3, v3_add(m.nodes[v[1]], v3_add(m.nodes[v[2]], m.nodes[v[3]])));
    assert_refused(&m, "no volume");

    draft_box(&m);
    m.nodes[5].y = NAN;
    assert_refused(&m, "not finite");

    draft_box(&m);
    m.tet_count = 6;
    assert_refused(&m, "belongs to no tetrahedron");
}

static void a_surface_off_the_faces_is_refused(void **state) {
    (void)state;
    mesh m;
    draft_box(&m);
    int across[1][3] = {{grid_node(0, 0, 0), grid_node(CELLS, 0, 0), grid_node(0, CELLS, 0)}}, group[1] = {1};
    trocar_error why;
    assert_int_equal(mesh_finish(&m, 1, (const int(*)[3])across, group, "box", &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "\"skin\""));
    mesh_free(&m);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tets_have_positive_volume_and_fill_the_box),
        cmocka_unit_test(neighbours_are_mutual_and_share_three_nodes),
        cmocka_unit_test(boundary_is_counter_clockwise_from_outside),
        cmocka_unit_test(named_faces_are_marked_on_both_sides),
        cmocka_unit_test(node_size_is_the_edge_of_the_regular_tet),
        cmocka_unit_test(gradients_reproduce_a_linear_field),
        cmocka_unit_test(weights_reproduce_the_point),
        cmocka_unit_test(locate_finds_the_containing_tet),
        cmocka_unit_test(locate_finds_the_far_side_of_a_slot),
        cmocka_unit_test(exit_walk_traverses_the_box),
        cmocka_unit_test(start_slightly_outside_a_face_is_treated_as_on_it),
        cmocka_unit_test(segments_enter_at_the_surface_of_the_box),
        cmocka_unit_test(no_ray_passes_between_triangles),
        cmocka_unit_test(tip_resting_on_the_skin_enters_in_the_next_step),
        cmocka_unit_test(bad_meshes_are_refused),
        cmocka_unit_test(a_surface_off_the_faces_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
