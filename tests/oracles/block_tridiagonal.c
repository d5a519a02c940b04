#include "oracles/block_tridiagonal.h"

#include <math.h>
#include <string.h>

/* ---- one block ------------------------------------------------------------------------------------------------------- */

static void swap_rows(tridiagonal_block a, int p, int q) {
    double row[TRIDIAGONAL_LD];
    if (p == q) return;
    memcpy(row, a[p], sizeof row);
    memcpy(a[p], a[q], sizeof row);
    memcpy(a[q], row, sizeof row);
}

static int pivot_row(tridiagonal_block a, int column) {
    int best = column;
    for (int i = column + 1; i < TRIDIAGONAL_ROWS; i++)
        if (fabs(a[i][column]) > fabs(a[best][column])) best = i;
    return best;
}

/* Inverts in place by Gauss-Jordan elimination with row exchanges, then exchanges the corresponding columns of the inverse. */
static void invert(tridiagonal_block a) {
    int exchanged[TRIDIAGONAL_ROWS];
    for (int p = 0; p < TRIDIAGONAL_ROWS; p++) {
        exchanged[p] = pivot_row(a, p);
        swap_rows(a, p, exchanged[p]);
        double scale = 1.0 / a[p][p];
        a[p][p] = 1.0;
        for (int j = 0; j < TRIDIAGONAL_LD; j++) a[p][j] *= scale;
        for (int i = 0; i < TRIDIAGONAL_ROWS; i++) {
            if (i == p) continue;
            double factor = a[i][p];
            a[i][p] = 0.0;
            for (int j = 0; j < TRIDIAGONAL_LD; j++) a[i][j] -= factor * a[p][j];
        }
    }
    for (int p = TRIDIAGONAL_ROWS - 1; p >= 0; p--)
        for (int i = 0; i < TRIDIAGONAL_ROWS; i++) {
            double value = a[i][p];
            a[i][p] = a[i][exchanged[p]];
            a[i][exchanged[p]] = value;
        }
}

static void multiply(tridiagonal_block a, tridiagonal_block b, tridiagonal_block out) {
    for (int i = 0; i < TRIDIAGONAL_ROWS; i++) {
        double row[TRIDIAGONAL_LD] = {0};
        for (int k = 0; k < TRIDIAGONAL_ROWS; k++)
            for (int j = 0; j < TRIDIAGONAL_LD; j++) row[j] += a[i][k] * b[k][j];
        memcpy(out[i], row, sizeof row);
    }
}

static void transpose(tridiagonal_block a, tridiagonal_block out) {
    memset(out, 0, sizeof(tridiagonal_block));
    for (int i = 0; i < TRIDIAGONAL_ROWS; i++)
        for (int j = 0; j < TRIDIAGONAL_ROWS; j++) out[j][i] = a[i][j];
}

/* ---- the chain ------------------------------------------------------------------------------------------------------- */

void tridiagonal_factor(block_tridiagonal *chain) {
    tridiagonal_block eliminated, turned, product;
    for (int k = 0; k < chain->count; k++) {
        invert(chain->diagonal[k]);
        if (k + 1 == chain->count) break;
        multiply(chain->diagonal[k], chain->upper[k], eliminated);
        transpose(chain->upper[k], turned);
        multiply(turned, eliminated, product);
        for (int i = 0; i < TRIDIAGONAL_ROWS; i++)
            for (int j = 0; j < TRIDIAGONAL_LD; j++) chain->diagonal[k + 1][i][j] -= product[i][j];
        memcpy(chain->upper[k], eliminated, sizeof eliminated);
    }
}

void tridiagonal_solve(const block_tridiagonal *chain, double (*x)[TRIDIAGONAL_ROWS]) {
    for (int k = 1; k < chain->count; k++)
        for (int i = 0; i < TRIDIAGONAL_ROWS; i++)
            for (int j = 0; j < TRIDIAGONAL_ROWS; j++) x[k][j] -= chain->upper[k - 1][i][j] * x[k - 1][i];
    for (int k = chain->count - 1; k >= 0; k--) {
        double y[TRIDIAGONAL_ROWS];
        for (int i = 0; i < TRIDIAGONAL_ROWS; i++) {
            y[i] = 0.0;
            for (int j = 0; j < TRIDIAGONAL_ROWS; j++) y[i] += chain->diagonal[k][i][j] * x[k][j];
            for (int j = 0; k + 1 < chain->count && j < TRIDIAGONAL_ROWS; j++) y[i] -= chain->upper[k][i][j] * x[k + 1][j];
        }
        memcpy(x[k], y, sizeof y);
    }
}

/* Computes diagonal block k of the inverse from block k + 1: G_k = S_k^-1 + T_k G_{k+1} T_k^T with T_k = S_k^-1 B_k. */
static void next_own_block(block_tridiagonal *chain, int k, tridiagonal_block own) {
    tridiagonal_block product, turned;
    multiply(chain->upper[k], own, product);
    transpose(chain->upper[k], turned);
    multiply(product, turned, own);
    for (int i = 0; i < TRIDIAGONAL_ROWS; i++)
        for (int j = 0; j < TRIDIAGONAL_LD; j++) own[i][j] += chain->diagonal[k][i][j];
}

/* Computes the rows of block k of the inverse for the columns [begin, end) of the later blocks: G_kj = -T_k G_{k+1,j}. */
static void next_rows(tridiagonal_block factor, tridiagonal_rows *from, tridiagonal_rows *to, int begin, int end) {
    for (int i = 0; i < TRIDIAGONAL_ROWS; i++) {
        double *row = to[i];
        for (int c = begin; c < end; c++) row[c] = 0.0;
        for (int m = 0; m < TRIDIAGONAL_ROWS; m++) {
            double f = factor[i][m];
            const double *source = from[m];
            for (int c = begin; c < end; c++) row[c] -= f * source[c];
        }
    }
}

void tridiagonal_inverse_heads(block_tridiagonal *chain, int first, double *out, int ld) {
    int n = chain->count, end = TRIDIAGONAL_HEAD * n;
    tridiagonal_block own;
    for (int k = n - 1; k >= first; k--) {
        tridiagonal_rows *rows = chain->columns[k % 2];
        int begin = TRIDIAGONAL_HEAD * k;
        if (k == n - 1) {
            memcpy(own, chain->diagonal[k], sizeof own);
        } else {
            next_rows(chain->upper[k], chain->columns[(k + 1) % 2], rows, begin + TRIDIAGONAL_HEAD, end);
            next_own_block(chain, k, own);
        }
        for (int i = 0; i < TRIDIAGONAL_ROWS; i++)
            for (int b = 0; b < TRIDIAGONAL_HEAD; b++) rows[i][begin + b] = own[i][b];
        for (int a = 0; a < TRIDIAGONAL_HEAD; a++)
            for (int c = begin; c < end; c++) out[(begin + a) * ld + c] = out[c * ld + begin + a] = rows[a][c];
    }
}
