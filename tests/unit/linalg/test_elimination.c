/* Tests that elimination with wide vectors is bit-identical to the portable kernels and agrees entry by entry with the definition. */
#include "linalg/elimination.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { MOST_ORDER = 244, LD = MOST_COLUMNS };

typedef double matrix[ELIMINATION_SIZE(MOST_ORDER)][LD];
static _Alignas(CACHE_LINE) matrix given, portable, widest, plain;

static double draw(void) { return (double)rand() / RAND_MAX - 0.5; }

/* Creates a matrix with random values even in unused entries, below the diagonal and after the right-hand side, as earlier ticks would leave them. */
static void make(int order) {
    for (int i = 0; i < ELIMINATION_SIZE(MOST_ORDER); i++)
        for (int j = 0; j < LD; j++) given[i][j] = draw() + (i == j ? order : 0.0);
}

/* Copies the matrix into `a` and eliminates it: the first `pairs` rows in pairs, each rotated slightly first, and the others one by one. */
static void eliminate(elimination_kernel *eliminate_after_panel, int order, int pairs, matrix a) {
    static elimination_panel panel;
    symmetric_system s = {a, order};
    memcpy(a, given, sizeof given);
    elimination_begin(&s);
    for (panel.end = 0; next_panel(&s, &panel, pairs);) {
        for (int k = 0; k < PANEL_ROWS; k += 2) {
            double inverse[2] = {1.0 / panel.block[k][k], 1.0 / panel.block[k + 1][k + 1]};
            turn_in_block(&panel, k, 0.96, 0.28);
            eliminate_in_block(&panel, k, 2, inverse);
        }
        eliminate_after_panel(&s, &panel);
    }
    for (panel.end = pairs; next_panel(&s, &panel, order);) {
        for (int k = 0; k < PANEL_ROWS; k++) {
            double inverse = 1.0 / panel.block[k][k];
            eliminate_in_block(&panel, k, 1, &inverse);
        }
        eliminate_after_panel(&s, &panel);
    }
}

/* Eliminates row by row, by definition, without panels. */
static void eliminate_plainly(int order, int pairs, matrix a) {
    memcpy(a, given, sizeof given);
    for (int i = 0; i < order; i += i < pairs ? 2 : 1) {
        int count = i < pairs ? 2 : 1;
        double pivot[2] = {a[i][i], count == 2 ? a[i + 1][i + 1] : 0.0};
        for (int j = i + 2; j <= order && count == 2; j++) {
            double x = a[i][j], y = a[i + 1][j];
            a[i][j] = 0.96 * x - 0.28 * y;
            a[i + 1][j] = 0.28 * x + 0.96 * y;
        }
        for (int k = 0; k < count; k++)
            for (int r = i + count; r < order; r++)
                for (int j = r; j <= order; j++) a[r][j] -= a[i + k][r] / pivot[k] * a[i + k][j];
        for (int k = 0; k < count; k++)
            for (int j = i + count; j <= order; j++) a[i + k][j] /= pivot[k];
    }
}

/* number of unknowns, and how many of them are eliminated in pairs */
static const int ORDERS[][2] = {{1, 0}, {3, 2}, {7, 4}, {16, 10}, {31, 20}, {92, 60}, {181, 120}, {244, 162}};

static bool in_a_pair(int i, int j, int pairs) { return j == i + 1 && i % 2 == 0 && j < pairs; }

static void rows_are_those_of_the_definition(void **state) {
    (void)state;
    srand(1);
    for (size_t c = 0; c < sizeof ORDERS / sizeof *ORDERS; c++) {
        int order = ORDERS[c][0], pairs = ORDERS[c][1];
        make(order);
        eliminate(elimination_portable, order, pairs, portable);
        eliminate_plainly(order, pairs, plain);
        for (int i = 0; i < order; i++)
            for (int j = i + 1; j <= order; j++) {
                if (in_a_pair(i, j, pairs)) continue; /* lost */
                assert_true(fabs(portable[i][j] - plain[i][j]) < 1e-12 * (1.0 + fabs(plain[i][j])));
            }
    }
}

static void wider_vectors_give_the_same_bits(void **state) {
    (void)state;
    if (elimination_kernel_here() == elimination_portable) skip(); /* no wide-vector kernel for this processor */
    srand(2);
    for (size_t c = 0; c < sizeof ORDERS / sizeof *ORDERS; c++) {
        int order = ORDERS[c][0], pairs = ORDERS[c][1];
        make(order);
        eliminate(elimination_portable, order, pairs, portable);
        eliminate(elimination_kernel_here(), order, pairs, widest);
        for (int i = 0; i < order; i++)
            for (int j = i + 1; j <= order; j++)
                if (!in_a_pair(i, j, pairs)) assert_memory_equal(&portable[i][j], &widest[i][j], sizeof(double));
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(rows_are_those_of_the_definition), cmocka_unit_test(wider_vectors_give_the_same_bits)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
