/* Compares the inverse of the stiffness matrix with the matrix itself and with LAPACK. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <suitesparse/SuiteSparse_config.h>

#include "cube.h"
#include "reference.h"

#include <cmocka.h>

#include "check.h"
#include "oracles/dense_matrix.h"

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

static void stiffness_times_inverse_is_identity(void **state) {
    (void)state;
    tissue *t = &body.tissue;
    cholmod_dense *u = cholmod_zeros(t->dof_count, 1, CHOLMOD_REAL, &t->common);
    cholmod_dense *f = cholmod_zeros(t->dof_count, 1, CHOLMOD_REAL, &t->common);
    for (int n = 0; n < 20; n++) {
        vec3 force[CUBE_NODES], displacement[CUBE_NODES];
        for (int i = 0; i < CUBE_NODES; i++) force[i] = cube_random_vector(1.0);
        inverse_apply(body.inverse, force, displacement);
        for (int i = 0; i < CUBE_NODES; i++)
            if (t->dof[i] >= 0) memcpy((double *)u->x + t->dof[i], &displacement[i], sizeof displacement[i]);
            else assert_close_vector(displacement[i], v3(0, 0, 0), 0.0);
        double one[2] = {1, 0}, zero[2] = {0, 0};
        cholmod_sdmult(t->stiffness, 0, one, zero, u, f, &t->common);
        for (int i = 0; i < CUBE_NODES; i++) {
            const double *x = (const double *)f->x + t->dof[i];
            if (t->dof[i] >= 0) assert_close_vector(v3(x[0], x[1], x[2]), force[i], 1e-11);
        }
    }
    cholmod_free_dense(&u, &t->common);
    cholmod_free_dense(&f, &t->common);
}

static void force_and_displacement_may_alias(void **state) {
    (void)state;
    vec3 force[CUBE_NODES], apart[CUBE_NODES];
    for (int i = 0; i < CUBE_NODES; i++) force[i] = cube_random_vector(1.0);
    inverse_apply(body.inverse, force, apart);
    inverse_apply(body.inverse, force, force);
    assert_memory_equal(force, apart, sizeof force);
}

static void gathered_blocks_are_responses_to_unit_forces(void **state) {
    (void)state;
    int rows[6] = {30, 124, 7, 62, 124, 99}, columns[3] = {62, 3, 88}; /* nodes 7 and 3 are fixed; the rows are unordered and repeat */
    enum { LD = 11 };
    double blocks[18 * LD];
    trocar_error why;
    assert_int_equal(inverse_gather(body.inverse, &(inverse_blocks){6, rows, 3, columns, blocks, LD}, &why), TROCAR_OK);
    for (int j = 0; j < 9; j++) {
        vec3 force[CUBE_NODES] = {{0, 0, 0}}, displacement[CUBE_NODES];
        (&force[columns[j / 3]].x)[j % 3] = 1.0;
        inverse_apply(body.inverse, force, displacement);
        for (int i = 0; i < 18; i++) {
            if (rows[i / 3] == 7 || columns[j / 3] == 3) assert_true(blocks[i * LD + j] == 0.0);
            assert_close(blocks[i * LD + j], (&displacement[rows[i / 3]].x)[i % 3], 1e-15);
        }
    }
}

static void all_blocks_match_lapack(void **state) {
    (void)state;
    static const refinement none;
    reference expected;
    trocar_error why;
    reference_create(&body.tissue, &none, &expected);
    int all[CUBE_NODES], n = 3 * CUBE_NODES;
    for (int i = 0; i < CUBE_NODES; i++) all[i] = i;
    double *blocks = malloc((size_t)n * n * sizeof *blocks), largest = 0.0;
    assert_int_equal(inverse_gather(body.inverse, &(inverse_blocks){CUBE_NODES, all, CUBE_NODES, all, blocks, n}, &why), TROCAR_OK);
    for (int i = 0; i < n * n; i++) largest = fmax(largest, fabs(expected.matrix[i]));
    for (int i = 0; i < n * n; i++) assert_close(blocks[i], expected.matrix[i], 1e-11 * largest);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < i; j++) assert_true(blocks[i * n + j] == blocks[j * n + i]);
    free(blocks);
    reference_free(&expected);
}

