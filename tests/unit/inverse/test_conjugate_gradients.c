/* Compares conjugate gradients and their coarse space with CHOLMOD's solution, from good and bad starting points. An unsolvable problem must be reported. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "shared/allocator_calls.h"
#include "condensed/conjugate_gradients.h"
#include "cube.h"

#include <cmocka.h>

#include "check.h"

static const double TOLERANCE = 1e-10;
enum { STEPS = 2000, N = 3 * (CUBE_NODES - CUBE_SIDE * CUBE_SIDE) };
static cube body;
static double force[N], expected[N], largest;

static int create(void **state) {
    (void)state;
    trocar_error why;
    if (cube_create(&body, 0.1, &why) != TROCAR_OK || body.tissue.dof_count != N) return -1;
    if (tissue_stiffness(&body.tissue, &why) != TROCAR_OK || (!body.tissue.factor && tissue_factor(&body.tissue, 0, NULL, &why) != TROCAR_OK)) return -1;
    tissue *t = &body.tissue;
    cholmod_dense *f = cholmod_zeros(N, 1, CHOLMOD_REAL, &t->common);
    for (int i = 0; i < N; i++) force[i] = ((double *)f->x)[i] = cube_random(-1.0, 1.0);
    cholmod_dense *u = cholmod_solve(CHOLMOD_A, t->factor, f, &t->common);
    memcpy(expected, u->x, sizeof expected);
    for (int i = 0; i < N; i++) largest = fmax(largest, fabs(expected[i]));
    cholmod_free_dense(&f, &t->common);
    cholmod_free_dense(&u, &t->common);
    return 0;
}

static int destroy(void **state) {
    (void)state;
    cube_free(&body);
    return 0;
}

/* Starts from zero, from near the solution, from far away, from the solution for a much larger force, and from NaN, each with and without a coarse space. */
static void the_solution_does_not_depend_on_the_start(void **state) {
    (void)state;
    coarse_space *coarse = coarse_space_create(&body.tissue);
    assert_non_null(coarse);
    for (int trial = 0; trial < 10; trial++) {
        int start = trial % 5;
        double u[N];
        for (int i = 0; i < N; i++) {
            const double starts[5] = {0.0, expected[i] + 1e-3 * largest * cube_random(-1.0, 1.0), 1e20 * cube_random(-1.0, 1.0), 1e6 * expected[i], NAN};
            u[i] = starts[start];
        }
        assert_true(conjugate_gradients(body.tissue.stiffness, trial < 5 ? NULL : coarse, TOLERANCE, STEPS, force, u));
        for (int i = 0; i < N; i++) assert_close(u[i], expected[i], 1e-8 * largest);
    }
    coarse_space_free(coarse);
}

static int steps_needed(coarse_space *coarse) {
    for (int steps = 1;; steps++) {
        double u[N] = {0.0};
        if (conjugate_gradients(body.tissue.stiffness, coarse, TOLERANCE, steps, force, u)) return steps;
    }
}

static void a_coarse_space_saves_steps(void **state) {
    (void)state;
    coarse_space *coarse = coarse_space_create(&body.tissue);
    assert_true(steps_needed(coarse) < steps_needed(NULL));
    coarse_space_free(coarse);
}

/* For the force K m of a rigid motion m of all free nodes, the solution is m itself. For any other force, the residual does no work in any rigid motion. */
static void rigid_motions_are_found(void **state) {
    (void)state;
    coarse_space *coarse = coarse_space_create(&body.tissue);
    cholmod_dense *motion = cholmod_zeros(N, 1, CHOLMOD_REAL, &body.tissue.common), *balance = cholmod_zeros(N, 1, CHOLMOD_REAL, &body.tissue.common);
    double one[2] = {1.0, 0.0}, zero[2] = {0.0, 0.0}, found[N];
    for (int mode = 0; mode < 6; mode++) {
        double *m = motion->x, *f = balance->x, size = 0.0;
        for (int i = 0; i < CUBE_NODES; i++) {
            int dof = body.tissue.dof[i];
            vec3 axis = v3(mode % 3 == 0, mode % 3 == 1, mode % 3 == 2), u = mode < 3 ? axis : v3_cross(axis, body.mesh.nodes[i]);
            if (dof >= 0) memcpy(&m[dof], &u, sizeof u);
            size = fmax(size, v3_norm(u));
        }
        assert_true(cholmod_sdmult(body.tissue.stiffness, 0, one, zero, motion, balance, &body.tissue.common));
        assert_true(coarse_space_solve(coarse, f, found));
        for (int i = 0; i < N; i++) assert_close(found[i], m[i], 1e-10 * size);

        assert_true(coarse_space_solve(coarse, force, found));
        double work = 0.0, scale = 0.0; /* m . (force - K found) = m . force - f . found */
        for (int i = 0; i < N; i++) {
            work += m[i] * force[i] - f[i] * found[i];
            scale += fabs(m[i] * force[i]) + fabs(f[i] * found[i]);
        }
        assert_close(work, 0.0, 1e-11 * scale);
    }
    cholmod_free_dense(&motion, &body.tissue.common);
    cholmod_free_dense(&balance, &body.tissue.common);
    coarse_space_free(coarse);
}

