/* Lower trapezoidal matrices, stored in panels of columns that are allocated separately and can be freed one by one. */
#ifndef TROCAR_PANELS_H
#define TROCAR_PANELS_H

#include <stdbool.h>
#include <stddef.h>

#include "base/team.h"

enum { PANEL_WIDTH = 576 };  /* most columns in a panel, a multiple of the block size 3 */

/* Columns [first, first + width) of the matrix, from the diagonal down. */
typedef struct {
    int first, width, rows;
    void *values;            /* rows x width, column-major, zero above the diagonal; double, or float after conversion to single precision; NULL if not
                                allocated */
} panel;

typedef struct {
    int count;
    panel *panels;
    bool *filled;            /* count x count: [i * count + j] is true if the rows of panel i have entries in panel j; NULL if all have entries */
} panels;

static inline bool panels_filled(const panels *p, int i, int j) { return !p->filled || p->filled[i * p->count + j]; }

/* Divides a matrix of `rows` rows, and no more columns than rows, into panels, one of which starts at column `split`. Allocates only the list of panels. */
bool panels_divide(panels *p, int rows, int columns, int split);
void panels_free(panels *p);

/* Returns how many bytes all panels take in double precision. */
double panels_bytes(int rows, int columns);

/* Allocates a panel in double precision. The team fills it with zeros. */
bool panel_allocate(panel *p, team *t);
void panel_release(panel *p);

/* C = alpha A B^T + beta C. A: `rows` rows of a panel, starting at row `row` of the matrix; B: `columns` rows, starting at row `column`. If A and B are the
   same rows, only the lower triangle of C is computed. */
void panel_multiply(const panel *from, int row, int rows, int column, int columns, double alpha, double beta, double *c, int ld);

/* Does one panel of a left-looking Cholesky factorisation: subtracts the contribution of the factored panels k < min(j, pivots) from panel j, and factorises
   panel j if j < pivots. Skips empty blocks. Returns false if a pivot is not positive. The members of the team divide the rows among themselves; each calls
   BLAS, which must use one thread. */
bool panels_eliminate(panels *p, int j, int pivots, team *t);

/* Replaces the first entries of `load`, as many as the first `pivots` panels have columns, with y = L^-1 load. Subtracts L y from the others. */
void panels_forward(const panels *p, int pivots, double *load);

#endif
