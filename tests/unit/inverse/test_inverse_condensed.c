/* Compares the condensed inverse with the dense one inside the region, across its boundary and outside, whether it is computed, read from the cache, or
   recomputed because the file is corrupt. */
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/stat.h>
#include <unistd.h>

#include "condensed/coarse_space.h"
#include "condensed/condensed_cache.h"
#include "cube.h"

#include <cmocka.h>

#include "check.h"

enum { N = 3 * CUBE_NODES, REGION = 30 };
static char directory[] = "/tmp/test_condensed.XXXXXX";
static cube body;
static double dense[N * N], largest;
static int all[CUBE_NODES], region[REGION]; /* some of these nodes are fixed */

static double memory_left = 1e12; /* bytes */
double __wrap_memory_available(void);
double __wrap_memory_available(void) { return memory_left; }

static double memory_ever = 1e12;
double __wrap_memory_most(void);
double __wrap_memory_most(void) { return memory_ever; }

/* How the coarse solve behaves: normal, out of memory, or misleading (as for a gland 2000 times as stiff as its surroundings at nu = 0.499). */
static enum { COARSE_WORKS, COARSE_FAILS, COARSE_MISLEADS, COARSE_IS_NOT_FINITE } coarse_way;
static int coarse_calls, coarse_good; /* calls so far, and how many initial calls succeed */
bool __real_coarse_space_solve(coarse_space *c, const double *force, double *motion);
bool __wrap_coarse_space_solve(coarse_space *c, const double *force, double *motion);
bool __wrap_coarse_space_solve(coarse_space *c, const double *force, double *motion) {
    coarse_calls++;
    bool done = __real_coarse_space_solve(c, force, motion);
    if (coarse_way == COARSE_WORKS || coarse_calls <= coarse_good) return done;
    for (int i = 0; i < body.tissue.dof_count; i++) motion[i] = coarse_way == COARSE_MISLEADS ? -motion[i] : NAN;
    return coarse_way != COARSE_FAILS;
}

static int progress_calls;
static double progress_last;
static void note_progress(const char *what, double fraction, void *context) {
    (void)context;
    (void)what;
    progress_calls++;
    progress_last = fraction;
}

static int create(void **state) {
    (void)state;
    trocar_error why;
    if (!mkdtemp(directory) || cube_create(&body, 0.1, &why) != TROCAR_OK) return -1;
    for (int i = 0; i < CUBE_NODES; i++) all[i] = i;
    for (int i = 0; i < REGION; i++) region[i] = 3 + 4 * i;
    if (inverse_gather(body.inverse, &(inverse_blocks){CUBE_NODES, all, CUBE_NODES, all, dense, N}, &why) != TROCAR_OK) return -1;
    for (int i = 0; i < N * N; i++) largest = fmax(largest, fabs(dense[i]));
    return 0;
}

static int destroy(void **state) {
    (void)state;
    cube_free(&body);
    return rmdir(directory);
}

typedef struct {
    tissue tissue;
    inverse *inverse;
    trocar_error notice;
    char path[1200];         /* path of the cache file */
} condensed;

/* Starts as a new process would, with only the file from the previous start. */
static void start(condensed *c, double stiffness) {
    trocar_error why;
    static region_material materials[2];
    memcpy(materials, body.materials, sizeof materials);
    materials[0].youngs_modulus *= stiffness;
    assert_int_equal(tissue_assemble(&body.mesh, materials, body.fixed, STRAIN_BY_ELEMENT, &c->tissue, &why), TROCAR_OK);
    snprintf(c->path, sizeof c->path, "%s", condensed_cache_find(directory, &c->tissue, REGION, region, false).path);
    assert_int_equal(inverse_create_condensed(&c->tissue, &(condensed_region){.count = REGION, .nodes = region, .directory = directory}, &c->inverse, &c->notice, &why), TROCAR_OK);
}

static void stop(condensed *c) {
    inverse_free(c->inverse);
    tissue_free(&c->tissue);
}

static void assert_blocks(condensed *c, int count, const int *nodes) {
    static double found[N * N];
    trocar_error why;
    assert_int_equal(inverse_gather(c->inverse, &(inverse_blocks){count, nodes, count, nodes, found, N}, &why), TROCAR_OK);
    for (int i = 0; i < 3 * count; i++)
        for (int j = 0; j < 3 * count; j++)
            assert_close(found[i * N + j], dense[(3 * nodes[i / 3] + i % 3) * N + 3 * nodes[j / 3] + j % 3], 1e-12 * largest);
}

