#include "oracles/remesh_dense.h"

#include <stdlib.h>
#include <string.h>

#include "base/large_pages.h"
#include "oracles/dense_matrix.h"

static double *entry(const dense_remesher *r, int row, int column) {
    int low = row > column ? row : column, high = row > column ? column : row;
    return r->matrix + (size_t)high * (size_t)r->ld + low;
}

void dense_take_columns(const dense_remesher *r, int n, int count, const int *dofs, double *columns) {
    for (int a = 0; a < count; a++) {
        double *to = columns + (size_t)a * (size_t)r->ld;
        for (int j = 0; j < dofs[a]; j++) to[j] = *entry(r, dofs[a], j);
        memcpy(to + dofs[a], entry(r, dofs[a], dofs[a]), (size_t)(n - dofs[a]) * sizeof *to);
    }
}

void dense_put_columns(dense_remesher *r, int n, int count, const int *dofs, const double *columns) {
    for (int a = 0; a < count; a++) {
        const double *from = columns + (size_t)a * (size_t)r->ld;
        for (int j = 0; j < dofs[a]; j++) *entry(r, dofs[a], j) = from[j];
        memcpy(entry(r, dofs[a], dofs[a]), from + dofs[a], (size_t)(n - dofs[a]) * sizeof *from);
    }
}

void dense_isolate(dense_remesher *r, const dense_change *change, double diagonal) {
    for (int a = change->count - change->fresh; a < change->count; a++) {
        for (int j = 0; j < change->n; j++) *entry(r, change->dofs[a], j) = 0.0;
        *entry(r, change->dofs[a], change->dofs[a]) = diagonal;
    }
}

/* ---- one contact node more or less ---------------------------------------------------------------------------------- */

/* Returns the first of a node's three dofs. `node` is coded and must not be fixed. */
static int first_dof(const remesher *r, int node) { return node >= 0 ? r->tissue->dof[node] : r->tissue->dof_count + 3 * (-1 - node); }

/* Collects the change due to the node in `slot`, before which `position` other nodes were added. */
static void collect_change(dense_remesher *r, int slot, int position) {
    remesher *shared = &r->shared;
    const refinement *refined = &shared->refined;
    int span = refinement_span(refined);
    patch *p = &shared->patch;
    dense_change *c = &r->change;
    patch_create(shared->tissue, refined, refined->count, p);
    c->n = shared->tissue->dof_count + 3 * (slot < span ? span : slot + 1);
    c->count = 3 * p->count;
    c->fresh = refined->nodes[slot].moved >= 0 ? 0 : 3;
    c->first = 0;
    for (int i = 0; i < position; i++) c->first += r->ranks[refined->order[i]];
    r->ranks[slot] = c->count;
    for (int a = 0; a < c->count; a++) {
        c->dofs[a] = first_dof(shared, p->nodes[a / 3]) + a % 3;
        memcpy(c->change + a * c->count, p->change[a], (size_t)c->count * sizeof(double));
    }
}

static trocar_status dense_add(remesher *shared, int slot, trocar_error *why) {
    dense_remesher *r = (dense_remesher *)shared;
    find_between_contacts(shared, slot);
    if (r->spoilt) return TROCAR_OK; /* dense_gather_rows will add all nodes again */
    collect_change(r, slot, shared->refined.count);
    trocar_status status = r->operations->update(r, &r->change, why);
    r->spoilt = status != TROCAR_OK;
    return status;
}

/* Restores the nominal inverse from a copy, so that no rounding error is left once the last contact node has been removed. */
static void restore(dense_remesher *r) {
    size_t n = (size_t)r->shared.tissue->dof_count;
    for (size_t j = 0; j < n; j++) memcpy(r->matrix + j * (size_t)r->ld + j, r->nominal + j * n + j, (n - j) * sizeof *r->nominal);
    r->spoilt = false;
}

