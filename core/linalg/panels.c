#include "linalg/panels.h"

#include <cblas.h>
#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "base/large_pages.h"

static int panels_of(int columns) { return (columns + PANEL_WIDTH - 1) / PANEL_WIDTH; }

bool panels_divide(panels *p, int rows, int columns, int split) {
    *p = (panels){.panels = calloc((size_t)(panels_of(split) + panels_of(columns - split) + 1), sizeof *p->panels)};
    for (int first = 0, width; p->panels && first < columns; first += width) {
        int end = first < split ? split : columns;
        width = end - first < PANEL_WIDTH ? end - first : PANEL_WIDTH;
        p->panels[p->count++] = (panel){.first = first, .width = width, .rows = rows - first};
    }
    return p->panels != NULL;
}

void panels_free(panels *p) {
    for (int k = 0; k < p->count; k++) panel_release(&p->panels[k]);
    free(p->panels);
    free(p->filled);
    *p = (panels){0};
}

double panels_bytes(int rows, int columns) {
    double numbers = 0.0;
    for (int first = 0; first < columns; first += PANEL_WIDTH)
        numbers += (double)(rows - first) * (columns - first < PANEL_WIDTH ? columns - first : PANEL_WIDTH);
    return sizeof(double) * numbers;
}

/* Returns the team if it is worth using: waking it takes longer than a computation of a few tens of microseconds. */
static team *team_for(team *t, double operations) { return operations < 2e6 ? NULL : t; }

static size_t bytes_of(const panel *p) { return (size_t)p->rows * (size_t)p->width * sizeof(double); }

static void clear_column(void *context, int column, int member) {
    (void)member;
    const panel *p = context;
    memset((double *)p->values + (size_t)column * (size_t)p->rows, 0, (size_t)p->rows * sizeof(double));
}

/* Writes the pages right away: pages that are read before they are written would be mapped twice. */
bool panel_allocate(panel *p, team *t) {
    p->values = malloc(bytes_of(p));
    if (!p->values) return false;
    advise_pages(p->values, bytes_of(p), MADV_HUGEPAGE);
    team_run(team_for(t, (double)p->rows * p->width), p->width, clear_column, p);
    return true;
}

void panel_release(panel *p) {
    advise_pages(p->values, bytes_of(p), MADV_NOHUGEPAGE);
    free(p->values);
    p->values = NULL;
}

void panel_multiply(const panel *from, int row, int rows, int column, int columns, double alpha, double beta, double *c, int ld) {
    const double *a = (const double *)from->values + (row - from->first), *b = (const double *)from->values + (column - from->first);
    if (row == column) cblas_dsyrk(CblasColMajor, CblasLower, CblasNoTrans, rows, from->width, alpha, a, from->rows, beta, c, ld);
    else cblas_dgemm(CblasColMajor, CblasNoTrans, CblasTrans, rows, columns, from->width, alpha, a, from->rows, b, from->rows, beta, c, ld);
}

/* The rows of panel j below its diagonal block, divided into pieces for a team. If the matrix has empty blocks (`filled`), each later panel's rows form one
   piece. The division, and so the result, does not depend on how many members the team has. */
typedef struct {
    const panels *all;
    const panel *to;
    int j, factored;         /* factored: number of panels that contribute */
    int pieces;
} share;

static share share_of(const panels *p, int j, int factored) {
    enum { FEW = 192, MANY = 4 * 768 }; /* FEW: too few rows to be worth dividing; MANY: enough rows for four large products */
    const panel *to = &p->panels[j];
    int below = to->rows - to->width;
    return (share){p, to, j, factored, p->filled ? p->count - 1 - j : below < FEW ? below > 0 : 4 * ((below + MANY - 1) / MANY)};
}

/* Returns the first row of a piece, counted from the panel's first row. */
static int start_of(const share *s, int piece) {
    enum { VECTORS = 24 };
    long below = s->to->rows - s->to->width;
    if (piece == s->pieces) return s->to->rows;
    return s->all->filled ? s->all->panels[s->j + 1 + piece].first - s->to->first : s->to->width + (int)(below * piece / s->pieces) / VECTORS * VECTORS;
}

/* Subtracts the contribution of the factored panels from the diagonal block, or from a piece of the rows below it. */
static void subtract(void *context, int i, int member) {
    (void)member;
    const share *s = context;
    const panel *to = s->to;
    int row = i == 0 ? 0 : start_of(s, i - 1), end = i == 0 ? to->width : start_of(s, i);
    if (s->all->filled && !panels_filled(s->all, s->j + i, s->j)) return;
    for (int k = 0; k < s->factored; k++)
        if (!s->all->filled || (panels_filled(s->all, s->j + i, k) && panels_filled(s->all, s->j, k)))
            panel_multiply(&s->all->panels[k], to->first + row, end - row, to->first, to->width, -1.0, 1.0, (double *)to->values + row, to->rows);
}

/* Solves X L^T = B for X, where B is a piece of these rows and L the factor of the diagonal block. */
static void solve_piece(void *context, int i, int member) {
    (void)member;
    const share *s = context;
    const panel *to = s->to;
    if (s->all->filled && !panels_filled(s->all, s->j + 1 + i, s->j)) return;
    int row = start_of(s, i), rows = start_of(s, i + 1) - row;
    double *values = to->values;
    cblas_dtrsm(CblasColMajor, CblasRight, CblasLower, CblasTrans, CblasNonUnit, rows, to->width, 1.0, values, to->rows, values + row, to->rows);
}

bool panels_eliminate(panels *p, int j, int pivots, team *t) {
    const panel *to = &p->panels[j];
    share s = share_of(p, j, j < pivots ? j : pivots);
    double square = (double)to->rows * to->width;
    if (s.factored > 0) team_run(team_for(t, square * p->panels[0].width), s.pieces + 1, subtract, &s);
    if (j >= pivots) return true;
    if (LAPACKE_dpotrf_work(LAPACK_COL_MAJOR, 'L', to->width, to->values, to->rows) != 0) return false;
    team_run(team_for(t, square * to->width), s.pieces, solve_piece, &s);
    return true;
}

void panels_forward(const panels *p, int pivots, double *load) {
    for (int k = 0; k < pivots; k++) {
        const panel *at = &p->panels[k];
        double *y = load + at->first;
        cblas_dtrsv(CblasColMajor, CblasLower, CblasNoTrans, CblasNonUnit, at->width, at->values, at->rows, y, 1);
        if (at->rows > at->width)
            cblas_dgemv(CblasColMajor, CblasNoTrans, at->rows - at->width, at->width, -1.0, (const double *)at->values + at->width, at->rows, y, 1, 1.0,
                        y + at->width, 1);
    }
}
