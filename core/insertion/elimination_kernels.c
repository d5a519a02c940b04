/* The kernels of elimination.h for one width of vectors. */
#include "insertion/elimination.h"

#include <stddef.h>
#include <string.h>

#ifdef ELIMINATION_AVX512
enum { WIDTH = 8, TILE_ROWS = 8, TILE_PARTS = 2 };
#define KERNELS elimination_avx512
#else
enum { WIDTH = 4, TILE_ROWS = 4, TILE_PARTS = 2 };
#define KERNELS elimination_portable
#endif
_Static_assert(TILE_PARTS * WIDTH <= (int)WIDEST_TILE, "the padding holds a tile that begins at the right-hand side");

/* Part of a row: a register, or two of NEON. Rows begin on cache lines as a rule, and parts at multiples of WIDTH. */
typedef double part __attribute__((vector_size(WIDTH * sizeof(double))));

static inline part load(const double *from) {
    part x;
    memcpy(&x, from, sizeof x);
    return x;
}

static inline void store(double *to, part x) { memcpy(to, &x, sizeof x); }
static inline part all(double x) { return x - (part){0}; }
static inline int whole_below(int i) { return i / WIDTH * WIDTH; }

static void turn_rows(const symmetric_system *s, int i, double cosine, double sine) {
    double *x = s->a + i * s->ld, *y = x + s->ld;
    part c = all(cosine), n = all(sine);
    for (int j = whole_below(i + 2); j <= s->order; j += WIDTH) {
        part a = load(x + j), b = load(y + j);
        store(x + j, c * a - n * b);
        store(y + j, n * a + c * b);
    }
}

static void divide(const symmetric_system *s, elimination_panel *panel, int i, int from, double inverse) {
    double *row = s->a + i * s->ld, *undivided = panel->undivided[i - panel->begin];
    for (int j = whole_below(from), end = s->order; j <= end; j += WIDTH) {
        part x = load(row + j);
        store(undivided + j, x);
        store(row + j, all(inverse) * x);
    }
}

static void eliminate_in_panel(const symmetric_system *s, elimination_panel *panel, int i, int count, const double *inverse_pivots) {
    const double *first = s->a + i * s->ld, *last = first + (count - 1) * s->ld;
    const double *left = panel->undivided[i - panel->begin], *left_of_last = panel->undivided[i + count - 1 - panel->begin];
    for (int k = 0; k < count; k++) divide(s, panel, i + k, i + count, inverse_pivots[k]);
    for (int r = i + count; r < panel->end; r++) {
        double *row = s->a + r * s->ld;
        part f = all(left[r]), g = all(count == 2 ? left_of_last[r] : 0.0);
        for (int j = whole_below(r); j <= s->order; j += WIDTH)
            store(row + j, load(row + j) - f * load(first + j) - g * load(last + j));
    }
}

/* Rows [i, i + TILE_ROWS), tile by tile; `count` is the panel's number of rows. */
static inline __attribute__((always_inline)) void update_rows(const symmetric_system *s, const elimination_panel *panel, int i, int count) {
    const ptrdiff_t ld = s->ld;
    const double *left = panel->undivided[0] + i, *divided = s->a + panel->begin * ld;
    for (ptrdiff_t j = whole_below(i), end = s->order; j <= end; j += TILE_PARTS * WIDTH) {
        double *tile = s->a + i * ld + j;
        part sum[TILE_ROWS][TILE_PARTS];
        for (int r = 0; r < TILE_ROWS; r++)
            for (int c = 0; c < TILE_PARTS; c++) sum[r][c] = load(tile + r * ld + c * WIDTH);
        for (int k = 0; k < count; k++) {
            part x[TILE_PARTS];
            for (int c = 0; c < TILE_PARTS; c++) x[c] = load(divided + k * ld + j + c * WIDTH);
            for (int r = 0; r < TILE_ROWS; r++)
                for (int c = 0; c < TILE_PARTS; c++) sum[r][c] -= all(left[k * MOST_COLUMNS + r]) * x[c];
        }
        for (int r = 0; r < TILE_ROWS; r++)
            for (int c = 0; c < TILE_PARTS; c++) store(tile + r * ld + c * WIDTH, sum[r][c]);
    }
}

static void update_row(const symmetric_system *s, const elimination_panel *panel, int i) {
    double *row = s->a + i * s->ld;
    for (int k = 0; k < panel->end - panel->begin; k++) {
        const double *divided = s->a + (panel->begin + k) * s->ld;
        part f = all(panel->undivided[k][i]);
        for (int j = whole_below(i); j <= s->order; j += WIDTH) store(row + j, load(row + j) - f * load(divided + j));
    }
}

static void eliminate_after_panel(const symmetric_system *s, const elimination_panel *panel) {
    int i = panel->end, count = panel->end - panel->begin;
    for (; i + TILE_ROWS <= s->order; i += TILE_ROWS) {
        if (count == PANEL_ROWS) update_rows(s, panel, i, PANEL_ROWS);
        else update_rows(s, panel, i, count);
    }
    for (; i < s->order; i++) update_row(s, panel, i);
}

const elimination_kernels KERNELS = {turn_rows, eliminate_in_panel, eliminate_after_panel};