static void dense_remove(remesher *shared, int slot, int position) {
    dense_remesher *r = (dense_remesher *)shared;
    const refinement *refined = &shared->refined;
    trocar_error unused; /* if undoing fails, all remaining nodes are added again, which reports any error */
    if (refined->count == 0) restore(r);
    if (r->spoilt || refined->count == 0) return;
    collect_change(r, slot, position);
    r->spoilt = r->operations->undo(r, &r->change, &unused) != TROCAR_OK;
    dense_isolate(r, &r->change, 0.0); /* later changes leave free slots alone */
}

/* Adds all nodes again, starting from the nominal inverse, after an update that failed half-way has left the matrix unusable. */
static trocar_status rebuild(dense_remesher *r, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    refinement *refined = &r->shared.refined;
    int all = refined->count;
    restore(r);
    for (refined->count = 0; refined->count < all && status == TROCAR_OK; refined->count++) status = dense_add(&r->shared, refined->order[refined->count], why);
    refined->count = all;
    return status;
}

static trocar_status dense_gather_rows(remesher *shared, trocar_error *why) {
    dense_remesher *r = (dense_remesher *)shared;
    trocar_status status = r->spoilt ? rebuild(r, why) : TROCAR_OK;
    if (status != TROCAR_OK) return status;
    int handles[MAX_HANDLES], dofs[MAX_HANDLES], count = handles_in_use(shared, handles);
    for (int i = 0; i < count; i++) dofs[i] = first_dof(shared, handle_node(shared, handles[i]));
    for (int i = 0; i < count; i++)
        for (int j = 0; j <= i; j++) {
            mat3 block = {{{0}}};
            for (int a = 0; a < 9 && dofs[i] >= 0 && dofs[j] >= 0; a++) block.m[a / 3][a % 3] = *entry(r, dofs[i] + a / 3, dofs[j] + a % 3);
            handle_put(shared, handles[i], handles[j], &block);
        }
    return TROCAR_OK;
}

static void dense_release(remesher *shared) {
    dense_remesher *r = (dense_remesher *)shared;
    size_t n = (size_t)r->ld;
    advise_pages(r->matrix, n * n * sizeof *r->matrix, MADV_NOHUGEPAGE);
    free(r->matrix);
    free(r->nominal);
    free(r->columns);
    free(r->weighted);
}

static const remesh_operations last_first = {dense_add, dense_remove, false, NULL, dense_gather_rows, dense_release};
static const remesh_operations in_any_order = {dense_add, dense_remove, true, NULL, dense_gather_rows, dense_release};

static double *large_matrix(size_t n) {
    double *zeros = calloc(n * n, sizeof *zeros);
    advise_pages(zeros, n * n * sizeof *zeros, MADV_HUGEPAGE);
    return zeros;
}

trocar_status dense_remesher_create(inverse *inv, const dense_operations *operations, remesher **created, trocar_error *why) {
    dense_remesher *r = calloc(1, sizeof *r);
    *created = r ? &r->shared : NULL;
    if (!r) return fail(why, TROCAR_NO_MEMORY, "no memory");
    trocar_status status = remesher_init(*created, operations->any_order ? &in_any_order : &last_first, inv, why);
    size_t n = (size_t)inverse_tissue(inv)->dof_count + 3 * MAX_CONTACTS, ranks = (size_t)operations->ranks;
    r->operations = operations;
    r->ld = (int)n;
    r->matrix = large_matrix(n);
    r->nominal = dense_matrix(inv);
    r->columns = calloc(n * ranks, sizeof(double)); /* memory pages that no change reaches are never touched */
    r->weighted = calloc(n * ranks, sizeof(double));
    if (!r->matrix || !r->nominal || !r->columns || !r->weighted)
        return fail(why, TROCAR_NO_MEMORY, "no memory for two more dense inverses (%.1f GB)",
                    8e-9 * (double)(n * n));
    restore(r);
    return status;
}
