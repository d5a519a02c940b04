/* Implicit low-rank form: the stiffness change of every contact node is kept as a factor that is never multiplied out, inverse(a, b) = C(a, b) - sum_j
   F_j(a) M_j F_j(b)^T, F_j(a) = C(a, touched_j) - sum_(i<j) F_i(a) M_i F_i(touched_j)^T (Woodbury, one change after the other: these are the block factors
   of a single capacitance matrix over all touched dofs). C is the inverse of the nominal mesh. In C, each added node is held by an auxiliary spring, which
   the node's change removes again. Rows are formed only at the handles. */
#include "oracles/remesh_dense.h"

#include <cblas.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    int first, rank;                      /* its first column among those of all changes, and how many it has */
    int nodes[MAX_PATCH];                 /* touched, coded */
    double middle[MAX_RANK * MAX_RANK];   /* M, rank square, N/m */
} low_rank;

typedef struct {
    remesher shared;
    double spring;                        /* m/N, compliance of an added node's auxiliary spring */
    low_rank changes[MAX_CONTACTS];       /* in the order of the nodes */
    double *factors;                      /* SNAPSHOT_LD x ALL_RANKS, row-major: F of the handles in use */
    double *chain;                        /* ALL_RANKS square, row-major: column block j contains M_i F_i(touched_j)^T for i < j */
    double *touched;                      /* MAX_RANK x ALL_RANKS: F of the nodes touched by a new change */
    double *product, *packed, *packed_middle; /* scratch: one square of SNAPSHOT_LD rows, and two arrays of SNAPSHOT_LD x MAX_RANK */
} implicit_remesher;

static double *factor_row(implicit_remesher *r, int handle) { return r->factors + (size_t)3 * (size_t)handle * ALL_RANKS; }

static int ranks_before(const implicit_remesher *r, int index) {
    return index > 0 ? r->changes[index - 1].first + r->changes[index - 1].rank : 0;
}

/* Writes C between two coded nodes. */
static void start_block(implicit_remesher *r, int node, int other, double *out, int ld) {
    if (node >= 0 && other >= 0) {
        mat3 block = nominal_block(&r->shared, node, other);
        for (int a = 0; a < 3; a++) memcpy(out + a * ld, block.m[a], sizeof block.m[a]);
        return;
    }
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) out[a * ld + b] = node == other && a == b ? r->spring : 0.0;
}

/* Computes F_j of a node for change j = `index`. F of earlier changes is already in `row`. */
static void extend_factors(implicit_remesher *r, int index, int node, double *row) {
    const low_rank *change = &r->changes[index];
    for (int q = 0; 3 * q < change->rank; q++) start_block(r, node, change->nodes[q], row + change->first + 3 * q, ALL_RANKS);
    if (change->first > 0)
        cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, 3, change->rank, change->first, -1.0, row, ALL_RANKS,
                    r->chain + change->first, ALL_RANKS, 1.0, row + change->first, ALL_RANKS);
}

/* Subtracts F M F^T of change `index` from the rows in use (sign -1), or adds it back (sign 1). */
static void update_rows(implicit_remesher *r, int index, double sign) {
    const low_rank *change = &r->changes[index];
    int handles[MAX_HANDLES], count = handles_in_use(&r->shared, handles), n = change->rank;
    for (int i = 0; i < 3 * count; i++) {
        const double *row = factor_row(r, handles[i / 3]) + (size_t)(i % 3) * ALL_RANKS;
        memcpy(r->packed + (size_t)i * MAX_RANK, row + change->first, (size_t)n * sizeof *row);
    }
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, 3 * count, n, n, 1.0, r->packed, MAX_RANK, change->middle, n, 0.0,
                r->packed_middle, MAX_RANK);
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasTrans, 3 * count, 3 * count, n, sign, r->packed_middle, MAX_RANK, r->packed, MAX_RANK, 0.0,
                r->product, SNAPSHOT_LD);
    for (int i = 0; i < count; i++)
        for (int j = 0; j <= i; j++) {
            mat3 block = handle_get(&r->shared, handles[i], handles[j]);
            m3_add_block(&block, 1.0, r->product + (size_t)(3 * i) * SNAPSHOT_LD + 3 * j, SNAPSHOT_LD);
            handle_put(&r->shared, handles[i], handles[j], &block);
        }
}

