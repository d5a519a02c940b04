/* The paper's eq. 4: with A the columns of the inverse at the dofs touched and B its block between them,

       inverse' = inverse - A M A^T,      M = change (I + B change)^-1 = (I + change B)^-1 change

   A new node starts on a spring that the change takes away: the paper's "large number", but as it is accounted for exactly, any size
   will do, and one like the tissue's own loses no digits. */
#include "remesh_dense.h"

#include <cblas.h>
#include <string.h>

enum { BLOCK = 192 };        /* columns of one triangle updated at a time: the rectangle beside them is wasted on the diagonal only */

static void gather_block(const dense_remesher *r, const dense_change *c, const double *columns, double *block) {
    for (int a = 0; a < c->count; a++)
        for (int b = 0; b < c->count; b++) block[a * c->count + b] = columns[(size_t)b * (size_t)r->ld + (size_t)c->dofs[a]];
}

/* Leaves A in the change's own part of `columns` and A M in that of `weighted`, where `undo` finds them. */
static trocar_status factor_change(dense_remesher *r, const dense_change *c, report *why) {
    int n = c->count;
    size_t first = (size_t)c->first * (size_t)r->ld;
    double spring = r->matrix[0], *change = r->block, block[MAX_RANK * MAX_RANK], system[MAX_RANK * MAX_RANK];
    dense_isolate(r, c, spring);
    dense_take_columns(r, c->n, n, c->dofs, r->columns + first);
    memcpy(change, c->change, (size_t)(n * n) * sizeof *change);
    for (int a = n - c->fresh; a < n; a++) change[a * n + a] -= 1.0 / spring;
    gather_block(r, c, r->columns + first, block);
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, n, n, n, 1.0, change, n, block, n, 0.0, system, n);
    for (int a = 0; a < n; a++) system[a * n + a] += 1.0;
    if (LAPACKE_dgesv(LAPACK_ROW_MAJOR, n, n, system, n, r->pivots, change, n) != 0)
        return fail(why, TROCAR_NUMERIC, "Woodbury's update is singular");
    for (int a = 0; a < n; a++)
        for (int b = 0; b < a; b++) change[a * n + b] = change[b * n + a] = 0.5 * (change[a * n + b] + change[b * n + a]);
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasNoTrans, c->n, n, n, 1.0, r->columns + first, r->ld, change, n, 0.0, r->weighted + first, r->ld);
    return TROCAR_OK;
}

/* ---- in one triangle ------------------------------------------------------------------------------------------------ */

static void add_to_triangle(dense_remesher *r, const dense_change *c, double sign) {
    const double *left = r->weighted + (size_t)c->first * (size_t)r->ld, *right = r->columns + (size_t)c->first * (size_t)r->ld;
    for (int j = 0; j < c->n; j += BLOCK) {
        int width = c->n - j < BLOCK ? c->n - j : BLOCK;
        cblas_dgemm(CblasColMajor, CblasNoTrans, CblasTrans, c->n - j, width, c->count, sign, left + j, r->ld, right + j, r->ld, 1.0,
                    r->matrix + (size_t)j * (size_t)r->ld + j, r->ld);
    }
}

static trocar_status update_triangle(dense_remesher *r, const dense_change *c, report *why) {
    trocar_status status = factor_change(r, c, why);
    if (status == TROCAR_OK) add_to_triangle(r, c, -1.0);
    return status;
}

static trocar_status undo_triangle(dense_remesher *r, const dense_change *c, report *why) {
    (void)why;
    add_to_triangle(r, c, 1.0);
    return TROCAR_OK;
}

static const dense_operations triangle = {update_triangle, undo_triangle, ALL_RANKS};

trocar_status remesher_create_woodbury(inverse *inv, remesher **created, report *why) { return dense_remesher_create(inv, &triangle, created, why); }

/* ---- in the full matrix --------------------------------------------------------------------------------------------- */

static void add_to_square(dense_remesher *r, const dense_change *c, double sign) {
    const double *left = r->weighted + (size_t)c->first * (size_t)r->ld, *right = r->columns + (size_t)c->first * (size_t)r->ld;
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasTrans, c->n, c->n, c->count, sign, left, r->ld, right, r->ld, 1.0, r->matrix, r->ld);
}

static trocar_status update_square(dense_remesher *r, const dense_change *c, report *why) {
    trocar_status status = factor_change(r, c, why);
    if (status == TROCAR_OK) add_to_square(r, c, -1.0);
    return status;
}

static trocar_status undo_square(dense_remesher *r, const dense_change *c, report *why) {
    (void)why;
    add_to_square(r, c, 1.0);
    return TROCAR_OK;
}

static const dense_operations square = {update_square, undo_square, ALL_RANKS};

trocar_status remesher_create_woodbury_general(inverse *inv, remesher **created, report *why) { return dense_remesher_create(inv, &square, created, why); }
