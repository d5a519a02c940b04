/* Tests the contact solver: its solution must satisfy the equations, evaluated with a copy of the data, and agree with projected Gauss-Seidel. */
#include <lapacke.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "insertion/solver/contact_solver.h"

#include <cmocka.h>

#include "check.h"

enum { MOST = MAX_UNKNOWNS };

static contact_problem given, solved; /* too large for the stack */

static double uniform(double low, double high) { return low + (high - low) * rand() / RAND_MAX; }

/* ---- problems ---- */

static int unknowns(const contact_problem *p) { return 2 * p->count + p->axial_count; }

/* Creates A = G G^T / size + diagonal, which is positive definite and well enough conditioned for Gauss-Seidel. */
static void make_compliance(contact_problem *p, int count, int axial_count, double diagonal) {
    static double g[MOST][MOST];
    memset(p, 0, sizeof *p);
    p->count = count;
    p->axial_count = axial_count;
    int size = unknowns(p);
    for (int i = 0; i < size; i++)
        for (int j = 0; j < size; j++) g[i][j] = uniform(-1, 1);
    for (int i = 0; i < size; i++)
        for (int j = 0; j < size; j++) {
            p->compliance[i][j] = i == j ? diagonal : 0.0;
            for (int k = 0; k < size; k++) p->compliance[i][j] += g[i][k] * g[j][k] / size;
        }
}

/* Creates force limits of both signs, some infinite and some equal. Half of the contacts have viscosity. */
static void make_friction(contact_problem *p) {
    for (int i = 0; i < unknowns(p); i++) p->gap[i] = uniform(-2, 2);
    for (int i = 0; i < p->axial_count; i++) {
        double middle = uniform(-0.3, 0.3), width = rand() % 6 == 0 ? 0.0 : uniform(0.0, 1.5);
        p->lower[i] = rand() % 8 == 0 ? -INFINITY : middle - width;
        p->upper[i] = rand() % 8 == 0 ? INFINITY : middle + width;
        if (width == 0.0) p->lower[i] = p->upper[i] = rand() % 2 ? middle : 0.0;
        for (int side = 0; side < 2; side++) p->viscosity[i][side] = rand() % 2 ? uniform(0.0, 2.0) : 0.0;
        p->state[i] = (friction_state)(rand() % 3 - 1);
    }
}

/* Gives one unknown a staircase law of jumps and slopes. Some slopes are zero, and the law sometimes ends at a limit that cannot be passed. */
static void make_staircase(contact_problem *p) {
    staircase *s = &p->ahead;
    p->climber = rand() % p->axial_count;
    s->count = 1 + rand() % MAX_KNOTS;
    s->back = uniform(-0.5, 0.0);
    p->lower[p->climber] = s->back;
    for (int k = 0; k < s->count; k++) {
        s->at[k] = k > 0 ? s->at[k - 1] + (rand() % 8 == 0 ? 0.0 : uniform(0.0, 0.3)) : 0.0;
        s->level[k] = k > 0 ? s->level[k - 1] + s->slope[k - 1] * (s->at[k] - s->at[k - 1]) : 0.0;
        if (rand() % 2) s->level[k] += uniform(0.0, 0.5);
        s->slope[k] = rand() % 2 ? uniform(0.0, 2.0) : 0.0;
    }
    if (rand() % 3 == 0) s->level[s->count - 1] = INFINITY;
    p->knot = rand() % s->count;
}

static void solve(void) {
    solved = given;
    assert_int_equal(contact_solve(&solved), TROCAR_OK);
}

/* ---- conditions of the solution, by substitution ---- */

static double remaining_gap(int row) {
    double gap = given.gap[row];
    for (int j = 0; j < unknowns(&given); j++) gap -= given.compliance[row][j] * solved.force[j];
    return gap;
}

static double end_of_piece(const staircase *s, int k) { return s->level[k] + s->slope[k] * (s->at[k + 1] - s->at[k]); }

/* Checks that the staircase permits the unknown's force at its slip. */
static void assert_on_staircase(double force, double slip, double tolerance) {
    const staircase *s = &given.ahead;
    if (slip < -tolerance) {
        assert_close(force, s->back, tolerance);
        return;
    }
    double least = INFINITY, most = -INFINITY; /* range of permitted forces, over slips that differ by rounding */
    for (int k = 0; k < s->count; k++) {
        bool last = k == s->count - 1;
        if (fabs(slip - s->at[k]) <= tolerance) {
            least = fmin(least, k > 0 ? end_of_piece(s, k - 1) : s->back);
            most = fmax(most, s->level[k]);
        } else if (slip > s->at[k] && (last || slip < s->at[k + 1])) {
            double on_piece = s->level[k] + s->slope[k] * (slip - s->at[k]);
            least = fmin(least, on_piece);
            most = fmax(most, on_piece);
        }
    }
    assert_true(force >= least - 2.0 * tolerance && force <= most + 2.0 * tolerance);
}