/* Forms the whole row of a handle whose factors are known. */
static void form_row(implicit_remesher *r, int handle) {
    int handles[MAX_HANDLES], count = handles_in_use(&r->shared, handles), own = handle_node(&r->shared, handle);
    int changes = r->shared.refined.count;
    double *row = factor_row(r, handle), *weighted = r->touched; /* weighted: F M of each change in turn */
    for (int k = 0; k < changes; k++) {
        const low_rank *change = &r->changes[k];
        cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, 3, change->rank, change->rank, 1.0, row + change->first, ALL_RANKS,
                    change->middle, change->rank, 0.0, weighted + change->first, ALL_RANKS);
    }
    for (int i = 0; i < count; i++) {
        mat3 block;
        start_block(r, own, handle_node(&r->shared, handles[i]), &block.m[0][0], 3);
        if (changes > 0)
            cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasTrans, 3, 3, ranks_before(r, changes), -1.0, weighted, ALL_RANKS,
                        factor_row(r, handles[i]), ALL_RANKS, 1.0, &block.m[0][0], 3);
        handle_put(&r->shared, handle, handles[i], &block);
    }
}

static void find_factors(implicit_remesher *r, int handle) {
    for (int k = 0; k < r->shared.refined.count; k++) extend_factors(r, k, handle_node(&r->shared, handle), factor_row(r, handle));
}

static void gather_touched(implicit_remesher *r, int index, bool as_rows) {
    const low_rank *change = &r->changes[index];
    for (int q = 0; 3 * q < change->rank; q++) {
        if (change->nodes[q] < 0) continue;
        gather_column(&r->shared, change->nodes[q]);
        if (as_rows) gather_row(&r->shared, change->nodes[q]);
    }
}

/* Fetches all blocks that the factors of the given rows may need with the first `count` changes. */
static trocar_status gather_factors(implicit_remesher *r, int count, trocar_error *why) {
    for (int k = 0; k < MAX_WINDOW; k++)
        if (r->shared.window[k] >= 0) gather_column(&r->shared, r->shared.window[k]);
    for (int k = 0; k < count; k++) gather_touched(r, k, false);
    return gather_finish(&r->shared, why);
}

static trocar_status implicit_take_nodes(remesher *shared, int count, const int *handles, trocar_error *why) {
    implicit_remesher *r = (implicit_remesher *)shared;
    gather_start(shared);
    for (int i = 0; i < count; i++) gather_row(shared, handle_node(shared, handles[i]));
    trocar_status status = gather_factors(r, shared->refined.count, why);
    for (int i = 0; i < count && status == TROCAR_OK; i++) find_factors(r, handles[i]);
    for (int i = 0; i < count && status == TROCAR_OK; i++) form_row(r, handles[i]);
    return status;
}

/* Computes F of the touched nodes for all changes up to the new one. The new change's F is the current inverse between these nodes. */
static void touch_nodes(implicit_remesher *r, int index) {
    const low_rank *change = &r->changes[index];
    for (int q = 0; 3 * q < change->rank; q++)
        for (int k = 0; k < index; k++) extend_factors(r, k, change->nodes[q], r->touched + (size_t)(3 * q) * ALL_RANKS);
    for (int k = 0; k < index; k++) { /* column block of the chain: M_k F_k(touched)^T */
        const low_rank *old = &r->changes[k];
        cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasTrans, old->rank, change->rank, old->rank, 1.0, old->middle, old->rank,
                    r->touched + old->first, ALL_RANKS, 0.0, r->chain + (size_t)old->first * ALL_RANKS + change->first, ALL_RANKS);
    }
    for (int q = 0; 3 * q < change->rank; q++) extend_factors(r, index, change->nodes[q], r->touched + (size_t)(3 * q) * ALL_RANKS);
}

