/* Tests which inputs the dose functions refuse, that a refused call changes nothing, and how long adding a seed takes. The doses themselves are tested in
   test_dose.py. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <trocar.h>
#include <unistd.h>

static void assert_text(const char *text, const char *part) {
    if (!strstr(text, part)) fail_msg("\"%s\" does not say \"%s\"", text, part);
}

static trocar_dose_source *create_source(void) {
    trocar_dose_source *source;
    trocar_error why;
    if (trocar_dose_source_create("I-125 6711", &source, &why) != TROCAR_OK) fail_msg("%s", why.text);
    return source;
}

/* ---- table files ------------------------------------------------------------------------------------------------------------- */

static const char *const TABLE[] = {
    "name: test",                                /* line 1 */
    "dose_rate_constant: 0.9",
    "active_length: 0.3",
    "half_life: 60",
    "capsule: {length: 0.45, diameter: 0.08}",   /* 5 */
    "radial:",
    "  - [0.5, 1.1]",
    "  - [1, 1]",
    "  - [5, 0.3]",
    "anisotropy:",                               /* 10 */
    "  radii: [1, 5]",
    "  rows:",
    "    - [0, 0.4, 0.5]",
    "    - [45, 0.9, 0.9]",
    "    - [90, 1, 1]",                          /* 15 */
};
enum { LINES = sizeof TABLE / sizeof *TABLE };

/* Loads the table with one line replaced, or unchanged if `replacement` is NULL. */
static trocar_status load_with(int line, const char *replacement, trocar_dose_source **source, trocar_error *why) {
    char path[] = "/tmp/test_dose_XXXXXX";
    int descriptor = mkstemp(path);
    FILE *file = descriptor >= 0 ? fdopen(descriptor, "w") : NULL;
    assert_non_null(file);
    for (int i = 0; i < LINES; i++) fprintf(file, "%s\n", replacement && i + 1 == line ? replacement : TABLE[i]);
    fclose(file);
    trocar_status status = trocar_dose_source_load(path, source, why);
    if (status != TROCAR_OK) {
        assert_int_equal(strncmp(why->text, path, strlen(path)), 0);
        memmove(why->text, why->text + strlen(path), strlen(why->text + strlen(path)) + 1);
    }
    unlink(path);
    return status;
}

