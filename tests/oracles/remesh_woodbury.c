/* The paper's eq. 4: with A the columns of the inverse at the affected dofs, and B the block of the inverse between these dofs,

       inverse' = inverse - A M A^T,      M = change (I + B change)^-1 = (I + change B)^-1 change

   A new node starts on a spring, the paper's "large number", which the change removes. Because the removal is exact, the spring may have
   any stiffness, and a stiffness similar to that of the tissue causes no loss of digits. The stored matrices of a change can undo it only if it is the last
   change;
   removing an earlier change by the same formula would lose up to eight digits. */
#include "oracles/remesh_dense.h"

#include <cblas.h>
#include <string.h>

enum { BLOCK = 192 };        /* columns of the triangle updated together; whole rectangles waste work only in the diagonal blocks */

/* Leaves A in the change's part of `columns`, and A M in the same part of `weighted`, where `undo` reads them. */
static trocar_status factor_change(dense_remesher *r, const dense_change *c, trocar_error *why) {
    int n = c->count;
    double spring = r->matrix[0], *middle = r->block, block[MAX_RANK * MAX_RANK];
    double *columns = r->columns + (size_t)c->first * (size_t)r->ld, *weighted = r->weighted + (size_t)c->first * (size_t)r->ld;
    dense_isolate(r, c, spring);
    dense_take_columns(r, c->n, n, c->dofs, columns);
    for (int a = 0; a < n; a++)
        for (int b = 0; b < n; b++) block[a * n + b] = columns[(size_t)b * (size_t)r->ld + (size_t)c->dofs[a]];
    memcpy(middle, c->change, (size_t)(n * n) * sizeof *middle);
    for (int a = n - c->fresh; a < n; a++) middle[a * n + a] -= 1.0 / spring;
    trocar_status status = change_middle(n, (strided_matrix){middle, n}, (strided_matrix){block, n}, middle, why);
    if (status != TROCAR_OK) return status;
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasNoTrans, c->n, n, n, 1.0, columns, r->ld, middle, n, 0.0, weighted, r->ld);
    return TROCAR_OK;
}

/* Adds `sign` times A M A^T to the matrix. */
typedef void (*addition)(dense_remesher *, const dense_change *, double sign);

static trocar_status update(dense_remesher *r, const dense_change *c, addition add, trocar_error *why) {
    trocar_status status = factor_change(r, c, why);
    if (status == TROCAR_OK) add(r, c, -1.0);
    return status;
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

static trocar_status update_triangle(dense_remesher *r, const dense_change *c, trocar_error *why) { return update(r, c, add_to_triangle, why); }

static trocar_status undo_triangle(dense_remesher *r, const dense_change *c, trocar_error *why) {
    (void)why;
    add_to_triangle(r, c, 1.0);
    return TROCAR_OK;
}

static const dense_operations triangle = {update_triangle, undo_triangle, false, ALL_RANKS};

trocar_status remesher_create_woodbury(inverse *inv, remesher **created, trocar_error *why) { return dense_remesher_create(inv, &triangle, created, why); }

/* ---- in the full matrix --------------------------------------------------------------------------------------------- */

static void add_to_square(dense_remesher *r, const dense_change *c, double sign) {
    const double *left = r->weighted + (size_t)c->first * (size_t)r->ld, *right = r->columns + (size_t)c->first * (size_t)r->ld;
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasTrans, c->n, c->n, c->count, sign, left, r->ld, right, r->ld, 1.0, r->matrix, r->ld);
}

static trocar_status update_square(dense_remesher *r, const dense_change *c, trocar_error *why) { return update(r, c, add_to_square, why); }

static trocar_status undo_square(dense_remesher *r, const dense_change *c, trocar_error *why) {
    (void)why;
    add_to_square(r, c, 1.0);
    return TROCAR_OK;
}

static const dense_operations square = {update_square, undo_square, false, ALL_RANKS};

trocar_status remesher_create_woodbury_general(inverse *inv, remesher **created, trocar_error *why) {
    return dense_remesher_create(inv, &square, created, why);
}
