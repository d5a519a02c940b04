/* The kernel of elimination.h for one width of vectors. */
#include "insertion/elimination.h"

#include <stddef.h>

#include "base/part.h"

#ifndef ELIMINATION_KERNEL
#define ELIMINATION_KERNEL elimination_portable
#endif

enum { TILE_ROWS = WIDTH, TILE_PARTS = 2 };
_Static_assert((int)WIDTH <= PADDING && TILE_ROWS <= (int)PADDING, "the padding holds the rest of a part and of a tile");

#define INLINE static inline __attribute__((always_inline))

INLINE void turn(double cosine, double sine, part *x, part *y) {
    part c = part_all(cosine), n = part_all(sine), first = c * *x - n * *y;
    *y = n * *x + c * *y;
    *x = first;
}

/* One part of the panel's rows, `count` of them, from column j on; they are eliminated one by one or, if turned, two by two. */
INLINE void finish_part(const symmetric_system *s, elimination_panel *panel, int j, int count, int step) {
    double (*row)[MOST_COLUMNS] = s->a + panel->begin;
    part x[PANEL_ROWS], divided[2];
    IN_REGISTERS for (int k = 0; k < PANEL_ROWS; k++) x[k] = k < count ? part_load(&row[k][j]) : (part){0};
    IN_REGISTERS for (int k = 0; k < PANEL_ROWS; k += step) {
        if (k >= count) break;
        if (step == 2) turn(panel->cosine[k / 2], panel->sine[k / 2], &x[k], &x[k + 1]);
        IN_REGISTERS for (int c = 0; c < step; c++) {
            divided[c] = part_all(panel->inverse[k + c]) * x[k + c];
            part_store(&panel->undivided[k + c][j], x[k + c]);
            part_store(&row[k + c][j], divided[c]);
        }
        IN_REGISTERS for (int r = k + step; r < PANEL_ROWS; r++)
            IN_REGISTERS for (int c = 0; c < step; c++) x[r] -= part_all(panel->block[k + c][r]) * divided[c];
    }
}

static void store_block(const symmetric_system *s, const elimination_panel *panel) {
    for (int i = 0, count = panel->end - panel->begin; i < count; i++) {
        double *row = &s->a[panel->begin + i][panel->begin];
        if (count == PANEL_ROWS) {
            IN_REGISTERS for (int j = 0; j < PANEL_ROWS; j += WIDTH) part_store(row + j, part_all(panel->inverse[i]) * part_load(&panel->block[i][j]));
        } else {
            for (int j = i + 1; j < count; j++) row[j] = panel->inverse[i] * panel->block[i][j];
        }
    }
}

static void finish_panel(const symmetric_system *s, elimination_panel *panel) {
    int count = panel->end - panel->begin;
    for (int j = panel->end, end = s->order; j <= end; j += WIDTH) {
        if (panel->turned && count == PANEL_ROWS) finish_part(s, panel, j, PANEL_ROWS, 2);
        else if (panel->turned) finish_part(s, panel, j, count, 2);
        else if (count == PANEL_ROWS) finish_part(s, panel, j, PANEL_ROWS, 1);
        else finish_part(s, panel, j, count, 1);
    }
}

INLINE void subtract(const double *left, const double *divided, int parts, part x[TILE_ROWS][TILE_PARTS]) {
    part d[TILE_PARTS];
    for (int c = 0; c < parts; c++) d[c] = part_load(divided + c * WIDTH);
    for (int r = 0; r < TILE_ROWS; r++)
        for (int c = 0; c < parts; c++) x[r][c] -= part_all(left[r]) * d[c];
}

/* Subtracts the panel's part from a tile of the rows after it, which begins at row i, column j. */
INLINE void update_tile(const symmetric_system *s, const elimination_panel *panel, int i, ptrdiff_t j, int parts) {
    const double *left = &panel->undivided[0][i], *divided = &s->a[panel->begin][j];
    double *tile = &s->a[i][j];
    int count = panel->end - panel->begin;
    part x[TILE_ROWS][TILE_PARTS];
    for (int r = 0; r < TILE_ROWS; r++)
        for (int c = 0; c < parts; c++) x[r][c] = part_load(tile + r * MOST_COLUMNS + c * WIDTH);
    if (count == PANEL_ROWS) {
        IN_REGISTERS for (int k = 0; k < PANEL_ROWS; k++) subtract(left + k * MOST_COLUMNS, divided + k * MOST_COLUMNS, parts, x);
    } else {
        for (int k = 0; k < count; k++) subtract(left + k * MOST_COLUMNS, divided + k * MOST_COLUMNS, parts, x);
    }
    for (int r = 0; r < TILE_ROWS; r++)
        for (int c = 0; c < parts; c++) part_store(tile + r * MOST_COLUMNS + c * WIDTH, x[r][c]);
}

static void update_rows(const symmetric_system *s, const elimination_panel *panel, int i) {
    ptrdiff_t j = whole_parts_below(i), end = s->order;
    for (; j + (TILE_PARTS - 1) * WIDTH <= end; j += TILE_PARTS * WIDTH) update_tile(s, panel, i, j, TILE_PARTS);
    for (; j <= end; j += WIDTH) update_tile(s, panel, i, j, 1);
}

void ELIMINATION_KERNEL(const symmetric_system *s, elimination_panel *panel) {
    store_block(s, panel);
    finish_panel(s, panel);
    for (int i = panel->end; i < s->order; i += TILE_ROWS) update_rows(s, panel, i);
}
