/* 3 x 3 matrices stored as rows of four numbers, the fourth of which is padding, so that products can use vector registers. */
#ifndef TROCAR_ROW_MATRIX_H
#define TROCAR_ROW_MATRIX_H

#include "linalg/simd4.h"
#include "base/vec.h"

typedef struct {
    simd4 row[3];
} row_matrix;

static inline mat3 matrix_of(row_matrix a) {
    mat3 m;
    double *x = &m.m[0][0];
    simd4_store(x, a.row[0]);
    simd4_store(x + 3, a.row[1]);
    for (int i = 0; i < 3; i++) x[6 + i] = a.row[2][i];
    return m;
}

/* Sum without the padding. */
static inline double row_sum(simd4 row) { return row[0] + row[1] + row[2]; }

static inline row_matrix rm_add(row_matrix a, row_matrix b) { return (row_matrix){{a.row[0] + b.row[0], a.row[1] + b.row[1], a.row[2] + b.row[2]}}; }
static inline row_matrix rm_scaled(double s, row_matrix a) { return (row_matrix){{s * a.row[0], s * a.row[1], s * a.row[2]}}; }
static inline row_matrix rm_subtract(row_matrix a, row_matrix b) { return (row_matrix){{a.row[0] - b.row[0], a.row[1] - b.row[1], a.row[2] - b.row[2]}}; }

/* a b */
static inline row_matrix rm_multiply(row_matrix a, row_matrix b) {
    row_matrix c;
    for (int i = 0; i < 3; i++) c.row[i] = a.row[i][0] * b.row[0] + a.row[i][1] * b.row[1] + a.row[i][2] * b.row[2];
    return c;
}

/* a^T b */
static inline row_matrix rm_multiply_transposed(row_matrix a, row_matrix b) {
    row_matrix c;
    for (int i = 0; i < 3; i++) c.row[i] = a.row[0][i] * b.row[0] + a.row[1][i] * b.row[1] + a.row[2][i] * b.row[2];
    return c;
}

#endif