static bool says(const condensed *c, const char *words) { return strstr(c->notice.text, words) != NULL; }

static void blocks_match_the_dense_inverse(void **state) {
    (void)state;
    condensed c;
    start(&c, 1.0);
    assert_true(says(&c, "written to"));
    assert_blocks(&c, REGION, region);
    assert_blocks(&c, CUBE_NODES, all);
    stop(&c);
    assert_int_equal(unlink(c.path), 0);
}

static void reading_a_file_updates_its_time_of_use(void **state) {
    (void)state;
    condensed c;
    struct stat s;
    const struct timespec long_ago[2] = {{1000, 0}, {1000, 0}};
    start(&c, 1.0);
    stop(&c);
    assert_int_equal(utimensat(AT_FDCWD, c.path, long_ago, 0), 0);
    start(&c, 1.0);
    stop(&c);
    assert_int_equal(stat(c.path, &s), 0);
    assert_true(s.st_mtim.tv_sec > 1000);
    assert_int_equal(unlink(c.path), 0);
}

/* Solves for three fields, each but the first starting from the one before. The second is that of zero force. */
static void fields_need_no_factorisation(void **state) {
    (void)state;
    condensed c;
    vec3 force[CUBE_NODES], expected[CUBE_NODES], found[CUBE_NODES];
    start(&c, 1.0);
    stop(&c);
    start(&c, 1.0);
    for (int times = 0; times < 3; times++) {
        for (int i = 0; i < CUBE_NODES; i++) force[i] = times == 1 ? v3(0, 0, 0) : cube_random_vector(1.0);
        inverse_apply(body.inverse, force, expected);
        inverse_apply(c.inverse, force, found);
        for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(found[i], expected[i], 1e-11 * N * largest);
    }
    assert_null(c.tissue.factor);
    stop(&c);
    assert_int_equal(unlink(c.path), 0);
}

/* After the coarse solve has failed, fields are computed without the coarse space, including those that start from the last field, and it is not tried
   again. */
static void a_coarse_space_that_does_not_help_is_given_up(void **state) {
    (void)state;
    for (coarse_way = COARSE_FAILS; coarse_way <= COARSE_IS_NOT_FINITE; coarse_way++)
        for (coarse_good = 0; coarse_good <= 10; coarse_good += 10) { /* the coarse solve fails at once (0) or after 10 iterations */
            condensed c;
            vec3 force[CUBE_NODES], expected[CUBE_NODES], found[CUBE_NODES];
            start(&c, 1.0);
            coarse_calls = 0;
            for (int times = 0, calls = 0; times < 3; times++) {
                for (int i = 0; i < CUBE_NODES; i++) force[i] = cube_random_vector(1.0);
                inverse_apply(body.inverse, force, expected);
                inverse_apply(c.inverse, force, found);
                for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(found[i], expected[i], 1e-11 * N * largest);
                if (times == 0) calls = coarse_calls;
                assert_true(calls > coarse_good);
                assert_int_equal(coarse_calls, calls);
            }
            assert_null(c.tissue.factor);
            stop(&c);
            assert_int_equal(unlink(c.path), 0);
        }
    coarse_way = COARSE_WORKS;
}

