#include "inverse/panels.h"

#include <cblas.h>
#include <lapacke.h>
#include <stdlib.h>

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
    *p = (panels){0};
}

double panels_bytes(int rows, int columns) {
    double numbers = 0.0;
    for (int first = 0; first < columns; first += PANEL_WIDTH)
        numbers += (double)(rows - first) * (columns - first < PANEL_WIDTH ? columns - first : PANEL_WIDTH);
    return sizeof(double) * numbers;
}

bool panel_allocate(panel *p) {
    p->values = calloc((size_t)p->rows * (size_t)p->width, sizeof(double));
    return p->values != NULL;
}

void panel_release(panel *p) {
    free(p->values);
    p->values = NULL;
}

void panel_square(const panel *from, int first, int rows, int width, double alpha, double beta, double *c, int ld) {
    const double *a = (const double *)from->values + (first - from->first);
    cblas_dsyrk(CblasColMajor, CblasLower, CblasNoTrans, width, from->width, alpha, a, from->rows, beta, c, ld);
    if (rows > width)
        cblas_dgemm(CblasColMajor, CblasNoTrans, CblasTrans, rows - width, width, from->width, alpha, a + width, from->rows, a, from->rows, beta, c + width, ld);
}

bool panels_eliminate(panels *p, int j, int pivots) {
    const panel *to = &p->panels[j];
    double *c = to->values;
    int width = to->width, below = to->rows - width;
    for (int k = 0; k < j && k < pivots; k++) panel_square(&p->panels[k], to->first, to->rows, width, -1.0, 1.0, c, to->rows);
    if (j >= pivots) return true;
    if (LAPACKE_dpotrf_work(LAPACK_COL_MAJOR, 'L', width, c, to->rows) != 0) return false;
    if (below > 0)
        cblas_dtrsm(CblasColMajor, CblasRight, CblasLower, CblasTrans, CblasNonUnit, below, width, 1.0, c, to->rows, c + width, to->rows);
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