/* The coarse space is solved in every iteration, so its solves must not allocate memory. */
static void a_coarse_space_allocates_only_once(void **state) {
    (void)state;
    double found[N], again[N];
    coarse_space *coarse = coarse_space_create(&body.tissue);
    assert_true(coarse_space_solve(coarse, force, found));
    int64_t before = allocator_calls();
    for (int i = 0; i < 10; i++) assert_true(coarse_space_solve(coarse, force, again));
    if (ALLOCATIONS_ARE_COUNTED) assert_int_equal(allocator_calls(), before);
    assert_memory_equal(again, found, sizeof found);
    coarse_space_free(coarse);
}

static void no_force_gives_no_displacement(void **state) {
    (void)state;
    double nothing[N] = {0.0}, u[N];
    for (int i = 0; i < N; i++) u[i] = expected[i];
    assert_true(conjugate_gradients(body.tissue.stiffness, NULL, TOLERANCE, STEPS, nothing, u));
    for (int i = 0; i < N; i++) assert_true(u[i] == 0.0);
}

static void a_force_that_is_not_finite_is_refused(void **state) {
    (void)state;
    static const double bad[] = {NAN, INFINITY, -INFINITY};
    for (int k = 0; k < 3; k++) {
        double f[N], u[N] = {0.0};
        memcpy(f, force, sizeof f);
        f[17] = bad[k];
        assert_false(conjugate_gradients(body.tissue.stiffness, NULL, TOLERANCE, STEPS, f, u));
    }
}

/* Returns K with its diagonal multiplied by `factor`. */
static cholmod_sparse *with_diagonal(double factor) {
    cholmod_sparse *k = cholmod_copy_sparse(body.tissue.stiffness, &body.tissue.common);
    for (int j = 0; j < N; j++) ((double *)k->x)[((const int *)k->p)[j]] *= factor;
    return k;
}

/* Tests matrices with positive, negative and zero diagonals. */
static void an_indefinite_matrix_is_refused(void **state) {
    (void)state;
    static const double factors[] = {0.9, 0.5, -1.0, 0.0};
    for (int k = 0; k < 4; k++) {
        double u[N] = {0.0};
        cholmod_sparse *indefinite = with_diagonal(factors[k]);
        assert_false(conjugate_gradients(indefinite, NULL, TOLERANCE, STEPS, force, u));
        tissue t = body.tissue;
        t.stiffness = indefinite;
        assert_null(coarse_space_create(&t));
        cholmod_free_sparse(&indefinite, &body.tissue.common);
    }
    int start[] = {0, 2, 3}, row[] = {0, 1, 1};
    double value[] = {1, 2, 1}, f[] = {1, -1}, u[] = {0, 0}; /* indefinite, with eigenvalues 3 and -1 */
    cholmod_sparse two = {.nrow = 2, .ncol = 2, .nzmax = 3, .p = start, .i = row, .x = value, .stype = -1, .itype = CHOLMOD_INT,
                          .xtype = CHOLMOD_REAL, .sorted = 1, .packed = 1};
    assert_false(conjugate_gradients(&two, NULL, TOLERANCE, STEPS, f, u));
}

/* Solves -u'' = 1 between fixed ends, for which the iteration count grows with the number of unknowns. */
static void steps_are_limited(void **state) {
    (void)state;
    enum { MANY = 20000 };
    static int start[MANY + 1], row[2 * MANY];
    static double value[2 * MANY], f[MANY], u[MANY];
    int entries = 0;
    for (int j = 0; j < MANY; j++) {
        start[j] = entries;
        row[entries] = j;
        value[entries++] = 2.0;
        if (j + 1 < MANY) row[entries] = j + 1, value[entries++] = -1.0;
        f[j] = 1.0;
    }
    start[MANY] = entries;
    cholmod_sparse string = {.nrow = MANY, .ncol = MANY, .nzmax = 2 * MANY, .p = start, .i = row, .x = value, .stype = -1, .itype = CHOLMOD_INT,
                             .xtype = CHOLMOD_REAL, .sorted = 1, .packed = 1};
    assert_false(conjugate_gradients(&string, NULL, TOLERANCE, STEPS, f, u));
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_solution_does_not_depend_on_the_start),
        cmocka_unit_test(a_coarse_space_saves_steps),
        cmocka_unit_test(rigid_motions_are_found),
        cmocka_unit_test(a_coarse_space_allocates_only_once),
        cmocka_unit_test(no_force_gives_no_displacement),
        cmocka_unit_test(a_force_that_is_not_finite_is_refused),
        cmocka_unit_test(an_indefinite_matrix_is_refused),
        cmocka_unit_test(steps_are_limited),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