/* An entry's error is small compared with the compliances of its two nodes, and the file is half as large. Diagonal blocks are exactly symmetric. */
static void single_precision_takes_half_the_room(void **state) {
    (void)state;
    condensed c;
    trocar_error notice, why;
    double found[9 * REGION * REGION];
    struct stat whole, half;
    start(&c, 1.0);
    stop(&c);
    assert_int_equal(stat(c.path, &whole), 0);
    assert_int_equal(unlink(c.path), 0);
    assert_int_equal(tissue_assemble(&body.mesh, body.materials, body.fixed, STRAIN_BY_ELEMENT, &c.tissue, &why), TROCAR_OK);
    condensed_region single = {.count = REGION, .nodes = region, .directory = directory, .single = true};
    snprintf(c.path, sizeof c.path, "%s", condensed_cache_find(directory, &c.tissue, REGION, region, true).path);
    for (int times = 0; times < 2; times++) { /* computed, then mapped */
        assert_int_equal(inverse_create_condensed(&c.tissue, &single, &c.inverse, &notice, &why), TROCAR_OK);
        assert_non_null(strstr(notice.text, times == 0 ? "written to" : "read from"));
        assert_int_equal(inverse_gather(c.inverse, &(inverse_blocks){REGION, region, REGION, region, found, 3 * REGION}, &why), TROCAR_OK);
        for (int i = 0; i < 3 * REGION; i++)
            for (int j = 0; j < 3 * REGION; j++) {
                int row = 3 * region[i / 3] + i % 3, column = 3 * region[j / 3] + j % 3;
                assert_close(found[i * 3 * REGION + j], dense[row * N + column], 1e-6 * sqrt(dense[row * N + row] * dense[column * N + column]));
                assert_true(found[i * 3 * REGION + j] == found[j * 3 * REGION + i]);
            }
        inverse_free(c.inverse);
    }
    assert_int_equal(stat(c.path, &half), 0);
    int free_nodes = 0;
    for (int i = 0; i < REGION; i++) free_nodes += !body.fixed[region[i]];
    assert_int_equal(whole.st_size - half.st_size, 4 * 9 * free_nodes * (free_nodes + 1) / 2);
    tissue_free(&c.tissue);
    assert_int_equal(unlink(c.path), 0);
}

/* In single precision, a very stiff body's factor is infinite and its inverse is zero. Such an inverse is neither used nor cached. */
static void overflow_is_an_error(void **state) {
    (void)state;
    static const double factors[] = {1e70, 1e-70};
    for (int i = 0; i < 2; i++) {
        region_material materials[2];
        tissue t;
        inverse *created;
        trocar_error notice, why;
        memcpy(materials, body.materials, sizeof materials);
        for (int k = 0; k < 2; k++) materials[k].youngs_modulus *= factors[i];
        assert_int_equal(tissue_assemble(&body.mesh, materials, body.fixed, STRAIN_BY_ELEMENT, &t, &why), TROCAR_OK);
        condensed_region single = {.count = REGION, .nodes = region, .directory = directory, .single = true};
        assert_int_equal(inverse_create_condensed(&t, &single, &created, &notice, &why), TROCAR_BAD_INPUT);
        assert_non_null(strstr(why.text, "inverse_precision: double"));
        assert_null(created);
        assert_null(t.factor);
        assert_int_equal(access(condensed_cache_find(directory, &t, REGION, region, true).path, F_OK), -1);
        tissue_free(&t);
    }
}

/* The inverse is read from the file without factorising. Only nodes outside the region need a factor. */
static void second_start_needs_no_factorisation(void **state) {
    (void)state;
    condensed c;
    start(&c, 1.0);
    stop(&c);
    start(&c, 1.0);
    assert_true(says(&c, "read from"));
    assert_blocks(&c, REGION, region);
    vec3 force[CUBE_NODES] = {{0, 0, 0}}, one[CUBE_NODES], other[CUBE_NODES];
    inverse_apply(c.inverse, force, one);
    for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(one[i], v3(0, 0, 0), 0.0);
    assert_null(c.tissue.factor);
    assert_blocks(&c, CUBE_NODES, all);
    assert_non_null(c.tissue.factor);
    for (int i = 0; i < CUBE_NODES; i++) force[i] = cube_random_vector(1.0);
    inverse_apply(body.inverse, force, one);
    inverse_apply(c.inverse, force, other);
    for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(other[i], one[i], 1e-11 * N * largest);
    stop(&c);
    assert_int_equal(unlink(c.path), 0);
}

/* Nodes outside the region need a factor. If factorising fails, the failure is reported and no zero displacements are returned. */
static void failed_factorisation_is_reported(void **state) {
    (void)state;
    condensed c;
    start(&c, 1.0);
    stop(&c);
    start(&c, 1.0);
    cube_loosen(&c.tissue);
    int outside = 61, inside = 27;
    assert_false(inverse_holds(c.inverse, outside));
    assert_true(inverse_holds(c.inverse, inside));
    double block[9] = {7.0};
    for (int i = 0; i < 2; i++) {
        trocar_error why = {""};
        assert_int_equal(inverse_gather(c.inverse, &(inverse_blocks){1, &inside, 1, &outside, block, 3}, &why), TROCAR_BAD_INPUT);
        assert_non_null(strstr(why.text, "do not constrain the whole body"));
        assert_true(block[0] == 7.0);
    }
    trocar_error why = {""};
    assert_int_equal(inverse_prepare(c.inverse, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "do not constrain the whole body"));
    assert_null(c.tissue.factor);
    assert_blocks(&c, REGION, region);
    vec3 field[CUBE_NODES];
    for (int i = 0; i < CUBE_NODES; i++) field[i] = v3(1, 2, 3);
    inverse_apply(c.inverse, field, field);
    for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(field[i], v3(0, 0, 0), 0.0);
    stop(&c);
    assert_int_equal(unlink(c.path), 0);
}