static void assert_solution(double tolerance) {
    for (int i = 0; i < 2 * given.count; i++) assert_close(remaining_gap(i), 0.0, tolerance);
    for (int i = 0; i < given.axial_count; i++) {
        double force = solved.force[2 * given.count + i], slip = solved.slip[i];
        assert_close(remaining_gap(2 * given.count + i), slip, tolerance);
        if (given.ahead.count > 0 && i == given.climber) {
            assert_on_staircase(force, slip, tolerance);
            continue;
        }
        switch (solved.state[i]) {
        case STICK:
            assert_true(slip == 0.0);
            assert_true(force >= given.lower[i] - tolerance && force <= given.upper[i] + tolerance);
            break;
        case SLIP_FORWARD:
            assert_true(slip >= 0.0);
            assert_close(force, given.upper[i] + given.viscosity[i][1] * slip, tolerance);
            break;
        case SLIP_BACKWARD:
            assert_true(slip <= 0.0);
            assert_close(force, given.lower[i] + given.viscosity[i][0] * slip, tolerance);
            break;
        default: fail();
        }
    }
}

/* Returns the force of a single axial contact under the staircase law. `gap` is the contact's remaining gap, of which every newton closes `a`. */
static double force_on_staircase(double gap, double a) {
    const staircase *s = &given.ahead;
    for (int k = 0; k < s->count; k++) {
        double here = (gap - s->at[k]) / a; /* force at which the slip stays at this knot */
        if (here > s->level[k]) continue;
        if (k == 0) return fmax(here, s->back);
        if (here >= end_of_piece(s, k - 1)) return here;
        return (s->level[k - 1] + s->slope[k - 1] * (gap - s->at[k - 1])) / (1.0 + s->slope[k - 1] * a);
    }
    int k = s->count - 1;
    return (s->level[k] + s->slope[k] * (gap - s->at[k])) / (1.0 + s->slope[k] * a);
}

static double own_force(int i, double gap, double a) {
    if (given.ahead.count > 0 && i == given.climber) return force_on_staircase(gap, a);
    double stick = gap / a, upper = given.upper[i], lower = given.lower[i];
    if (stick > upper) return (upper + given.viscosity[i][1] * gap) / (1.0 + given.viscosity[i][1] * a);
    if (stick < lower) return (lower + given.viscosity[i][0] * gap) / (1.0 + given.viscosity[i][0] * a);
    return stick;
}

/* Runs projected Gauss-Seidel over all unknowns until nothing changes. It converges for positive definite problems. */
static void gauss_seidel(double force[MOST]) {
    double change = 1.0;
    memset(force, 0, MOST * sizeof *force);
    for (int sweep = 0; sweep < 200000 && change > 1e-13; sweep++) {
        change = 0.0;
        for (int i = 0; i < unknowns(&given); i++) {
            double gap = given.gap[i], a = given.compliance[i][i];
            for (int j = 0; j < unknowns(&given); j++)
                if (j != i) gap -= given.compliance[i][j] * force[j];
            double next = i < 2 * given.count ? gap / a : own_force(i - 2 * given.count, gap, a);
            change = fmax(change, fabs(next - force[i]));
            force[i] = next;
        }
    }
    assert_true(change <= 1e-13);
}

/* ---- tests ---- */

static void random_problems_satisfy_their_conditions(void **state) {
    (void)state;
    for (int n = 0; n < 400; n++) {
        make_compliance(&given, 1 + n % 30, 1 + n % 30 + n % 2, 0.05);
        make_friction(&given);
        solve();
        assert_solution(1e-9);
    }
}

static void the_largest_problem_is_solved(void **state) {
    (void)state;
    make_compliance(&given, MAX_POINTS, MAX_AXIAL, 0.05);
    make_friction(&given);
    solve();
    assert_solution(1e-9);
}

static void solutions_equal_projected_gauss_seidel(void **state) {
    (void)state;
    double expected[MOST];
    for (int n = 0; n < 40; n++) {
        make_compliance(&given, 1 + n % 12, 1 + n % 12 + n % 2, 0.2);
        make_friction(&given);
        solve();
        gauss_seidel(expected);
        for (int i = 0; i < unknowns(&given); i++) assert_close(solved.force[i], expected[i], 1e-9);
    }
}

