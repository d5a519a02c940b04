/* Compares block elimination with Gaussian elimination of the whole matrix. */
#include "oracles/block_tridiagonal.h"

#include <math.h>
#include <stdbool.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>
#include <stdlib.h>
#include <string.h>

enum { MOST = 7 * TRIDIAGONAL_ROWS };
typedef struct { int size; double a[MOST][MOST]; } dense;

static double uniform(void) { return 2.0 * rand() / RAND_MAX - 1.0; }

/* Creates random symmetric blocks, some with zeros on the diagonal. The matrix is indefinite, and factorising it needs pivoting. */
static void fill(int count, block_tridiagonal *chain, dense *whole) {
    memset(chain, 0, sizeof *chain);
    memset(whole, 0, sizeof *whole);
    chain->count = count;
    whole->size = count * TRIDIAGONAL_ROWS;
    for (int k = 0; k < count; k++)
        for (int i = 0; i < TRIDIAGONAL_ROWS; i++)
            for (int j = 0; j < TRIDIAGONAL_ROWS; j++) {
                int row = k * TRIDIAGONAL_ROWS + i, column = k * TRIDIAGONAL_ROWS + j;
                if (j <= i) chain->diagonal[k][i][j] = chain->diagonal[k][j][i] = i == j && i % 2 == 0 ? 0.0 : uniform();
                if (j <= i) whole->a[row][column] = whole->a[column][row] = chain->diagonal[k][i][j];
                if (k + 1 == count) continue;
                chain->upper[k][i][j] = uniform();
                whole->a[row][column + TRIDIAGONAL_ROWS] = whole->a[column + TRIDIAGONAL_ROWS][row] = chain->upper[k][i][j];
            }
}

/* Solves in place, pivoting over all rows of the matrix. */
static void solve_dense(dense m, double *x) {
    for (int p = 0; p < m.size; p++) {
        int best = p;
        for (int i = p + 1; i < m.size; i++)
            if (fabs(m.a[i][p]) > fabs(m.a[best][p])) best = i;
        for (int j = 0; j < m.size; j++) {
            double value = m.a[p][j];
            m.a[p][j] = m.a[best][j], m.a[best][j] = value;
        }
        double value = x[p];
        x[p] = x[best], x[best] = value;
        for (int i = p + 1; i < m.size; i++) {
            double factor = m.a[i][p] / m.a[p][p];
            for (int j = p; j < m.size; j++) m.a[i][j] -= factor * m.a[p][j];
            x[i] -= factor * x[p];
        }
    }
    for (int i = m.size - 1; i >= 0; i--) {
        for (int j = i + 1; j < m.size; j++) x[i] -= m.a[i][j] * x[j];
        x[i] /= m.a[i][i];
    }
}

static double largest(const double *x, int count) {
    double size = 0.0;
    for (int i = 0; i < count; i++) size = fmax(size, fabs(x[i]));
    return size;
}

static void solutions_match_the_full_matrix(void **unused) {
    (void)unused;
    block_tridiagonal *chain = malloc(sizeof *chain);
    dense *whole = malloc(sizeof *whole);
    for (int count = 1; count <= 7; count++) {
        fill(count, chain, whole);
        double x[MOST], y[MOST];
        for (int i = 0; i < whole->size; i++) x[i] = y[i] = uniform();
        tridiagonal_factor(chain);
        tridiagonal_solve(chain, (double (*)[TRIDIAGONAL_ROWS])x);
        solve_dense(*whole, y);
        double size = largest(y, whole->size);
        for (int i = 0; i < whole->size; i++) assert_true(fabs(x[i] - y[i]) < 1e-9 * size);
    }
    free(whole);
    free(chain);
}

static void head_blocks_match_the_full_inverse(void **unused) {
    (void)unused;
    enum { COUNT = 6, FIRST = 2, LD = TRIDIAGONAL_HEAD * COUNT };
    block_tridiagonal *chain = malloc(sizeof *chain);
    dense *whole = malloc(sizeof *whole);
    double out[LD * LD];
    for (int i = 0; i < LD * LD; i++) out[i] = NAN;
    fill(COUNT, chain, whole);
    tridiagonal_factor(chain);
    tridiagonal_inverse_heads(chain, FIRST, out, LD);
    for (int c = 0; c < LD; c++) {
        double x[MOST] = {0};
        x[c / TRIDIAGONAL_HEAD * TRIDIAGONAL_ROWS + c % TRIDIAGONAL_HEAD] = 1.0;
        solve_dense(*whole, x);
        double size = largest(x, whole->size);
        for (int r = 0; r < LD; r++) {
            bool asked = r >= TRIDIAGONAL_HEAD * FIRST && c >= TRIDIAGONAL_HEAD * FIRST;
            double expected = x[r / TRIDIAGONAL_HEAD * TRIDIAGONAL_ROWS + r % TRIDIAGONAL_HEAD];
            assert_true(asked ? fabs(out[r * LD + c] - expected) < 1e-9 * size : isnan(out[r * LD + c]));
        }
    }
    free(whole);
    free(chain);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(solutions_match_the_full_matrix),
        cmocka_unit_test(head_blocks_match_the_full_inverse),
    };
    srand(1);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