static void factorisation_can_be_prepared(void **state) {
    (void)state;
    condensed c;
    trocar_error why;
    start(&c, 1.0);
    stop(&c);
    start(&c, 1.0);
    assert_null(c.tissue.factor);
    assert_int_equal(inverse_prepare(c.inverse, &why), TROCAR_OK);
    assert_non_null(c.tissue.factor);
    assert_int_equal(inverse_prepare(c.inverse, &why), TROCAR_OK);
    assert_blocks(&c, CUBE_NODES, all);
    stop(&c);
    assert_int_equal(unlink(c.path), 0);
}

/* Changes one byte of the file at offset `at`, or truncates the file there. */
static void damage(const char *path, double place, bool cut) {
    struct stat s;
    assert_int_equal(stat(path, &s), 0);
    long at = (long)(place * (double)s.st_size);
    if (cut) {
        assert_int_equal(truncate(path, at), 0);
        return;
    }
    FILE *file = fopen(path, "r+b");
    assert_non_null(file);
    fseek(file, at, SEEK_SET);
    int byte = fgetc(file);
    fseek(file, at, SEEK_SET);
    fputc(byte ^ 0x10, file);
    fclose(file);
}

static void damaged_file_is_detected_and_replaced(void **state) {
    (void)state;
    static const struct { double place; bool cut; } cases[] = {{0.0, true}, {0.5, true}, {0.99, true}, {0.0, false}, {0.5, false}, {0.9, false}};
    condensed c;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        start(&c, 1.0);
        stop(&c);
        damage(c.path, cases[i].place, cases[i].cut);
        start(&c, 1.0);
        assert_true(says(&c, "damaged"));
        assert_blocks(&c, REGION, region);
        stop(&c);
        start(&c, 1.0);
        assert_true(says(&c, "read from"));
        stop(&c);
        assert_int_equal(unlink(c.path), 0);
    }
}

static void different_tissues_use_different_files(void **state) {
    (void)state;
    condensed soft, stiff;
    start(&soft, 1.0);
    stop(&soft);
    start(&stiff, 1.000001);
    assert_true(says(&stiff, "written to"));
    stop(&stiff);
    assert_string_not_equal(soft.path, stiff.path);
    assert_int_equal(rename(stiff.path, soft.path), 0); /* a stale file: right name, but for another tissue */
    start(&soft, 1.0);
    assert_true(says(&soft, "damaged"));
    assert_blocks(&soft, REGION, region);
    stop(&soft);
    assert_int_equal(unlink(soft.path), 0);
}

/* Checks that no inverse can be computed for the body's own tissue. The caller frees the tissue. */
static trocar_error refused(tissue *t, condensed_region wanted, trocar_status expected) {
    inverse *inv;
    trocar_error notice, why;
    assert_int_equal(tissue_assemble(&body.mesh, body.materials, body.fixed, STRAIN_BY_ELEMENT, t, &why), TROCAR_OK);
    progress_calls = 0;
    assert_int_equal(inverse_create_condensed(t, &wanted, &inv, &notice, &why), expected);
    assert_null(inv);
    return why;
}

/* The error occurs before the elimination. Its message gives the memory needed and available, the remedy and, for a file from another machine, its path. The
   same goes for the whole factor. */
static void too_little_memory_is_reported_beforehand(void **state) {
    (void)state;
    tissue t;
    memory_left = 1e5;
    trocar_error why = refused(&t, (condensed_region){.count = REGION, .nodes = region, .directory = directory, .progress = {note_progress, NULL}},
                               TROCAR_NO_MEMORY);
    assert_int_equal(progress_calls, 0);
    assert_non_null(strstr(why.text, "0.0001 GB are available"));
    assert_non_null(strstr(why.text, "region_of_interest"));
    assert_non_null(strstr(why.text, condensed_cache_find(directory, &t, REGION, region, false).path));
    assert_int_equal(tissue_factor(&t, REGION, region, &why), TROCAR_NO_MEMORY);
    assert_non_null(strstr(why.text, "0.0001 GB are available"));
    assert_null(t.factor);
    memory_left = 1e9;
    assert_int_equal(tissue_factor(&t, REGION, region, &why), TROCAR_OK);
    tissue_free(&t);
}

