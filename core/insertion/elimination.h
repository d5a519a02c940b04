/* Elimination in a dense symmetric system: the upper triangle is kept by rows, with the right-hand side as one more column. Rows are
   eliminated in panels, so that the rest of the matrix is read and written once for each panel.

   What is below the diagonal is scratch: computed with, never used. */
#ifndef TROCAR_ELIMINATION_H
#define TROCAR_ELIMINATION_H

#include <stdbool.h>

#include "base/cache_line.h"

enum { PANEL_ROWS = 8, WIDEST_TILE = 16, MOST_COLUMNS = 264 };

/* Columns that a system of so many unknowns takes, with the right-hand side and padding: whole cache lines; at most MOST_COLUMNS. */
#define ELIMINATION_COLUMNS(order) ((order) / 8 * 8 + WIDEST_TILE)

typedef struct {
    double *a;               /* element (i, j >= i): a[i * ld + j]; of the right-hand side: j = order. Best on a cache line */
    int ld, order;
} symmetric_system;

/* Rows that are eliminated together, as they were before they were divided by their pivots. */
typedef struct {
    int begin, end;          /* at most PANEL_ROWS */
    _Alignas(CACHE_LINE) double undivided[PANEL_ROWS][MOST_COLUMNS];
} elimination_panel;

/* Makes the columns after the right-hand side zero, which are computed with, too: to be called first. RT */
void elimination_begin(const symmetric_system *s);

/* Goes on to the next rows before `end`, from panel->end on; false: there are none. RT */
bool next_panel(elimination_panel *panel, int end);

/* The arithmetic, for one width of vectors. Each number is the result of the same operations in the same order whatever the width. RT */
typedef struct {
    /* Turns rows i and i + 1 by an angle, right of their block on the diagonal, which is lost. */
    void (*turn_rows)(const symmetric_system *s, int i, double cosine, double sine);

    /* Divides rows [i, i + count) of the panel, whose block on the diagonal is diagonal, by their pivots, right of that block, which is lost, and
       subtracts their part from the rest of the panel; count is 1 or 2. */
    void (*eliminate_in_panel)(const symmetric_system *s, elimination_panel *panel, int i, int count, const double *inverse_pivots);

    /* Subtracts the panel's part from all rows after it. */
    void (*eliminate_after_panel)(const symmetric_system *s, const elimination_panel *panel);
} elimination_kernels;

/* Those that any processor has that can run this program, those of AVX-512 (x86-64 only), and the widest that this processor has. RT */
extern const elimination_kernels elimination_portable, elimination_avx512;
const elimination_kernels *elimination_kernels_here(void);

/* The sum of row[j] x[j] over [begin, end). RT */
double dot_product(const double *row, const double *x, int begin, int end);

#endif