/* Compares the stiffness matrix that the oracles update with the inverse, through products of both with a vector. */
static void dense_matrix_uses_the_numbering_of_the_tissue(void **state) {
    (void)state;
    size_t n = (size_t)body.tissue.dof_count;
    double *matrix = dense_matrix(body.inverse), largest = 0.0;
    vec3 force[CUBE_NODES], expected[CUBE_NODES];
    assert_true(is_dense(body.inverse) && matrix);
    for (int i = 0; i < CUBE_NODES; i++) force[i] = cube_random_vector(1.0);
    inverse_apply(body.inverse, force, expected);
    for (int i = 0; i < CUBE_NODES; i++) largest = fmax(largest, v3_norm(expected[i]));
    for (int i = 0; i < CUBE_NODES; i++)
        for (int a = 0; a < 3 && body.tissue.dof[i] >= 0; a++) {
            double sum = 0.0;
            for (int k = 0; k < CUBE_NODES; k++)
                for (int b = 0; b < 3 && body.tissue.dof[k] >= 0; b++)
                    sum += matrix[(size_t)(body.tissue.dof[k] + b) * n + (size_t)(body.tissue.dof[i] + a)] * (&force[k].x)[b];
            assert_close(sum, (&expected[i].x)[a], 1e-12 * largest);
        }
    assert_ptr_equal(inverse_tissue(body.inverse), &body.tissue);
    free(matrix);
}

/* Compares rows computed on demand with the whole matrix: one by one, several at once, and as displacement fields. */
static void sparse_rows_match_dense_rows(void **state) {
    (void)state;
    trocar_error why;
    inverse *sparse;
    assert_int_equal(inverse_create_sparse(&body.tissue, SPARSE_CACHE, &sparse, &why), TROCAR_OK);
    assert_false(is_dense(sparse));
    int all[CUBE_NODES];
    enum { N = 3 * CUBE_NODES };
    double *dense = calloc(2 * N * N, sizeof *dense), *found = dense + N * N, largest = 0.0;
    for (int i = 0; i < CUBE_NODES; i++) all[i] = i;
    assert_int_equal(inverse_gather(body.inverse, &(inverse_blocks){CUBE_NODES, all, CUBE_NODES, all, dense, N}, &why), TROCAR_OK);
    for (int i = 0; i < CUBE_NODES; i++) assert_int_equal(inverse_gather(sparse, &(inverse_blocks){1, &all[i], 1, &all[CUBE_NODES - 1 - i], found, N}, &why), TROCAR_OK);
    assert_int_equal(inverse_gather(sparse, &(inverse_blocks){CUBE_NODES, all, CUBE_NODES, all, found, N}, &why), TROCAR_OK);
    for (int i = 0; i < N * N; i++) largest = fmax(largest, fabs(dense[i]));
    for (int i = 0; i < N * N; i++) assert_close(found[i], dense[i], 1e-12 * largest);
    vec3 force[CUBE_NODES], one[CUBE_NODES], other[CUBE_NODES];
    for (int i = 0; i < CUBE_NODES; i++) force[i] = cube_random_vector(1.0);
    inverse_apply(body.inverse, force, one);
    inverse_apply(sparse, force, other);
    for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(other[i], one[i], 1e-11 * N * largest);
    free(dense);
    inverse_free(sparse);
}

