#include "insertion/elimination.h"

#include <stddef.h>

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

void turn_rows(const symmetric_system *s, int i, double cosine, double sine) {
    double *x = s->a + i * s->ld, *y = x + s->ld;
    lanes c = lanes_all(cosine), n = lanes_all(sine);
    for (int j = lanes_below(i + 2); j <= s->order; j += LANES) {
        lanes a = lanes_load(x + j), b = lanes_load(y + j);
        lanes_store(x + j, c * a - n * b);
        lanes_store(y + j, n * a + c * b);
    }
}

static void divide(const symmetric_system *s, elimination_panel *panel, int i, int from, double inverse) {
    double *row = s->a + i * s->ld, *undivided = panel->undivided[i - panel->begin];
    for (int j = lanes_below(from), end = ELIMINATION_COLUMNS(s->order); j < end; j += LANES) {
        lanes x = lanes_load(row + j);
        lanes_store(undivided + j, x);
        lanes_store(row + j, lanes_all(inverse) * x);
    }
}

void eliminate_in_panel(const symmetric_system *s, elimination_panel *panel, int i, int count, const double *inverse_pivots) {
    const double *first = s->a + i * s->ld, *last = first + (count - 1) * s->ld;
    const double *left = panel->undivided[i - panel->begin], *left_of_last = panel->undivided[i + count - 1 - panel->begin];
    for (int k = 0; k < count; k++) divide(s, panel, i + k, i + count, inverse_pivots[k]);
    for (int r = i + count; r < panel->end; r++) {
        double *row = s->a + r * s->ld;
        lanes f = lanes_all(left[r]), g = lanes_all(count == 2 ? left_of_last[r] : 0.0);
        for (int j = lanes_below(r); j <= s->order; j += LANES)
            lanes_store(row + j, lanes_load(row + j) - f * lanes_load(first + j) - g * lanes_load(last + j));
    }
}

/* Rows [i, i + TILE_ROWS), tile by tile; `count` is the panel's number of rows. */
static inline __attribute__((always_inline)) void update_rows(const symmetric_system *s, const elimination_panel *panel, int i, int count) {
    const ptrdiff_t ld = s->ld;
    const double *left = panel->undivided[0] + i, *divided = s->a + panel->begin * ld;
    for (ptrdiff_t j = lanes_below(i), end = s->order; j <= end; j += TILE_COLUMNS) {
        double *tile = s->a + i * ld + j;
        lanes sum[TILE_ROWS][2];
        for (int r = 0; r < TILE_ROWS; r++) sum[r][0] = lanes_load(tile + r * ld), sum[r][1] = lanes_load(tile + r * ld + LANES);
        for (int k = 0; k < count; k++) {
            lanes x = lanes_load(divided + k * ld + j), y = lanes_load(divided + k * ld + j + LANES);
            for (int r = 0; r < TILE_ROWS; r++) {
                lanes f = lanes_all(left[k * MOST_COLUMNS + r]);
                sum[r][0] -= f * x;
                sum[r][1] -= f * y;
            }
        }
        for (int r = 0; r < TILE_ROWS; r++) lanes_store(tile + r * ld, sum[r][0]), lanes_store(tile + r * ld + LANES, sum[r][1]);
    }
}

static void update_row(const symmetric_system *s, const elimination_panel *panel, int i) {
    double *row = s->a + i * s->ld;
    for (int k = 0; k < panel->end - panel->begin; k++) {
        const double *divided = s->a + (panel->begin + k) * s->ld;
        lanes f = lanes_all(panel->undivided[k][i]);
        for (int j = lanes_below(i); j <= s->order; j += LANES) lanes_store(row + j, lanes_load(row + j) - f * lanes_load(divided + j));
    }
}

void eliminate_after_panel(const symmetric_system *s, const elimination_panel *panel) {
    int i = panel->end, count = panel->end - panel->begin;
    for (; i + TILE_ROWS <= s->order; i += TILE_ROWS) {
        if (count == PANEL_ROWS) update_rows(s, panel, i, PANEL_ROWS);
        else update_rows(s, panel, i, count);
    }
    for (; i < s->order; i++) update_row(s, panel, i);
}

double dot_product(const double *row, const double *x, int begin, int end) {
    lanes sum = lanes_all(0.0);
    int j = begin;
    for (; j + LANES <= end; j += LANES) sum += lanes_load(row + j) * lanes_load(x + j);
    double total = lanes_sum(sum);
    for (; j < end; j++) total += row[j] * x[j];
    return total;
}
