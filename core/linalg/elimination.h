/* Gaussian elimination in a dense symmetric system. The upper triangle is stored by rows, with the right-hand side as an extra column. Rows are eliminated in
   panels, so that the rest of the matrix is read and written only once per panel. The lower triangle is overwritten with garbage. */
#ifndef TROCAR_ELIMINATION_H
#define TROCAR_ELIMINATION_H

#include <stdbool.h>

#include "base/cache_line.h"

#define IN_REGISTERS _Pragma("GCC unroll 8") /* unrolls loops of constant length, which keeps their data in registers */

enum { PANEL_ROWS = 8, PADDING = 8, MOST_COLUMNS = 264 };

/* Returns the number of rows and columns needed for `order` unknowns, including padding, which takes part in the computation. The first column after the
   unknowns is the right-hand side. */
#define ELIMINATION_SIZE(order) ((order) + PADDING)

typedef struct {
    double (*a)[MOST_COLUMNS]; /* element (i, j >= i) is a[i][j]; the right-hand side is column j = order. Should be aligned to a cache line */
    int order;
} symmetric_system;

/* A panel: rows that are eliminated together. Their diagonal block determines the elimination and is processed first, the columns to its right afterwards. */
typedef struct {
    int begin, end;          /* range of at most PANEL_ROWS rows; if there are fewer, the block is padded with ones on the diagonal */
    bool turned;             /* the rows are rotated in pairs, by the angles below */
    double cosine[PANEL_ROWS / 2], sine[PANEL_ROWS / 2], inverse[PANEL_ROWS]; /* cosines and sines of the rotation angles; inverse pivots */
    double block[PANEL_ROWS][PANEL_ROWS];                                     /* upper triangle of the diagonal block; after the elimination, its rows are still
                                                                                 not divided by the pivots */
    _Alignas(CACHE_LINE) double undivided[PANEL_ROWS][MOST_COLUMNS];          /* to the right of the block: rows before they are divided by their pivots */
} elimination_panel;

/* product = A x, without the right-hand side. x must be followed by PADDING zeros; the product is followed by PADDING meaningless numbers. RT */
void symmetric_multiply(const symmetric_system *s, const double *x, double *product);

/* Clears the padding. Call this before all other functions. RT */
void elimination_begin(const symmetric_system *s);

/* Moves the panel to the next rows, from panel->end on but not beyond row `end` - 1. Returns false if there are none. RT */
bool next_panel(const symmetric_system *s, elimination_panel *panel, int end);

/* Rotates rows k and k + 1 of the block by an angle, to the right of their own 2 x 2 diagonal block, which is not preserved. RT */
static inline void turn_in_block(elimination_panel *panel, int k, double cosine, double sine) {
    panel->turned = true;
    panel->cosine[k / 2] = cosine;
    panel->sine[k / 2] = sine;
    IN_REGISTERS for (int j = k + 2; j < PANEL_ROWS; j++) {
        double x = panel->block[k][j], y = panel->block[k + 1][j];
        panel->block[k][j] = cosine * x - sine * y;
        panel->block[k + 1][j] = sine * x + cosine * y;
    }
}

/* Eliminates row k of the block, or two rows whose own 2 x 2 block is diagonal. RT */
static inline void eliminate_in_block(elimination_panel *panel, int k, int count, const double *inverse_pivots) {
    IN_REGISTERS for (int c = 0; c < count; c++) panel->inverse[k + c] = inverse_pivots[c];
    IN_REGISTERS for (int r = k + count; r < PANEL_ROWS; r++)
        IN_REGISTERS for (int j = r; j < PANEL_ROWS; j++)
            IN_REGISTERS for (int c = 0; c < count; c++) panel->block[r][j] -= panel->block[k + c][r] * (inverse_pivots[c] * panel->block[k + c][j]);
}

/* Stores the block, eliminates all later columns in the same way, and subtracts the panel's contribution from all later rows. Whatever the vector width, each
   number results from the same operations in the same order. RT */
typedef void elimination_kernel(const symmetric_system *s, elimination_panel *panel);

/* The kernel for any supported processor, the kernel for AVX-512 (x86-64 only), and the fastest that this processor can run. RT */
extern elimination_kernel elimination_portable, elimination_avx512;
elimination_kernel *elimination_kernel_here(void);

/* Returns the first row of the panel that contains row i, if the first panel starts at row 0; -1 if i < 0. RT */
static inline int panel_of(int i) { return i < 0 ? -1 : i / PANEL_ROWS * PANEL_ROWS; }

/* Back substitution for rows [begin, begin + PANEL_ROWS): subtracts the contribution of the unknowns with indices >= `known` from the right-hand sides. x must
   be followed by PADDING zeros. RT */
void subtract_known(const symmetric_system *s, int begin, int known, const double *x, double side[PANEL_ROWS]);

/* Back substitution within a panel: subtracts the contribution of unknown begin + k + c, whose value is now in side[k + c], from the rows before begin + k.
   RT */
static inline void subtract_known_in_block(const symmetric_system *s, int begin, int k, int c, double side[PANEL_ROWS]) {
    IN_REGISTERS for (int r = 0; r < k; r++) side[r] -= s->a[begin + r][begin + k + c] * side[k + c];
}

#endif
