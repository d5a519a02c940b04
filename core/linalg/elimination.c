#include "linalg/elimination.h"

#include <string.h>

#include "linalg/simd4.h"
#include "linalg/simd_wide.h"

/* Only the upper triangle is stored, so each off-diagonal entry contributes to its row and to its column. */
void symmetric_multiply(const symmetric_system *s, const double *x, double *product) {
    memset(product, 0, (size_t)ELIMINATION_SIZE(s->order) * sizeof *product);
    for (int i = 0; i < s->order; i += PANEL_ROWS) {
        simd4 row[PANEL_ROWS] = {0};
        IN_REGISTERS for (int r = 0; r < PANEL_ROWS; r++) {
            product[i + r] += s->a[i + r][i + r] * x[i + r];
            IN_REGISTERS for (int c = r + 1; c < PANEL_ROWS; c++) {
                product[i + r] += s->a[i + r][i + c] * x[i + c];
                product[i + c] += s->a[i + r][i + c] * x[i + r];
            }
        }
        for (int j = i + PANEL_ROWS; j < s->order; j += SIMD4_WIDTH) {
            simd4 column = simd4_load(product + j), right = simd4_load(x + j);
            IN_REGISTERS for (int r = 0; r < PANEL_ROWS; r++) {
                simd4 a = simd4_load(&s->a[i + r][j]);
                row[r] += a * right;
                column += a * simd4_all(x[i + r]);
            }
            simd4_store(product + j, column);
        }
        IN_REGISTERS for (int r = 0; r < PANEL_ROWS; r++) product[i + r] += simd4_sum(row[r]);
    }
}

void elimination_begin(const symmetric_system *s) {
    int order = s->order;
    for (int i = 0; i < order; i++) memset(&s->a[i][order + 1], 0, (PADDING - 1) * sizeof(double));
    for (int i = order; i < ELIMINATION_SIZE(order); i++) memset(&s->a[i][order / PADDING * PADDING], 0, (order % PADDING + PADDING) * sizeof(double));
}

bool next_panel(const symmetric_system *s, elimination_panel *panel, int end) {
    int begin = panel->begin = panel->end, count = end - begin < PANEL_ROWS ? end - begin : PANEL_ROWS;
    panel->end = begin + count;
    panel->turned = false;
    for (int i = 0; i < PANEL_ROWS; i++) memcpy(panel->block[i], &s->a[begin + i][begin], sizeof panel->block[i]);
    for (int j = count; j < PANEL_ROWS; j++)
        for (int i = 0; i <= j; i++) panel->block[i][j] = i == j;
    return count > 0;
}

void subtract_known(const symmetric_system *s, int begin, int known, const double *x, double side[PANEL_ROWS]) {
    simd4 sum[PANEL_ROWS] = {0};
    for (int j = known; j < s->order; j += SIMD4_WIDTH)
        IN_REGISTERS for (int r = 0; r < PANEL_ROWS; r++) sum[r] += simd4_load(&s->a[begin + r][j]) * simd4_load(x + j);
    IN_REGISTERS for (int r = 0; r < PANEL_ROWS; r++) side[r] = s->a[begin + r][s->order] - simd4_sum(sum[r]);
}

elimination_kernel *elimination_kernel_here(void) {
#ifdef TROCAR_AVX512
    if (runs_avx512()) return elimination_avx512;
#endif
    return elimination_portable;
}
