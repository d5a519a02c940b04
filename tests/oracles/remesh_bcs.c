/* The paper's eq. 3: the affected dofs are switched from prescribed force to prescribed displacement. Their block of the inverse is then minus a stiffness, to
   which the change is added; then the dofs are switched back. Works on one triangle of the matrix, with signs that keep it symmetric (Goodnight, A tutorial on
   the SWEEP operator, 1979):

       a_ij -= a_ip a_pj / a_pp,   a_ip = a_ip / a_pp  (back: - a_ip / a_pp),   a_pp = -1 / a_pp

   For blocks, the formulas are the same with a matrix in place of a_pp. A new node starts with zero rows while its dofs are switched, so no large number is
   needed. */
#include "oracles/remesh_dense.h"

#include <cblas.h>
#include <lapacke.h>
#include <string.h>

/* Switches these dofs from force to displacement (`back` = -1), or back to force (1). */
typedef trocar_status (*switching)(dense_remesher *, int n, int count, const int *dofs, double back, trocar_error *);

/* Adds the change to switched dofs, or removes it if `sign` is -1. */
static void add_change(dense_remesher *r, const dense_change *c, double sign) {
    for (int b = 0; b < c->count; b++)
        for (int a = 0; a < c->count; a++)
            if (c->dofs[a] >= c->dofs[b]) r->matrix[(size_t)c->dofs[b] * (size_t)r->ld + (size_t)c->dofs[a]] -= sign * c->change[a * c->count + b];
}

static trocar_status update(dense_remesher *r, const dense_change *c, switching switch_dofs, trocar_error *why) {
    dense_isolate(r, c, 0.0);
    trocar_status status = switch_dofs(r, c->n, c->count - c->fresh, c->dofs, -1.0, why);
    if (status == TROCAR_OK) add_change(r, c, 1.0);
    return status == TROCAR_OK ? switch_dofs(r, c->n, c->count, c->dofs, 1.0, why) : status;
}

static trocar_status undo(dense_remesher *r, const dense_change *c, switching switch_dofs, trocar_error *why) {
    trocar_status status = switch_dofs(r, c->n, c->count, c->dofs, -1.0, why);
    if (status == TROCAR_OK) add_change(r, c, -1.0);
    return status == TROCAR_OK ? switch_dofs(r, c->n, c->count - c->fresh, c->dofs, 1.0, why) : status;
}

/* ---- one by one --------------------------------------------------------------------------------------------------- */

/* Prefetches columns. They are short, and without this the processor would wait for memory at the start of each. */
static void fetch_ahead(const double *entries) {
    enum { LINES = 16, PER_LINE = 8 };
    for (int k = 0; k < LINES; k++) __builtin_prefetch(entries + k * PER_LINE, 1);
}

/* A dof to be switched (-1 for none) and its column of the matrix. */
typedef struct {
    int dof;
    double *column;
} dof_switch;

/* Applies the rank-one change in a single pass over the triangle, limited only by memory bandwidth. The pass also stores the scaled `column` as the dof's
   own row and column, and collects the row and column of the next dof to be switched (-1 for none). */
static void sweep(dense_remesher *r, int n, const dof_switch *now, const dof_switch *then, double back) {
    int dof = now->dof, next = then->dof;
    const double *column = now->column;
    double pivot = column[dof], *next_column = then->column;
    for (int j = 0; j < n; j++) {
        double *entries = r->matrix + (size_t)j * (size_t)r->ld, scaled = column[j] / pivot;
        if (j + 1 < n) fetch_ahead(entries + r->ld + j + 1);
        cblas_daxpy(n - j, -scaled, column + j, 1, entries + j, 1);
        if (j < dof) entries[dof] = -back * scaled;
        for (int i = j; i < n && j == dof; i++) entries[i] = i == dof ? -1.0 / pivot : -back * column[i] / pivot;
        if (j < next) next_column[j] = entries[next];
        if (j == next) memcpy(next_column + j, entries + j, (size_t)(n - j) * sizeof *entries);
    }
}

