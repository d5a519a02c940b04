/* The paper's eq. 3: the dofs touched switch from force to displacement, where their block of the inverse is minus a stiffness, to
   which the change is added, and switch back. In one triangle, with the signs that keep the matrix symmetric (Goodnight, A tutorial on
   the SWEEP operator, 1979):

       a_ij -= a_ip a_pj / a_pp,   a_ip = a_ip / a_pp  (back: - a_ip / a_pp),   a_pp = -1 / a_pp

   In blocks the same with a matrix for a_pp. A new node comes as zero rows in between, without any large number. */
#include "remesh_dense.h"

#include <cblas.h>
#include <string.h>

/* To switched dofs; `sign` -1 takes it away, and with it the fresh ones. */
static void add_change(dense_remesher *r, const dense_change *c, double sign) {
    for (int b = 0; b < c->count; b++)
        for (int a = 0; a < c->count; a++)
            if (c->dofs[a] >= c->dofs[b]) r->matrix[(size_t)c->dofs[b] * (size_t)r->ld + (size_t)c->dofs[a]] -= sign * c->change[a * c->count + b];
    if (sign < 0.0) dense_isolate(r, c, 0.0);
}

/* ---- one by one --------------------------------------------------------------------------------------------------- */

static trocar_status switch_dof(dense_remesher *r, int n, int dof, double back, report *why) {
    double *column = r->columns;
    dense_take_columns(r, n, 1, &dof, column);
    double pivot = column[dof];
    if (!(pivot * back < 0.0)) return fail(why, TROCAR_NUMERIC, "boundary-condition switch of dof %d: pivot %g", dof, pivot);
    cblas_dsyr(CblasColMajor, CblasLower, n, -1.0 / pivot, column, 1, r->matrix, r->ld);
    cblas_dscal(n, -back / pivot, column, 1);
    column[dof] = -1.0 / pivot;
    dense_put_columns(r, n, 1, &dof, column);
    return TROCAR_OK;
}

static trocar_status switch_dofs(dense_remesher *r, const dense_change *c, int count, double back, report *why) {
    trocar_status status = TROCAR_OK;
    for (int a = 0; a < count && status == TROCAR_OK; a++) status = switch_dof(r, c->n, c->dofs[a], back, why);
    return status;
}

static trocar_status update_singly(dense_remesher *r, const dense_change *c, report *why) {
    trocar_status status = switch_dofs(r, c, c->count - c->fresh, -1.0, why);
    add_change(r, c, 1.0);
    return status == TROCAR_OK ? switch_dofs(r, c, c->count, 1.0, why) : status;
}

static trocar_status undo_singly(dense_remesher *r, const dense_change *c, report *why) {
    trocar_status status = switch_dofs(r, c, c->count, -1.0, why);
    add_change(r, c, -1.0);
    return status == TROCAR_OK ? switch_dofs(r, c, c->count - c->fresh, 1.0, why) : status;
}

static const dense_operations singly = {update_singly, undo_singly, MAX_RANK};

trocar_status remesher_create_bcs(inverse *inv, remesher **created, report *why) { return dense_remesher_create(inv, &singly, created, why); }

/* ---- all at once -------------------------------------------------------------------------------------------------- */

/* With P = +-(block of the dofs) = L L^T: the rest loses or gains (X L^-T) (X L^-T)^T, X becomes X P^-1, the block -+P^-1. */
static trocar_status switch_block(dense_remesher *r, int n, int count, const int *dofs, double back, report *why) {
    double *columns = r->columns, *scaled = r->weighted, *pivot = r->block;
    if (count == 0) return TROCAR_OK; /* a new node among fixed ones */
    dense_take_columns(r, n, count, dofs, columns);
    for (int b = 0; b < count; b++)
        for (int a = 0; a < count; a++) pivot[b * count + a] = -back * columns[(size_t)b * (size_t)r->ld + (size_t)dofs[a]];
    if (LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', count, pivot, count) != 0) return fail(why, TROCAR_NUMERIC, "boundary-condition switches of a patch: no pivot");
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

static trocar_status update_blocked(dense_remesher *r, const dense_change *c, report *why) {
    trocar_status status = switch_block(r, c->n, c->count - c->fresh, c->dofs, -1.0, why);
    add_change(r, c, 1.0);
    return status == TROCAR_OK ? switch_block(r, c->n, c->count, c->dofs, 1.0, why) : status;
}

static trocar_status undo_blocked(dense_remesher *r, const dense_change *c, report *why) {
    trocar_status status = switch_block(r, c->n, c->count, c->dofs, -1.0, why);
    add_change(r, c, -1.0);
    return status == TROCAR_OK ? switch_block(r, c->n, c->count - c->fresh, c->dofs, 1.0, why) : status;
}

static const dense_operations blocked = {update_blocked, undo_blocked, MAX_RANK};

trocar_status remesher_create_bcs_blocked(inverse *inv, remesher **created, report *why) { return dense_remesher_create(inv, &blocked, created, why); }
