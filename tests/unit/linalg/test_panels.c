/* Compares elimination in several panels, of all pivots or only some, with LAPACK's Cholesky factorisation of the whole matrix. */
#include <lapacke.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "linalg/panels.h"

#include <cmocka.h>

#include "check.h"

enum { N = 1300, COLUMNS = 1260, PIVOTS = 700 }; /* panels of 576 and 124 pivots, and 560 other columns */

/* Returns A + A^T + 2 N 1 in column-major order, with random entries of A in [0, 1]. */
static double *random_matrix(void) {
    double *a = calloc((size_t)N * N, sizeof *a);
    for (int j = 0; j < N; j++)
        for (int i = j; i < N; i++) a[j * N + i] = a[i * N + j] = (double)rand() / RAND_MAX + (i == j ? 2.0 * N : 0.0);
    return a;
}

/* Replaces the remaining block by a - a_0 a_00^-1 a_0^T, and the first `pivots` columns by those of L. */
static void eliminate(double *a, int pivots) {
    assert_int_equal(LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', pivots, a, N), 0);
    for (int j = 0; j < pivots; j++)
        for (int i = pivots; i < N; i++) {
            double sum = a[j * N + i];
            for (int k = 0; k < j; k++) sum -= a[k * N + i] * a[k * N + j];
            a[j * N + i] = sum / a[j * N + j];
        }
    for (int k = 0; k < pivots; k++)
        for (int j = pivots; j < N; j++)
            for (int i = j; i < N; i++) a[j * N + i] -= a[k * N + i] * a[k * N + j];
}

static panels filled(const double *a, int columns, int pivots) {
    panels p;
    double bytes = 0.0;
    assert_true(panels_divide(&p, N, columns, pivots));
    for (int k = 0; k < p.count; k++) {
        panel *q = &p.panels[k];
        assert_true(panel_allocate(q, NULL));
        for (int c = 0; c < q->width; c++)
            for (int r = c; r < q->rows; r++) ((double *)q->values)[c * q->rows + r] = a[(q->first + c) * N + q->first + r];
        bytes += 8.0 * q->rows * q->width;
    }
    if (pivots == columns) assert_true(bytes == panels_bytes(N, columns));
    return p;
}

static void agrees_with_lapack(void **state) {
    (void)state;
    static const int cases[][2] = {{COLUMNS, PIVOTS}, {COLUMNS, 576}, {N, N}, {COLUMNS, 3}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        int columns = cases[i][0], pivots = cases[i][1], pivot_panels = (pivots + PANEL_WIDTH - 1) / PANEL_WIDTH;
        double *a = random_matrix();
        panels p = filled(a, columns, pivots);
        assert_int_equal(p.panels[pivot_panels - 1].first + p.panels[pivot_panels - 1].width, pivots);
        eliminate(a, pivots);
        for (int j = 0; j < p.count; j++) assert_true(panels_eliminate(&p, j, pivot_panels, NULL));
        for (int k = 0; k < p.count; k++)
            for (int c = 0; c < p.panels[k].width; c++)
                for (int r = 0; r < p.panels[k].rows; r++) {
                    double expected = r < c ? 0.0 : a[(p.panels[k].first + c) * N + p.panels[k].first + r];
                    assert_close(((double *)p.panels[k].values)[c * p.panels[k].rows + r], expected, 1e-12 * N);
                }

        double load[N], solved[N];
        for (int r = 0; r < N; r++) load[r] = solved[r] = sin(r);
        for (int j = 0; j < pivots; j++) {
            solved[j] /= a[j * N + j];
            for (int r = j + 1; r < N; r++) solved[r] -= a[j * N + r] * solved[j];
        }
        panels_forward(&p, pivot_panels, load);
        for (int r = 0; r < N; r++) assert_close(load[r], solved[r], 1e-13 * N);
        panels_free(&p);
        free(a);
    }
}

static void negative_pivot_is_found(void **state) {
    (void)state;
    double *a = random_matrix();
    a[650 * N + 650] = -1.0; /* a negative pivot in the second panel */
    panels p = filled(a, COLUMNS, PIVOTS);
    assert_true(panels_eliminate(&p, 0, 2, NULL));
    assert_false(panels_eliminate(&p, 1, 2, NULL));
    panels_free(&p);
    assert_int_equal(p.count, 0);
    free(a);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {cmocka_unit_test(agrees_with_lapack), cmocka_unit_test(negative_pivot_is_found)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
