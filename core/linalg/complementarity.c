#include "linalg/complementarity.h"

#include <lapacke.h>
#include <stddef.h>

enum { CHANCES = 10, MOST_PIVOTS = 1000 };

/* Computes the positive entries of z by factorising the corresponding principal submatrix of A, and sets the others to 0. */
static bool solve_positive(int n, const double *a, int ld, const double *q, const double *positive, double *z, double *part) {
    int count = 0;
    for (int i = 0; i < n; i++) {
        z[i] = 0.0;
        if (positive[i] == 0.0) continue;
        int row = count++;
        for (int j = 0, column = 0; j <= i; j++)
            if (positive[j] != 0.0) part[(size_t)row * (size_t)n + (size_t)column++] = a[(size_t)i * (size_t)ld + (size_t)j];
    }
    double *right = part + (size_t)n * (size_t)n;
    for (int i = 0, row = 0; i < n; i++)
        if (positive[i] != 0.0) right[row++] = -q[i];
    if (count > 0 && LAPACKE_dposv(LAPACK_COL_MAJOR, 'U', count, 1, part, n, right, n) != 0) return false;
    for (int i = 0, row = 0; i < n; i++)
        if (positive[i] != 0.0) z[i] = right[row++];
    return true;
}

bool complementarity_solve(int n, const double *a, int ld, const double *q, double tolerance, double *z, double *scratch) {
    double *positive = scratch, *part = scratch + n; /* part: n x n, plus n entries for the right-hand side */
    int fewest = n + 1, chances = CHANCES;
    for (int i = 0; i < n; i++) positive[i] = z[i] > 0.0;
    for (int pivot = 0; pivot < MOST_PIVOTS; pivot++) {
        if (!solve_positive(n, a, ld, q, positive, z, part)) return false;
        double *wrong = part; /* 1 for an entry with the wrong sign */
        int count = 0, last = -1;
        for (int i = 0; i < n; i++) {
            double w = q[i];
            for (int j = 0; j < n && positive[i] == 0.0; j++) w += a[(size_t)i * (size_t)ld + (size_t)j] * z[j];
            wrong[i] = positive[i] != 0.0 ? z[i] < 0.0 : w < -tolerance;
            if (wrong[i] != 0.0) count++, last = i;
        }
        if (count == 0) return true;
        if (count < fewest) fewest = count, chances = CHANCES;
        else chances--;
        for (int i = 0; i < n; i++)
            if (wrong[i] != 0.0 && (chances >= 0 || i == last)) positive[i] = 1.0 - positive[i];
    }
    return false;
}