static void solution_does_not_depend_on_the_start(void **state) {
    (void)state;
    double first[MOST];
    for (int n = 0; n < 40; n++) {
        make_compliance(&given, 1 + n % 20, 1 + n % 20 + n % 2, 0.05);
        make_friction(&given);
        for (int start = 0; start < 10; start++) {
            for (int i = 0; i < given.axial_count; i++) given.state[i] = start < 3 ? start - 1 : rand() % 3 - 1;
            solve();
            if (start == 0) memcpy(first, solved.force, sizeof first);
            for (int i = 0; i < unknowns(&given); i++) assert_close(solved.force[i], first[i], 1e-9);
        }
        memcpy(given.state, solved.state, sizeof given.state); /* when started from the solution, the solver changes no state */
        solve();
        assert_int_equal(solved.switches, 0);
    }
}

static void staircases_equal_projected_gauss_seidel(void **state) {
    (void)state;
    double expected[MOST];
    for (int n = 0; n < 400; n++) {
        make_compliance(&given, 1 + n % 12, 1 + n % 12 + n % 2, 0.2);
        make_friction(&given);
        make_staircase(&given);
        solve();
        assert_solution(1e-9);
        gauss_seidel(expected);
        for (int i = 0; i < unknowns(&given); i++) assert_close(solved.force[i], expected[i], 1e-9);
        given.knot = solved.knot; /* when started from the solution, the solver changes nothing */
        memcpy(given.state, solved.state, sizeof given.state);
        solve();
        assert_int_equal(solved.switches, 0);
    }
}

static void infinite_bounds_stick_like_a_linear_system(void **state) {
    (void)state;
    static double a[MOST][CONTACT_LD];
    double x[MOST];
    lapack_int pivots[MOST];
    make_compliance(&given, 20, 20, 0.05);
    make_friction(&given);
    for (int i = 0; i < 20; i++) {
        given.lower[i] = -INFINITY;
        given.upper[i] = INFINITY;
    }
    solve();
    memcpy(a, given.compliance, sizeof a);
    memcpy(x, given.gap, sizeof x);
    assert_int_equal(LAPACKE_dgesv(LAPACK_ROW_MAJOR, 60, 1, &a[0][0], CONTACT_LD, pivots, x, 1), 0);
    for (int i = 0; i < 60; i++) assert_close(solved.force[i], x[i], 1e-9);
    for (int i = 0; i < 20; i++) assert_true(solved.state[i] == STICK && solved.slip[i] == 0.0);
}

static void no_axial_force_without_friction(void **state) {
    (void)state;
    make_compliance(&given, 20, 20, 0.05);
    make_friction(&given);
    for (int i = 0; i < 20; i++) given.lower[i] = given.upper[i] = given.viscosity[i][0] = given.viscosity[i][1] = 0.0;
    solve();
    assert_solution(1e-9);
    for (int i = 0; i < 20; i++) assert_true(solved.force[40 + i] == 0.0);
}

/* A single contact that can be solved by hand: A = [2 0 1; 0 4 0; 1 0 3], lateral gaps 2 and 4. Eliminating the lateral forces leaves an axial compliance of
   3 - 1/2 and an axial gap of g - 1. */
static void single_contact_matches_closed_form(void **state) {
    (void)state;
    static const double a[3][3] = {{2, 0, 1}, {0, 4, 0}, {1, 0, 3}};
    static const struct { double gap, viscosity, force, slip; friction_state friction; } cases[] = {
        {1.5, 0.0, 0.2, 0.0, STICK},          {3.5, 0.0, 0.5, 1.25, SLIP_FORWARD}, {-9.0, 0.0, -1.0, -7.5, SLIP_BACKWARD},
        {3.5, 0.4, 0.75, 0.625, SLIP_FORWARD}, /* slip = 2.5 - 2.5 f, f = 0.5 + 0.4 slip */
    };
    for (size_t c = 0; c < sizeof cases / sizeof *cases; c++) {
        memset(&given, 0, sizeof given);
        given.count = given.axial_count = 1;
        for (int i = 0; i < 9; i++) given.compliance[i / 3][i % 3] = a[i / 3][i % 3];
        memcpy(given.gap, (double[3]){2, 4, cases[c].gap}, 3 * sizeof(double));
        given.lower[0] = -1.0;
        given.upper[0] = 0.5;
        given.viscosity[0][1] = cases[c].viscosity;
        solve();
        assert_int_equal(solved.state[0], cases[c].friction);
        assert_close(solved.force[2], cases[c].force, 1e-14);
        assert_close(solved.slip[0], cases[c].slip, 1e-14);
        assert_close(solved.force[0], 1.0 - 0.5 * cases[c].force, 1e-14);
        assert_close(solved.force[1], 1.0, 1e-14);
    }
}

static int negative_eigenvalues(int size) {
    static double a[MOST][CONTACT_LD];
    double values[MOST];
    int negative = 0;
    memcpy(a, given.compliance, sizeof a);
    assert_int_equal(LAPACKE_dsyev(LAPACK_ROW_MAJOR, 'N', 'L', size, &a[0][0], CONTACT_LD, values), 0);
    for (int i = 0; i < size; i++) negative += values[i] < 0;
    return negative;
}