/* Uses a cache of minimum size on a mesh with several times as many nodes, so that requests for blocks evict earlier results. */
static void full_cache_gives_correct_results(void **state) {
    (void)state;
    enum { SIDE = 40, LD = 3 * SIDE };
    trocar_error why;
    mesh m;
    tissue t;
    inverse *sparse, *dense;
    region_material materials[MESH_MAX_GROUPS];
    assert_int_equal(mesh_read(MESHES "/prostate-570.msh", &m, &why), TROCAR_OK);
    for (int g = 0; g < MESH_MAX_GROUPS; g++) materials[g] = (region_material){.youngs_modulus = 2e4, .poisson_ratio = 0.45};
    bool *fixed = calloc((size_t)m.node_count, sizeof *fixed);
    for (int i = 0; i < m.node_count; i++) fixed[i] = m.nodes[i].z > 0.0999;
    assert_int_equal(tissue_create(&m, materials, fixed, STRAIN_BY_PATCH, &t, &why), TROCAR_OK);
    assert_int_equal(inverse_create_sparse(&t, 0.0, &sparse, &why), TROCAR_OK);
    assert_int_equal(inverse_create_dense(&t, (inverse_progress){0}, &dense, &why), TROCAR_OK);
    double largest = 0.0;
    for (int n = 0; n < 30; n++) {
        int rows[SIDE], columns[SIDE];
        static double expected[LD * LD], found[LD * LD];
        for (int i = 0; i < SIDE; i++) rows[i] = rand() % m.node_count, columns[i] = rand() % m.node_count; /* including repeated and fixed nodes */
        assert_int_equal(inverse_gather(dense, &(inverse_blocks){SIDE, rows, SIDE, columns, expected, LD}, &why), TROCAR_OK);
        assert_int_equal(inverse_gather(sparse, &(inverse_blocks){SIDE, rows, SIDE, columns, found, LD}, &why), TROCAR_OK);
        for (int i = 0; i < LD * LD; i++) largest = fmax(largest, fabs(expected[i]));
        for (int i = 0; i < LD * LD; i++) assert_close(found[i], expected[i], 1e-10 * largest);
    }
    inverse_free(dense);
    inverse_free(sparse);
    tissue_free(&t);
    mesh_free(&m);
    free(fixed);
}

static int allocations_left;

static void *scarce_malloc(size_t size) { return allocations_left-- > 0 ? malloc(size) : NULL; }

/* CHOLMOD's allocations fail after a given number of calls. Creating the inverse must either fail cleanly or succeed. */
static void sparse_inverse_reports_lack_of_memory(void **state) {
    (void)state;
    struct SuiteSparse_config_struct *config = dlsym(RTLD_DEFAULT, "SuiteSparse_config");
    assert_non_null(config);
    vec3 force[CUBE_NODES], expected[CUBE_NODES], found[CUBE_NODES];
    for (int i = 0; i < CUBE_NODES; i++) force[i] = cube_random_vector(1.0);
    inverse_apply(body.inverse, force, expected);
    void *(*before)(size_t) = config->malloc_func;
    int refused = 0;
    trocar_status status = TROCAR_NO_MEMORY;
    for (int allowed = 0; status != TROCAR_OK && allowed < 1000; allowed++) {
        inverse *sparse = NULL;
        trocar_error why = {""};
        allocations_left = allowed;
        config->malloc_func = scarce_malloc;
        status = inverse_create_sparse(&body.tissue, 1e6, &sparse, &why);
        if (status == TROCAR_OK) inverse_apply(sparse, force, found);
        config->malloc_func = before;
        if (status == TROCAR_OK) inverse_free(sparse);
        else {
            assert_int_equal(status, TROCAR_NO_MEMORY);
            assert_true(why.text[0] != '\0');
            refused++;
        }
    }
    assert_true(refused > 1 && status == TROCAR_OK);
    for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(found[i], expected[i], 1e-9 * v3_norm(expected[i]) + 1e-15);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sparse_inverse_reports_lack_of_memory),
        cmocka_unit_test(stiffness_times_inverse_is_identity),
        cmocka_unit_test(force_and_displacement_may_alias),
        cmocka_unit_test(gathered_blocks_are_responses_to_unit_forces),
        cmocka_unit_test(all_blocks_match_lapack),
        cmocka_unit_test(dense_matrix_uses_the_numbering_of_the_tissue),
        cmocka_unit_test(sparse_rows_match_dense_rows),
        cmocka_unit_test(full_cache_gives_correct_results),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