static void bad_tables_are_refused_with_line_and_remedy(void **state) {
    (void)state;
    static const struct { int line; const char *replacement, *message; } cases[] = {
        {1, "name: ''", ":1: name: expected a text"},
        {1, "", ":2: missing key \"name\""},
        {2, "", "missing key \"dose_rate_constant\""},
        {2, "dose_rate_constant: -1", ":2: dose_rate_constant: \"-1\": expected a number above 0"},
        {2, "dose_rate_constant: nan", ":2: dose_rate_constant: \"nan\""},
        {2, "dose_rate_constant: 0,965", ":2: dose_rate_constant: \"0,965\""},
        {2, "dose_rate_constant: {}", ":2: dose_rate_constant: expected"},
        {2, "name: other", "the key \"name\" appears twice"},
        {3, "active_length: 3.0", ":3: active_length: 3 cm do not fit into a capsule of 0.45 cm"},
        {4, "half_lief: 60", "unknown key \"half_lief\""},
        {5, "capsule: {length: 0.45}", ":5: capsule: missing key \"diameter\""},
        {5, "capsule: 0.45", ":5: capsule: expected keys"},
        {7, "  - [0.5]", ":7: radial[0]: expected a list of 2 numbers: fill the gap"},
        {7, "  - [0.5, ]", ":7: radial[0]: expected a list of 2 numbers: fill the gap"},
        {7, "  - [0.5, ~]", ":7: radial[0][1]: \"~\": expected g"},
        {7, "  - [0.5, '']", ":7: radial[0][1]: a value is missing"},
        {7, "  - [0.5, 1.1, 2]", "remove the surplus"},
        {7, "  - [1, 1.1]", ":8: radial[1]: the radius 1 is not above the one before, 1"},
        {7, "  - [2, 1.1]", ":8: radial[1]: the radius 1 is not above the one before, 2"},
        {8, "  - [1, 1.2]", "radial: g at 1 cm is 1.2; by definition it is 1"},
        {8, "  - [1, 0]", ":8: radial[1][1]: \"0\": expected g, a number above 0"},
        {9, "  - [5, 1.3]", "g does not fall over the last two radii"},
        {9, "", NULL},
        {11, "  radii: [5, 1]", ":11: anisotropy.radii[1]: the radius 1 is not above the one before, 5"},
        {11, "  radii: []", ":11: anisotropy.radii: 0 entries"},
        {11, "  radii: [1, 5, 7]", ":13: anisotropy.rows[0]: expected a list of 4 numbers: fill the gap"},
        {13, "    - [5, 0.4, 0.5]", "the angles go from 5 to 90"},
        {14, "    - [45, 0.9]", ":14: anisotropy.rows[1]: expected a list of 3 numbers: fill the gap"},
        {14, "    - [95, 0.9, 0.9]", ":15: anisotropy.rows[2]: the angle 90 is not above the one before, 95"},
        {14, "    - [45, 0.9, -1]", ":14: anisotropy.rows[1][2]: \"-1\": expected F"},
        {15, "    - [90, 1, 0.9]", "F at 90 degrees and 5 cm is 0.9"},
        {15, "    - [80, 1, 1]", "the angles go from 0 to 80"},
        {15, "    - [90, 1, 1", "not valid YAML"},
    };
    trocar_dose_source *source;
    trocar_error why;
    assert_int_equal(load_with(0, NULL, &source, &why), TROCAR_OK);
    assert_string_equal(trocar_dose_source_get(source).name, "test");
    trocar_dose_source_free(source);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        trocar_status status = load_with(cases[i].line, cases[i].replacement, &source, &why);
        if (!cases[i].message) {
            assert_int_equal(status, TROCAR_OK);
            trocar_dose_source_free(source);
            continue;
        }
        if (status != TROCAR_BAD_INPUT) fail_msg("\"%s\" is taken", cases[i].replacement);
        assert_null(source);
        assert_text(why.text, cases[i].message);
    }
    assert_int_equal(trocar_dose_source_load("/nowhere/seed.yaml", &source, NULL), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_dose_source_load("/tmp", &source, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "/tmp: cannot open the seed table: Is a directory");
}

/* ---- seeds, grids and points ------------------------------------------------------------------------------------------------------ */

static const trocar_dose_grid SMALL = {{-0.01, -0.01, -0.01}, 1e-3, {21, 20, 19}};
enum { SMALL_VOXELS = 21 * 20 * 19 };

static void refusals_change_nothing(void **state) {
    (void)state;
    trocar_dose_source *source = create_source();
    trocar_dose *dose;
    trocar_error why;
    const trocar_dose_seed good = {{0.001, 0, 0}, {0, 0, 1}, 0.5};
    static const struct { trocar_dose_seed seed; const char *message; } bad[] = {
        {{{NAN, 0, 0}, {0, 0, 1}, 0.5}, "finite"},          {{{0, 2000, 0}, {0, 0, 1}, 0.5}, "at most 1000 m"},
        {{{0, 0, 0}, {0, 0, 0}, 0.5}, "direction"},         {{{0, 0, 0}, {0, INFINITY, 0}, 0.5}, "direction"},
        {{{0, 0, 0}, {0, 0, NAN}, 0.5}, "direction"},       {{{0, 0, 0}, {0, 0, 1}, 0}, "strength above 0"},
        {{{0, 0, 0}, {0, 0, 1}, -1}, "strength above 0"},   {{{0, 0, 0}, {0, 0, 1}, NAN}, "strength above 0"},
        {{{0, 0, 0}, {0, 0, 1}, 1e4}, "at most 1000 U"},
    };
    static double before[SMALL_VOXELS], after[SMALL_VOXELS], shifts[3 * SMALL_VOXELS];
    int32_t id, second;
    assert_int_equal(trocar_dose_create(source, &SMALL, &dose, &why), TROCAR_OK);
    assert_int_equal(trocar_dose_add(dose, &good, &id, &why), TROCAR_OK);
    trocar_dose_values(dose, before);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        double point[3] = {0.01, 0, 0}, rate = -1;
        assert_int_equal(trocar_dose_add(dose, &bad[i].seed, NULL, &why), TROCAR_BAD_INPUT);
        assert_text(why.text, bad[i].message);
        assert_int_equal(trocar_dose_move(dose, id, &bad[i].seed, &why), TROCAR_BAD_INPUT);
        assert_int_equal(trocar_dose_rates(source, &bad[i].seed, 1, point, 1, &rate, &why), TROCAR_BAD_INPUT);
        assert_true(rate == -1);
    }
    assert_int_equal(trocar_dose_move(dose, id + 1, &good, &why), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_dose_remove(dose, -1, &why), TROCAR_BAD_INPUT);
    shifts[3 * 77 + 1] = NAN;
    assert_int_equal(trocar_dose_displace(dose, shifts, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "point 77");
    trocar_dose_values(dose, after);
    assert_memory_equal(before, after, sizeof before);
    assert_int_equal(trocar_dose_add(dose, &good, &second, NULL), TROCAR_OK);
    assert_int_equal(trocar_dose_remove(dose, id, NULL), TROCAR_OK);
    assert_int_equal(trocar_dose_remove(dose, id, &why), TROCAR_BAD_INPUT); /* ids are never reused */
    assert_int_equal(trocar_dose_seed_count(dose), 1);
    trocar_dose_values(dose, after);
    assert_memory_equal(before, after, sizeof before);
    trocar_dose_free(dose);
    trocar_dose_source_free(source);
}

