#include "linalg/between_kernels.h"
#include "linalg/simd_wide.h"
#include "linalg/vec_simd4.h"

void between_interpolate(const double *compliance, int ld, int count, const between_interpolation *points, between_components *to) {
    int begin = 3 * points[0].first;
    for (int l = 0; l < count; l += SIMD4_WIDTH) {
        const between_interpolation *p[SIMD4_WIDTH];
        for (int i = 0; i < SIMD4_WIDTH; i++) p[i] = &points[l + i < count ? l + i : count - 1];
        for (int row = begin; row < 3 * (p[SIMD4_WIDTH - 1]->first + BETWEEN_JOINTS); row++) {
            simd4 moved[SIMD4_WIDTH]; /* one component in each lane; the fourth lane is padding */
            for (int i = 0; i < SIMD4_WIDTH; i++) {
                const double *at = compliance + (ptrdiff_t)row * ld + 3 * p[i]->first;
                moved[i] = p[i]->weights[0] * simd4_load(at);
                for (int m = 1; m < BETWEEN_JOINTS; m++) moved[i] += p[i]->weights[m] * simd4_load(at + 3 * m);
            }
            simd4_transpose(&moved[0], &moved[1], &moved[2], &moved[3]);
            for (int b = 0; b < 3; b++) simd4_store(&to[row][b][l], moved[b]);
        }
    }
}

void between_store(int count, int k, between_rows blocks, double (*matrix)[MOST_COLUMNS]) {
    int axial = 2 * count, begin = simd4_below(k);
    for (int a = 0; a < 2; a++) {
        double *row = matrix[2 * k + a];
        for (int l = begin; l < count; l += SIMD4_WIDTH) {
            simd4 x = simd4_load(&blocks[a][0][l]), y = simd4_load(&blocks[a][1][l]);
            simd4_store(row + 2 * l, __builtin_shufflevector(x, y, 0, 4, 1, 5));
            simd4_store(row + 2 * l + SIMD4_WIDTH, __builtin_shufflevector(x, y, 2, 6, 3, 7));
        }
        for (int l = begin; l < count; l += SIMD4_WIDTH) simd4_store(row + axial + l, simd4_load(&blocks[a][2][l]));
    }
    for (int l = begin; l < count; l += SIMD4_WIDTH) simd4_store(matrix[axial + k] + axial + l, simd4_load(&blocks[2][2][l]));
    for (int l = k + 1; l < count; l++)
        for (int b = 0; b < 2; b++) matrix[2 * l + b][axial + k] = blocks[2][b][l];
}

between_kernel *between_kernel_here(void) {
#ifdef TROCAR_AVX512
    if (runs_avx512()) return between_avx512;
#endif
    return between_portable;
}
