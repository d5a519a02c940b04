/* Conjugate gradients against CHOLMOD's solution, from good and bad starts; what cannot be solved is reported. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "cube.h"
#include "inverse/conjugate_gradients.h"

#include <cmocka.h>

#include "check.h"

static const double TOLERANCE = 1e-10;
enum { STEPS = 2000, N = 3 * (CUBE_NODES - CUBE_SIDE * CUBE_SIDE) };
static cube body;
static double force[N], expected[N], largest;

static int create(void **state) {
    (void)state;
    report why;
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

/* From zero, from close by, from far away, from the solution of a force that is much larger, and from what is no number. */
static void the_solution_does_not_depend_on_the_start(void **state) {
    (void)state;
    for (int start = 0; start < 5; start++) {
        double u[N];
        for (int i = 0; i < N; i++) {
            const double starts[5] = {0.0, expected[i] + 1e-3 * largest * cube_random(-1.0, 1.0), 1e20 * cube_random(-1.0, 1.0), 1e6 * expected[i], NAN};
            u[i] = starts[start];
        }
        assert_true(conjugate_gradients(body.tissue.stiffness, TOLERANCE, STEPS, force, u));
        for (int i = 0; i < N; i++) assert_close(u[i], expected[i], 1e-8 * largest);
    }
}

static void no_force_gives_no_displacement(void **state) {
    (void)state;
    double nothing[N] = {0.0}, u[N];
    for (int i = 0; i < N; i++) u[i] = expected[i];
    assert_true(conjugate_gradients(body.tissue.stiffness, TOLERANCE, STEPS, nothing, u));
    for (int i = 0; i < N; i++) assert_true(u[i] == 0.0);
}

static void a_force_that_is_not_finite_is_refused(void **state) {
    (void)state;
    static const double bad[] = {NAN, INFINITY, -INFINITY};
    for (int k = 0; k < 3; k++) {
        double f[N], u[N] = {0.0};
        memcpy(f, force, sizeof f);
        f[17] = bad[k];
        assert_false(conjugate_gradients(body.tissue.stiffness, TOLERANCE, STEPS, f, u));
    }
}

/* Multiplies K's diagonal. */
static cholmod_sparse *with_diagonal(double factor) {
    cholmod_sparse *k = cholmod_copy_sparse(body.tissue.stiffness, &body.tissue.common);
    for (int j = 0; j < N; j++) ((double *)k->x)[((const int *)k->p)[j]] *= factor;
    return k;
}

/* With positive diagonals, negative ones, and zeros. */
static void an_indefinite_matrix_is_refused(void **state) {
    (void)state;
    static const double factors[] = {0.9, 0.5, -1.0, 0.0};
    for (int k = 0; k < 4; k++) {
        double u[N] = {0.0};
        cholmod_sparse *indefinite = with_diagonal(factors[k]);
        assert_false(conjugate_gradients(indefinite, TOLERANCE, STEPS, force, u));
        cholmod_free_sparse(&indefinite, &body.tissue.common);
    }
    int start[] = {0, 2, 3}, row[] = {0, 1, 1};
    double value[] = {1, 2, 1}, f[] = {1, -1}, u[] = {0, 0}; /* eigenvalues 3 and -1 */
    cholmod_sparse two = {.nrow = 2, .ncol = 2, .nzmax = 3, .p = start, .i = row, .x = value, .stype = -1, .itype = CHOLMOD_INT,
                          .xtype = CHOLMOD_REAL, .sorted = 1, .packed = 1};
    assert_false(conjugate_gradients(&two, TOLERANCE, STEPS, f, u));
}

/* -u'' = 1 between fixed ends: the number of steps grows with that of unknowns. */
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
    assert_false(conjugate_gradients(&string, TOLERANCE, STEPS, f, u));
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_solution_does_not_depend_on_the_start),
        cmocka_unit_test(no_force_gives_no_displacement),
        cmocka_unit_test(a_force_that_is_not_finite_is_refused),
        cmocka_unit_test(an_indefinite_matrix_is_refused),
        cmocka_unit_test(steps_are_limited),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