/* If the machine can never provide that much memory, the status is BAD_INPUT, so that a supervisor does not restart the program. */
static void more_than_the_machine_has_is_bad_input(void **state) {
    (void)state;
    tissue t;
    memory_left = memory_ever = 1e4;
    trocar_error why = refused(&t, (condensed_region){.count = REGION, .nodes = region, .directory = directory}, TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "1e-05 GB are available"));
    assert_non_null(strstr(why.text, condensed_cache_find(directory, &t, REGION, region, false).path));
    assert_int_equal(tissue_factor(&t, REGION, region, &why), TROCAR_BAD_INPUT);
    memory_left = memory_ever = 1e12;
    tissue_free(&t);
}

/* Even if there was too little memory for the factor when a node outside the region was first needed, factorising is tried again later. */
static void a_passing_shortage_is_not_final(void **state) {
    (void)state;
    condensed c;
    trocar_error why;
    start(&c, 1.0);
    stop(&c);
    start(&c, 1.0);
    memory_left = 1e4;
    for (int times = 0; times < 2; times++) {
        assert_int_equal(inverse_prepare(c.inverse, &why), TROCAR_NO_MEMORY);
        assert_non_null(strstr(why.text, "1e-05 GB are available"));
    }
    memory_left = 1e12;
    assert_int_equal(inverse_prepare(c.inverse, &why), TROCAR_OK);
    assert_blocks(&c, CUBE_NODES, all);
    stop(&c);
    assert_int_equal(unlink(c.path), 0);
}

static void fully_fixed_region_is_refused(void **state) {
    (void)state;
    tissue t;
    refused(&t, (condensed_region){.count = 3, .nodes = all, .directory = directory}, TROCAR_BAD_INPUT);
    tissue_free(&t);
}

static void progress_is_reported_and_unwritable_cache_is_tolerated(void **state) {
    (void)state;
    condensed c;
    trocar_error why;
    assert_int_equal(tissue_assemble(&body.mesh, body.materials, body.fixed, STRAIN_BY_ELEMENT, &c.tissue, &why), TROCAR_OK);
    assert_int_equal(inverse_create_condensed(&c.tissue, &(condensed_region){.count = REGION, .nodes = region, .directory = "/proc/nowhere", .progress = {note_progress, NULL}}, &c.inverse, &c.notice, &why), TROCAR_OK);
    assert_true(says(&c, "cannot be written"));
    assert_true(progress_calls >= 3);
    assert_close(progress_last, 1.0, 1e-12);
    assert_blocks(&c, REGION, region);
    stop(&c);
}

static void what_cannot_be_kept_is_not_made(void **state) {
    (void)state;
    tissue t;
    condensed_region wanted = {.count = REGION, .nodes = region, .directory = "/proc/nowhere", .must_be_saved = true, .progress = {note_progress, NULL}};
    trocar_error why = refused(&t, wanted, TROCAR_SYSTEM);
    assert_non_null(strstr(why.text, "cannot be written"));
    assert_int_equal(progress_calls, 0);
    tissue_free(&t);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(blocks_match_the_dense_inverse),
        cmocka_unit_test(reading_a_file_updates_its_time_of_use),
        cmocka_unit_test(overflow_is_an_error),
        cmocka_unit_test(second_start_needs_no_factorisation),
        cmocka_unit_test(fields_need_no_factorisation),
        cmocka_unit_test(a_coarse_space_that_does_not_help_is_given_up),
        cmocka_unit_test(single_precision_takes_half_the_room),
        cmocka_unit_test(failed_factorisation_is_reported),
        cmocka_unit_test(factorisation_can_be_prepared),
        cmocka_unit_test(damaged_file_is_detected_and_replaced),
        cmocka_unit_test(different_tissues_use_different_files),
        cmocka_unit_test(too_little_memory_is_reported_beforehand),
        cmocka_unit_test(more_than_the_machine_has_is_bad_input),
        cmocka_unit_test(a_passing_shortage_is_not_final),
        cmocka_unit_test(fully_fixed_region_is_refused),
        cmocka_unit_test(progress_is_reported_and_unwritable_cache_is_tolerated),
        cmocka_unit_test(what_cannot_be_kept_is_not_made),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
