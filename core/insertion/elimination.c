#include "insertion/elimination.h"

#include "base/lanes.h"

void elimination_begin(const symmetric_system *s) {
    int end = ELIMINATION_COLUMNS(s->order);
    for (int i = 0; i < s->order; i++)
        for (int j = s->order + 1; j < end; j++) s->a[i * s->ld + j] = 0.0;
}

bool next_panel(elimination_panel *panel, int end) {
    panel->begin = panel->end;
    panel->end = panel->begin + PANEL_ROWS < end ? panel->begin + PANEL_ROWS : end;
    return panel->begin < end;
}

double dot_product(const double *row, const double *x, int begin, int end) {
    lanes sum = lanes_all(0.0);
    int j = begin;
    for (; j + LANES <= end; j += LANES) sum += lanes_load(row + j) * lanes_load(x + j);
    double total = lanes_sum(sum);
    for (; j < end; j++) total += row[j] * x[j];
    return total;
}

const elimination_kernels *elimination_kernels_here(void) {
#if defined TROCAR_AVX512 && defined __FMA__ /* the bits are the same only if both have fused multiplications */
    bool all = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd")
            && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"); /* x86-64-v4 */
    if (all) return &elimination_avx512;
#endif
    return &elimination_portable;
}
