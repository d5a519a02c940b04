/* The kernel declared in elimination.h, compiled for one vector width. */
#include "linalg/elimination.h"

#include <stddef.h>

#include "linalg/simd_wide.h"

#ifndef ELIMINATION_KERNEL
#define ELIMINATION_KERNEL elimination_portable
#endif

enum { TILE_ROWS = SIMD_WIDE_WIDTH, TILE_VECTORS = 2 };
_Static_assert((int)SIMD_WIDE_WIDTH <= PADDING && TILE_ROWS <= (int)PADDING, "the padding holds the rest of a simd_wide and of a tile");

#define INLINE static inline __attribute__((always_inline))

INLINE void turn(double cosine, double sine, simd_wide *x, simd_wide *y) {
    simd_wide c = simd_wide_all(cosine), n = simd_wide_all(sine), first = c * *x - n * *y;
    *y = n * *x + c * *y;
    *x = first;
}

/* Processes one vector of each of the panel's `count` rows, starting at column j. Eliminates the rows one by one or, if they are rotated, in pairs. */
INLINE void finish_vector(const symmetric_system *s, elimination_panel *panel, int j, int count, int step) {
    double (*row)[MOST_COLUMNS] = s->a + panel->begin;
    simd_wide x[PANEL_ROWS], divided[2];
    IN_REGISTERS for (int k = 0; k < PANEL_ROWS; k++) x[k] = k < count ? simd_wide_load(&row[k][j]) : (simd_wide){0};
    IN_REGISTERS for (int k = 0; k < PANEL_ROWS; k += step) {
        if (k >= count) break;
        if (step == 2) turn(panel->cosine[k / 2], panel->sine[k / 2], &x[k], &x[k + 1]);
        IN_REGISTERS for (int c = 0; c < step; c++) {
            divided[c] = simd_wide_all(panel->inverse[k + c]) * x[k + c];
            simd_wide_store(&panel->undivided[k + c][j], x[k + c]);
            simd_wide_store(&row[k + c][j], divided[c]);
        }
        IN_REGISTERS for (int r = k + step; r < PANEL_ROWS; r++)
            IN_REGISTERS for (int c = 0; c < step; c++) x[r] -= simd_wide_all(panel->block[k + c][r]) * divided[c];
    }
}

static void store_block(const symmetric_system *s, const elimination_panel *panel) {
    for (int i = 0, count = panel->end - panel->begin; i < count; i++) {
        double *row = &s->a[panel->begin + i][panel->begin];
        if (count == PANEL_ROWS) {
            IN_REGISTERS for (int j = 0; j < PANEL_ROWS; j += SIMD_WIDE_WIDTH) simd_wide_store(row + j, simd_wide_all(panel->inverse[i]) * simd_wide_load(&panel->block[i][j]));
        } else {
            for (int j = i + 1; j < count; j++) row[j] = panel->inverse[i] * panel->block[i][j];
        }
    }
}

static void finish_panel(const symmetric_system *s, elimination_panel *panel) {
    int count = panel->end - panel->begin;
    for (int j = panel->end, end = s->order; j <= end; j += SIMD_WIDE_WIDTH) {
        if (panel->turned && count == PANEL_ROWS) finish_vector(s, panel, j, PANEL_ROWS, 2);
        else if (panel->turned) finish_vector(s, panel, j, count, 2);
        else if (count == PANEL_ROWS) finish_vector(s, panel, j, PANEL_ROWS, 1);
        else finish_vector(s, panel, j, count, 1);
    }
}

INLINE void subtract(const double *left, const double *divided, int vectors, simd_wide x[TILE_ROWS][TILE_VECTORS]) {
    simd_wide d[TILE_VECTORS];
    for (int c = 0; c < vectors; c++) d[c] = simd_wide_load(divided + c * SIMD_WIDE_WIDTH);
    for (int r = 0; r < TILE_ROWS; r++)
        for (int c = 0; c < vectors; c++) x[r][c] -= simd_wide_all(left[r]) * d[c];
}

/* Subtracts the panel's contribution from a tile of later rows that starts at row i and column j. */
INLINE void update_tile(const symmetric_system *s, const elimination_panel *panel, int i, ptrdiff_t j, int vectors) {
    const double *left = &panel->undivided[0][i], *divided = &s->a[panel->begin][j];
    double *tile = &s->a[i][j];
    int count = panel->end - panel->begin;
    simd_wide x[TILE_ROWS][TILE_VECTORS];
    for (int r = 0; r < TILE_ROWS; r++)
        for (int c = 0; c < vectors; c++) x[r][c] = simd_wide_load(tile + r * MOST_COLUMNS + c * SIMD_WIDE_WIDTH);
    if (count == PANEL_ROWS) {
        IN_REGISTERS for (int k = 0; k < PANEL_ROWS; k++) subtract(left + k * MOST_COLUMNS, divided + k * MOST_COLUMNS, vectors, x);
    } else {
        for (int k = 0; k < count; k++) subtract(left + k * MOST_COLUMNS, divided + k * MOST_COLUMNS, vectors, x);
    }
    for (int r = 0; r < TILE_ROWS; r++)
        for (int c = 0; c < vectors; c++) simd_wide_store(tile + r * MOST_COLUMNS + c * SIMD_WIDE_WIDTH, x[r][c]);
}

static void update_rows(const symmetric_system *s, const elimination_panel *panel, int i) {
    ptrdiff_t j = simd_wide_below(i), end = s->order;
    for (; j + (TILE_VECTORS - 1) * SIMD_WIDE_WIDTH <= end; j += TILE_VECTORS * SIMD_WIDE_WIDTH) update_tile(s, panel, i, j, TILE_VECTORS);
    for (; j <= end; j += SIMD_WIDE_WIDTH) update_tile(s, panel, i, j, 1);
}

void ELIMINATION_KERNEL(const symmetric_system *s, elimination_panel *panel) {
    store_block(s, panel);
    finish_panel(s, panel);
    for (int i = panel->end; i < s->order; i += TILE_ROWS) update_rows(s, panel, i);
}