/* Beyond its own buckling load, a needle has negative stiffness in one lateral mode v; its compliance is (1 - v v^T) - v v^T / 0.3. The tissue is stiff
   enough to make needle and tissue stable together. */
static void buckled_needle_supported_by_tissue(void **state) {
    (void)state;
    for (int n = 0; n < 40; n++) {
        int count = 2 + n % 15;
        double v[MOST], square = 0.0;
        make_compliance(&given, count, count, 0.05);
        make_friction(&given);
        for (int i = 0; i < 2 * count; i++) {
            v[i] = uniform(-1, 1);
            square += v[i] * v[i];
        }
        for (int i = 0; i < 3 * count; i++) {
            given.compliance[i][i] += 1.0;
            for (int j = 0; j < 2 * count && i < 2 * count; j++) given.compliance[i][j] -= (1.0 + 1.0 / 0.3) * v[i] * v[j] / square;
        }
        assert_int_equal(negative_eigenvalues(2 * count), 1); /* sideways */
        assert_int_equal(negative_eigenvalues(3 * count), 1); /* so the Schur complement is definite (Haynsworth) */
        solve();
        assert_int_equal(solved.negative, 1);
        assert_solution(1e-9);
    }
}

/* As the needle approaches buckling, a single contact's lateral block becomes singular while the whole matrix stays regular. */
static void contact_with_singular_diagonal_block(void **state) {
    (void)state;
    for (int n = 0; n < 400; n++) {
        double weak = (n % 2 ? 1.0 : -1.0) * pow(10.0, -n / 20.0), angle = uniform(0, M_PI), c = cos(angle), s = sin(angle);
        make_compliance(&given, 2 + n % 6, 2 + n % 6, 0.5);
        make_friction(&given);
        given.compliance[0][0] = c * c + weak * s * s; /* eigenvalues 1 and `weak`, eigenvectors rotated by the angle */
        given.compliance[1][1] = s * s + weak * c * c;
        given.compliance[1][0] = given.compliance[0][1] = (1.0 - weak) * c * s;
        given.compliance[2][0] = given.compliance[0][2] = -2.0 * s; /* couples the direction with eigenvalue `weak` strongly to the axial force */
        given.compliance[2][1] = given.compliance[1][2] = 2.0 * c;
        assert_int_equal(negative_eigenvalues(2 * given.count), 1);
        assert_int_equal(negative_eigenvalues(3 * given.count), 1);
        solve();
        assert_int_equal(solved.negative, 1);
        assert_solution(2e-6); /* coarse, because pivots are kept above 1e-8, which costs half the significant digits */
    }
}

static void assert_refused(void) {
    solved = given;
    assert_int_equal(contact_solve(&solved), TROCAR_NUMERIC);
    for (int i = 0; i < unknowns(&given); i++) assert_true(solved.force[i] == 0.0);
}

/* Creates a problem in which all contacts stick and one of them has this axial compliance. */
static void make_axial_compliance(double value) {
    make_compliance(&given, 3, 3, 0.05);
    make_friction(&given);
    for (int i = 0; i < 3; i++) {
        given.lower[i] = -INFINITY;
        given.upper[i] = INFINITY;
    }
    for (int j = 0; j < 9; j++) given.compliance[7][j] = given.compliance[j][7] = j == 7 ? value : 0.0;
}

static void singular_problems_are_refused(void **state) {
    (void)state;
    make_axial_compliance(0.0);
    assert_refused();
}

/* A needle far beyond its buckling load may be stable only as long as its contacts stick. */
static void unstable_modes_along_the_needle_are_counted(void **state) {
    (void)state;
    make_axial_compliance(-1.0);
    solve();
    assert_int_equal(solved.negative, 1);
    assert_solution(1e-9);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(random_problems_satisfy_their_conditions),
        cmocka_unit_test(the_largest_problem_is_solved),
        cmocka_unit_test(solutions_equal_projected_gauss_seidel),
        cmocka_unit_test(solution_does_not_depend_on_the_start),
        cmocka_unit_test(staircases_equal_projected_gauss_seidel),
        cmocka_unit_test(infinite_bounds_stick_like_a_linear_system),
        cmocka_unit_test(no_axial_force_without_friction),
        cmocka_unit_test(single_contact_matches_closed_form),
        cmocka_unit_test(buckled_needle_supported_by_tissue),
        cmocka_unit_test(contact_with_singular_diagonal_block),
        cmocka_unit_test(singular_problems_are_refused),
        cmocka_unit_test(unstable_modes_along_the_needle_are_counted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
