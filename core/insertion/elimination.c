#include "insertion/elimination.h"

#include <string.h>

#include "base/lanes.h"
#include "base/part.h"

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
    lanes sum[PANEL_ROWS] = {0};
    for (int j = known; j < s->order; j += LANES)
        IN_REGISTERS for (int r = 0; r < PANEL_ROWS; r++) sum[r] += lanes_load(&s->a[begin + r][j]) * lanes_load(x + j);
    IN_REGISTERS for (int r = 0; r < PANEL_ROWS; r++) side[r] = s->a[begin + r][s->order] - lanes_sum(sum[r]);
}

elimination_kernel *elimination_kernel_here(void) {
#ifdef TROCAR_AVX512
    if (runs_avx512()) return elimination_avx512;
#endif
    return elimination_portable;
}
