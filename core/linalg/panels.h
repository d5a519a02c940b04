/* Lower trapezoidal matrices in panels of columns, each in memory of its own: what is no longer needed can be given back panel by panel. */
#ifndef TROCAR_PANELS_H
#define TROCAR_PANELS_H

#include <stdbool.h>
#include <stddef.h>

#include "base/team.h"

enum { PANEL_WIDTH = 576 };  /* most columns of a panel, whole blocks of 3 */

/* Columns [first, first + width), from the diagonal down. */
typedef struct {
    int first, width, rows;
    void *values;            /* rows x width, column-major; double, or float once it was made single. Zero above the diagonal. NULL: not there */
} panel;

typedef struct {
    int count;
    panel *panels;
    bool *filled;            /* count square: whether the rows beside panel i have entries in panel j, at [i * count + j]; NULL: all have */
} panels;

static inline bool panels_filled(const panels *p, int i, int j) { return !p->filled || p->filled[i * p->count + j]; }

/* Divides a matrix of so many rows and columns <= rows; a panel begins at column `split`. Nothing is allocated but the list. */
bool panels_divide(panels *p, int rows, int columns, int split);
void panels_free(panels *p);

/* Bytes of all panels in double precision. */
double panels_bytes(int rows, int columns);

/* Zeros in double precision, which the team writes. */
bool panel_allocate(panel *p, team *t);
void panel_release(panel *p);

/* C = alpha A B^T + beta C: A are `rows` rows of a panel, from row `row` of the matrix on, and B `columns` rows from row `column` on. If they are the
   same, the lower triangle of C. */
void panel_multiply(const panel *from, int row, int rows, int column, int columns, double alpha, double beta, double *c, int ld);

/* Left-looking Cholesky factorisation, panel by panel: subtracts from panel j what the factored panels k < min(j, pivots) contribute, and
   factors it if j < pivots; blocks that are not filled are left as they are. False if a pivot is not positive. The team shares the rows; each of its members calls BLAS, which shall have one thread. */
bool panels_eliminate(panels *p, int j, int pivots, team *t);

/* Replaces the first entries of `load` (as many as the first `pivots` panels have columns) by y = L^-1 load and subtracts L y from the others. */
void panels_forward(const panels *p, int pivots, double *load);

#endif