static void bad_grids_and_points_are_refused(void **state) {
    (void)state;
    trocar_dose_source *source = create_source();
    trocar_dose *dose;
    trocar_error why;
    static const struct { trocar_dose_grid grid; const char *message; } bad[] = {
        {{{0, 0, 0}, 1e-3, {10, 0, 10}}, "at least 1"},             {{{0, 0, 0}, 1e-3, {1 << 20, 1 << 20, 1 << 20}}, "2^28"},
        {{{0, 0, 0}, 0, {10, 10, 10}}, "spacing"},                  {{{0, 0, 0}, NAN, {10, 10, 10}}, "spacing"},
        {{{0, INFINITY, 0}, 1e-3, {10, 10, 10}}, "finite"},         {{{999, 0, 0}, 1, {10, 10, 10}}, "1000 m"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        assert_int_equal(trocar_dose_create(source, &bad[i].grid, &dose, &why), TROCAR_BAD_INPUT);
        assert_null(dose);
        assert_text(why.text, bad[i].message);
    }
    const double points[] = {0, 0, 0, 0, -INFINITY, 0};
    assert_int_equal(trocar_dose_create_points(source, points, 2, &dose, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "point 1");
    assert_int_equal(trocar_dose_create_points(source, points, 0, &dose, &why), TROCAR_BAD_INPUT);
    assert_null(dose);
    trocar_dose_source_free(source);
}

/* Puts as many seeds as allowed at one point, each with the largest possible dose. The sum must not overflow. */
static void sums_do_not_overflow(void **state) {
    (void)state;
    trocar_dose_source *source = create_source();
    trocar_dose *dose;
    trocar_error why;
    const double point[3] = {0, 0, 0};
    const trocar_dose_seed seed = {{0, 0, 0}, {0, 0, 1}, 1000};
    double value;
    int32_t id;
    assert_int_equal(trocar_dose_create_points(source, point, 1, &dose, &why), TROCAR_OK);
    for (int i = 0; i < TROCAR_MAX_DOSE_SEEDS; i++) assert_int_equal(trocar_dose_add(dose, &seed, &id, &why), TROCAR_OK);
    trocar_dose_values(dose, &value);
    assert_true(value == TROCAR_MAX_DOSE_SEEDS * TROCAR_MAX_SEED_DOSE);
    assert_int_equal(trocar_dose_add(dose, &seed, &id, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "4095 seeds");
    trocar_dose_free(dose);
    trocar_dose_source_free(source);
}

/* ---- structures --------------------------------------------------------------------------------------------------------------------- */

static void bad_meshes_are_refused(void **state) {
    (void)state;
    const double nodes[] = {0, 0, 0, 0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01, NAN, 0, 0};
    const int32_t tet[] = {0, 1, 2, 3}, far[] = {0, 1, 2, 5}, nan[] = {0, 1, 2, 4};
    const int32_t faces[] = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3}, surfaces[] = {0, 0, 0, 1};
    trocar_mesh mesh = {.node_count = 5, .nodes = nodes, .tet_count = 1, .tets = tet, .triangle_count = 4, .triangles = faces};
    trocar_structure *s;
    trocar_error why;
    assert_int_equal(trocar_structure_from_region(&mesh, 0, 1e-3, &s, &why), TROCAR_OK);
    double nodal[15] = {0}, *moved = malloc(3 * sizeof *moved * (size_t)trocar_structure_count(s));
    assert_int_equal(trocar_structure_displacements(s, nodal, moved, &why), TROCAR_OK);
    int64_t count = trocar_structure_count(s);
    trocar_structure_free(s);
    assert_int_equal(trocar_structure_from_surface(&mesh, 0, 1e-3, &s, &why), TROCAR_OK);
    assert_int_equal(trocar_structure_count(s), count); /* the same tetrahedron, given by its faces; no voxel centre lies on a face */
    assert_int_equal(trocar_structure_displacements(s, nodal, moved, &why), TROCAR_BAD_INPUT);
    trocar_structure_free(s);
    free(moved);

    assert_int_equal(trocar_structure_from_region(&mesh, 0, 0, &s, &why), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_structure_from_region(&mesh, 0, 1e-9, &s, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "2^28");
    assert_int_equal(trocar_structure_from_region(&mesh, 0, 0.1, &s, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "no voxel");
    mesh.triangle_count = 3;
    assert_int_equal(trocar_structure_from_surface(&mesh, 0, 1e-3, &s, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "nodes 1 and 2");
    mesh.triangle_count = 4;
    mesh.triangle_surface = surfaces;
    assert_int_equal(trocar_structure_from_surface(&mesh, 0, 1e-3, &s, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "not closed");
    assert_int_equal(trocar_structure_from_surface(&mesh, 2, 1e-3, &s, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "no triangle belongs to number 2");
    mesh.tets = far;
    assert_int_equal(trocar_structure_from_region(&mesh, 0, 1e-3, &s, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "tetrahedron 0 has the node 5");
    mesh.tets = nan;
    assert_int_equal(trocar_structure_from_region(&mesh, 0, 1e-3, &s, &why), TROCAR_BAD_INPUT);
    assert_text(why.text, "node 4 is at");
    assert_null(s);
}

/* ---- time ------------------------------------------------------------------------------------------------------------------------------ */

static double processor_time(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Adding a seed to a dose grid of a million voxels takes less than 50 ms of CPU time. Only the fastest of several runs counts, because other programs
   compete for the caches and execution units. */
static void a_seed_is_added_quickly(void **state) {
    (void)state;
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
    skip();
#endif
    enum { SIDE = 100, VOXELS = SIDE * SIDE * SIDE, TIMES = 60 };
    trocar_dose_source *source = create_source();
    trocar_dose *dose;
    trocar_error why;
    const trocar_dose_grid grid = {{-0.05, -0.05, -0.05}, 1e-3, {SIDE, SIDE, SIDE}};
    double fastest = INFINITY;
    assert_int_equal(trocar_dose_create(source, &grid, &dose, &why), TROCAR_OK);
    for (int i = 0; i < TIMES && (i < 8 || fastest >= 0.05); i++) {
        trocar_dose_seed seed = {{0.0005 * i - 0.02, 0.001, -0.0005 * i}, {0.1 * i, 0.3, 1}, 0.5};
        double start = processor_time();
        assert_int_equal(trocar_dose_add(dose, &seed, NULL, &why), TROCAR_OK);
        fastest = fmin(fastest, processor_time() - start);
    }
    print_message("%d voxels: a seed in %.1f ms\n", VOXELS, 1e3 * fastest);
    assert_true(fastest < 0.05);
    trocar_dose_free(dose);
    trocar_dose_source_free(source);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bad_tables_are_refused_with_line_and_remedy),
        cmocka_unit_test(refusals_change_nothing),
        cmocka_unit_test(bad_grids_and_points_are_refused),
        cmocka_unit_test(sums_do_not_overflow),
        cmocka_unit_test(bad_meshes_are_refused),
        cmocka_unit_test(a_seed_is_added_quickly),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
