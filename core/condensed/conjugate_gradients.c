#include "condensed/conjugate_gradients.h"

#include <cblas.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* K = L + D + L^T, with L strictly lower. */
typedef struct {
    int n;
    const int *start, *row;
    const double *value;     /* values of each column, starting with the diagonal */
} split;

static double diagonal(const split *k, int i) { return k->value[k->start[i]]; }

/* x <- (D + L)^-1 x */
static void solve_lower(const split *k, double *x) {
    for (int j = 0; j < k->n; j++) {
        x[j] /= diagonal(k, j);
        for (int e = k->start[j] + 1; e < k->start[j + 1]; e++) x[k->row[e]] -= k->value[e] * x[j];
    }
}

/* y = (D + L^T)^-1 x and v = L y, in one pass over L */
static void solve_upper(const split *k, const double *x, double *y, double *v) {
    memset(v, 0, (size_t)k->n * sizeof *v);
    for (int j = k->n - 1; j >= 0; j--) {
        double sum = x[j];
        for (int e = k->start[j] + 1; e < k->start[j + 1]; e++) sum -= k->value[e] * y[k->row[e]];
        y[j] = sum / diagonal(k, j);
        for (int e = k->start[j] + 1; e < k->start[j + 1]; e++) v[k->row[e]] += k->value[e] * y[j];
    }
}

/* q = z + (D + L)^-1 L^T z, in one pass over L; returns p . q with p = (D + L^T) z */
static double apply(const split *k, const double *z, double *q) {
    double bend = 0.0;
    memset(q, 0, (size_t)k->n * sizeof *q);
    for (int j = 0; j < k->n; j++) {
        double sum = 0.0;
        for (int e = k->start[j] + 1; e < k->start[j + 1]; e++) sum += k->value[e] * z[k->row[e]];
        double x = (sum - q[j]) / diagonal(k, j);
        for (int e = k->start[j] + 1; e < k->start[j + 1]; e++) q[k->row[e]] += k->value[e] * x;
        q[j] = z[j] + x;
        bend += (diagonal(k, j) * z[j] + sum) * q[j];
    }
    return bend;
}

/* r = f - K u */
static void find_residual(const split *k, const double *f, const double *u, double *r) {
    memcpy(r, f, (size_t)k->n * sizeof *r);
    for (int j = 0; j < k->n; j++) {
        double sum = diagonal(k, j) * u[j];
        for (int e = k->start[j] + 1; e < k->start[j + 1]; e++) {
            sum += k->value[e] * u[k->row[e]];
            r[k->row[e]] -= k->value[e] * u[j];
        }
        r[j] -= sum;
    }
}

/* Vectors of n numbers each. */
typedef struct { double *residual, *scaled, *direction, *upper, *product; } workspace;

/* Iterates from u until the residual of the transformed system has fallen by the factor `fall`, at most *steps times, and subtracts the number of iterations
   from *steps. Returns false if K turns out not to be positive definite, or if out of memory.
   The transformed system is K' u' = f' with K' = (D + L)^-1 K (D + L^T)^-1, preconditioned by D. The search directions are z = (D + L^T)^-1 p', and K' p' = z +
   (D + L)^-1 L^T z. They are kept conjugate to the coarse space (Saad et al., A deflated version of the conjugate gradient algorithm, SIAM J. Sci. Comput. 21,
   2000). This needs K y for y = (D + L^T)^-1 D r', which equals D r' + L y. */
static bool search(const split *k, coarse_space *coarse, double fall, int *steps, workspace *w, double *u) {
    int n = k->n;
    double *r = w->residual, *s = w->scaled, *z = w->direction, *y = w->upper, *q = w->product, first = 0.0, last = 0.0;
    solve_lower(k, r);
    memset(z, 0, (size_t)n * sizeof *z);
    for (int step = 0; *steps > 0; step++, --*steps) {
        double size = 0.0;
        for (int i = 0; i < n; i++) size += r[i] * (s[i] = diagonal(k, i) * r[i]);
        if (step == 0) first = size;
        if (size <= fall * fall * first) return true;
        solve_upper(k, s, y, q);
        double kept = step == 0 ? 0.0 : size / last;
        for (int i = 0; i < n; i++) z[i] = y[i] + kept * z[i];
        if (coarse) {
            cblas_daxpy(n, 1.0, s, 1, q, 1);
            if (!coarse_space_solve(coarse, q, y)) return false;
            cblas_daxpy(n, -1.0, y, 1, z, 1);
        }
        double bend = apply(k, z, q);
        if (!(bend > 0.0)) return false;
        double way = size / bend;
        cblas_daxpy(n, way, z, 1, u, 1); /* u = (D + L^T)^-1 u' */
        cblas_daxpy(n, -way, q, 1, r, 1);
        last = size;
    }
    return true;
}

/* Corrects u within the coarse space, so that the residual has no component left in it. */
static bool correct(const split *k, coarse_space *coarse, const double *f, workspace *w, double *u) {
    if (!coarse) return true;
    if (!coarse_space_solve(coarse, w->residual, w->upper)) return false;
    cblas_daxpy(k->n, 1.0, w->upper, 1, u, 1);
    find_residual(k, f, u, w->residual);
    return true;
}

static bool has_positive_diagonal(const split *k) {
    for (int i = 0; i < k->n; i++)
        if (!(diagonal(k, i) > 0.0)) return false;
    return true;
}

/* How far the residual falls between coarse corrections, as a factor. The corrections have to be repeated, because rounding errors bring back what they
   remove. */
static const double COARSE_FALL = 1e-5;

bool conjugate_gradients(const cholmod_sparse *matrix, coarse_space *coarse, double tolerance, int steps, const double *f, double *u) {
    const split k = {(int)matrix->ncol, matrix->p, matrix->i, matrix->x};
    size_t n = (size_t)k.n;
    double size = cblas_dnrm2(k.n, f, 1), wanted = tolerance * size, before = INFINITY;
    double *numbers = has_positive_diagonal(&k) ? malloc(5 * n * sizeof *numbers) : NULL;
    if (!numbers) return false;
    workspace w = {numbers, numbers + n, numbers + 2 * n, numbers + 3 * n, numbers + 4 * n};
    find_residual(&k, f, u, w.residual);
    double left = cblas_dnrm2(k.n, w.residual, 1);
    if (!(left <= size)) { /* zero is a better starting point than u */
        memset(u, 0, n * sizeof *u);
        memcpy(w.residual, f, n * sizeof *f);
        left = size;
    }
    bool definite = true;
    while (definite && steps > 0 && left > wanted && left < before) { /* loop, because the true residual may fall less than the transformed one */
        before = 0.9 * left;
        definite = correct(&k, coarse, f, &w, u) && search(&k, coarse, fmax(0.5 * wanted / left, coarse ? COARSE_FALL : DBL_EPSILON), &steps, &w, u);
        find_residual(&k, f, u, w.residual);
        left = cblas_dnrm2(k.n, w.residual, 1);
    }
    free(numbers);
    bool stagnated = steps > 0 && left >= before && !coarse; /* u is as accurate as rounding allows; with a coarse space, stagnation does not show that */
    return definite && isfinite(left) && (left <= wanted || stagnated);
}