static trocar_status implicit_add(remesher *shared, int slot, trocar_error *why) {
    implicit_remesher *r = (implicit_remesher *)shared;
    int index = shared->refined.count;
    low_rank *change = &r->changes[index];
    patch *p = &shared->patch;
    patch_create(shared->tissue, &shared->refined, index, p);
    bool moved = shared->refined.nodes[slot].moved >= 0;
    for (int a = 3 * p->count - 3; a < 3 * p->count && !moved; a++) p->change[a][a] -= 1.0 / r->spring;
    change->first = ranks_before(r, index);
    change->rank = 3 * p->count;
    memcpy(change->nodes, p->nodes, (size_t)p->count * sizeof *p->nodes);
    gather_start(shared);
    gather_touched(r, index, true);
    trocar_status status = gather_factors(r, index, why);
    if (status != TROCAR_OK) return status;
    touch_nodes(r, index);
    status = change_middle(change->rank, (strided_matrix){&p->change[0][0], MAX_RANK}, (strided_matrix){r->touched + change->first, ALL_RANKS}, change->middle, why);
    if (status != TROCAR_OK) return status;

    int handles[MAX_HANDLES], count = handles_in_use(shared, handles);
    for (int i = 0; i < count; i++) extend_factors(r, index, handle_node(shared, handles[i]), factor_row(r, handles[i]));
    update_rows(r, index, -1.0);
    shared->refined.count++; /* the node's row is computed like any handle's */
    find_factors(r, slot);
    form_row(r, slot);
    shared->refined.count--;
    find_between_contacts(shared, slot);
    return TROCAR_OK;
}

static void implicit_remove(remesher *shared, int slot, int position) {
    (void)slot;
    update_rows((implicit_remesher *)shared, position, 1.0);
}

static void implicit_release(remesher *shared) {
    implicit_remesher *r = (implicit_remesher *)shared;
    free(r->factors);
    free(r->chain);
    free(r->touched);
    free(r->product);
    free(r->packed);
    free(r->packed_middle);
}

static const remesh_operations implicit = {implicit_add, implicit_remove, false, implicit_take_nodes, NULL, implicit_release};

/* Allocates large arrays, but never touches the pages that no change reaches. */
trocar_status remesher_create_implicit(inverse *inv, remesher **created, trocar_error *why) {
    implicit_remesher *r = calloc(1, sizeof *r);
    *created = r ? &r->shared : NULL;
    if (!r) return fail(why, TROCAR_NO_MEMORY, "no memory");
    trocar_status status = remesher_init(*created, &implicit, inv, why);
    r->factors = calloc((size_t)SNAPSHOT_LD * ALL_RANKS, sizeof(double));
    r->chain = calloc((size_t)ALL_RANKS * ALL_RANKS, sizeof(double));
    r->touched = calloc((size_t)MAX_RANK * ALL_RANKS, sizeof(double));
    r->product = calloc((size_t)SNAPSHOT_LD * SNAPSHOT_LD, sizeof(double));
    r->packed = calloc((size_t)SNAPSHOT_LD * MAX_RANK, sizeof(double));
    r->packed_middle = calloc((size_t)SNAPSHOT_LD * MAX_RANK, sizeof(double));
    if (!r->factors || !r->chain || !r->touched || !r->product || !r->packed || !r->packed_middle)
        status = fail(why, TROCAR_NO_MEMORY, "no memory for the factors of the remeshing");
    double row[9] = {0};
    int node = 0;
    while (inverse_tissue(inv)->fixed[node] || !inverse_holds(inv, node)) node++;
    if (status == TROCAR_OK) status = inverse_gather(inv, &(inverse_blocks){1, &node, 1, &node, row, 3}, why);
    r->spring = row[0]; /* any value would do, because the spring is removed again; one as large as the compliances loses no digits */
    return status;
}