static trocar_status switch_singly(dense_remesher *r, int n, int count, const int *dofs, double back, trocar_error *why) {
    double *columns[2] = {r->columns, r->weighted};
    if (count > 0) dense_take_columns(r, n, 1, dofs, columns[0]);
    for (int a = 0; a < count; a++) {
        double *column = columns[a % 2], pivot = column[dofs[a]];
        if (!(pivot * back < 0.0)) return fail(why, TROCAR_NUMERIC, "boundary-condition switch of dof %d: pivot %g", dofs[a], pivot);
        sweep(r, n, &(dof_switch){dofs[a], column}, &(dof_switch){a + 1 < count ? dofs[a + 1] : -1, columns[(a + 1) % 2]}, back);
    }
    return TROCAR_OK;
}

static trocar_status update_singly(dense_remesher *r, const dense_change *c, trocar_error *why) { return update(r, c, switch_singly, why); }
static trocar_status undo_singly(dense_remesher *r, const dense_change *c, trocar_error *why) { return undo(r, c, switch_singly, why); }

static const dense_operations singly = {update_singly, undo_singly, true, 1};

trocar_status remesher_create_bcs(inverse *inv, remesher **created, trocar_error *why) { return dense_remesher_create(inv, &singly, created, why); }

/* ---- all at once -------------------------------------------------------------------------------------------------- */

/* With P = +-(block of the dofs) = L L^T, and X the columns of the dofs, (X L^-T) (X L^-T)^T is subtracted from or added to the rest of the matrix, X
   becomes X P^-1, and the block becomes -+P^-1. */
static trocar_status switch_block(dense_remesher *r, int n, int count, const int *dofs, double back, trocar_error *why) {
    double *columns = r->columns, *scaled = r->weighted, *pivot = r->block;
    if (count == 0) return TROCAR_OK; /* nothing to switch: all neighbours of the new node are fixed */
    dense_take_columns(r, n, count, dofs, columns);
    for (int b = 0; b < count; b++)
        for (int a = 0; a < count; a++) pivot[b * count + a] = -back * columns[(size_t)b * (size_t)r->ld + (size_t)dofs[a]];
    if (LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', count, pivot, count) != 0)
        return fail(why, TROCAR_NUMERIC, "boundary-condition switches of a patch: no pivot");
    for (int b = 0; b < count; b++) memcpy(scaled + (size_t)b * (size_t)r->ld, columns + (size_t)b * (size_t)r->ld, (size_t)n * sizeof *scaled);
    cblas_dtrsm(CblasColMajor, CblasRight, CblasLower, CblasTrans, CblasNonUnit, n, count, 1.0, pivot, count, scaled, r->ld);
    cblas_dsyrk(CblasColMajor, CblasLower, CblasNoTrans, n, count, back, scaled, r->ld, 1.0, r->matrix, r->ld);
    cblas_dtrsm(CblasColMajor, CblasRight, CblasLower, CblasNoTrans, CblasNonUnit, n, count, 1.0, pivot, count, scaled, r->ld);
    LAPACKE_dpotri(LAPACK_COL_MAJOR, 'L', count, pivot, count);
    for (int b = 0; b < count; b++)
        for (int a = 0; a < count; a++)
            scaled[(size_t)b * (size_t)r->ld + (size_t)dofs[a]] = back * (a >= b ? pivot[b * count + a] : pivot[a * count + b]);
    dense_put_columns(r, n, count, dofs, scaled);
    return TROCAR_OK;
}

static trocar_status update_blocked(dense_remesher *r, const dense_change *c, trocar_error *why) { return update(r, c, switch_block, why); }
static trocar_status undo_blocked(dense_remesher *r, const dense_change *c, trocar_error *why) { return undo(r, c, switch_block, why); }

static const dense_operations blocked = {update_blocked, undo_blocked, true, MAX_RANK};

trocar_status remesher_create_bcs_blocked(inverse *inv, remesher **created, trocar_error *why) {
    return dense_remesher_create(inv, &blocked, created, why);
}
