#include "remesh.h"

#include <cblas.h>
#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

enum { CORNERS = 4, PATCH = 3 * (CORNERS + 1) };  /* dofs that an interior addition touches: four corners and the node */
enum { MAX_COLUMNS = MAX_WINDOW + CORNERS * MAX_CONTACTS }; /* nodes that a new place of the window couples to */

/* How one node is put into the inverse and taken out again. */
typedef struct {
    trocar_status (*add)(remesher *, int index, report *);
    void (*remove)(remesher *, int index);
    bool keeps_window;       /* window blocks stay valid when nodes come and go */
} remesh_operations;

struct remesher {
    inverse *inverse;
    const tissue *tissue;
    const remesh_operations *operations;
    refinement refined;              /* what is in the inverse now */
    int window[MAX_WINDOW];          /* nominal node of each place, or -1 */
    double *handles;                 /* as compliance_snapshot.compliance */
    double *gathered;                /* 3 MAX_WINDOW x 3 MAX_COLUMNS: scratch of fill_window_places */
    /* dense Woodbury only */
    int extended;                    /* rows of `dense`: dof_count + 3 MAX_CONTACTS */
    double *dense;                   /* inverse of the refined stiffness, column-major */
    double start;                    /* m/N: a new node starts on a spring so weak that it counts as free, the paper's
                                        "large number" on the diagonal; the update itself takes the spring away again */
    double *left, *right;            /* extended x PATCH for each added node: dense = old - left right^T */
};

/* ---- handles ----------------------------------------------------------------------------------------------------- */

static double *block_at(double *matrix, int row_handle, int column_handle) {
    return matrix + (size_t)3 * (size_t)row_handle * SNAPSHOT_LD + 3 * column_handle;
}

static void put_symmetric(double *matrix, int i, int j, const mat3 *block) {
    double *upper = block_at(matrix, i, j), *lower = block_at(matrix, j, i);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) upper[a * SNAPSHOT_LD + b] = lower[b * SNAPSHOT_LD + a] = block->m[a][b];
}

static void add_scaled(mat3 *sum, double weight, const double *block, int ld) {
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) sum->m[a][b] += weight * block[a * ld + b];
}

static int window_place(const int *window, int node) {
    for (int k = 0; k < MAX_WINDOW; k++)
        if (window[k] == node) return k;
    return -1;
}

/* Nominal barycentric weights of an added node: what its displacement owes to the nominal nodes. */
static void nominal_weights(const remesher *r, int index, double weights[4]) {
    mesh_barycentric(r->tissue->mesh, r->refined.nodes[index].tet, r->refined.nodes[index].position, weights);
}

/* Compliance between a nominal node and added node `index`: the surplus does not couple to the nominal nodes. */
static mat3 nominal_to_added(const remesher *r, int node, int index) {
    double weights[4], blocks[3 * 12];
    nominal_weights(r, index, weights);
    inverse_gather(r->inverse, 1, &node, 4, r->tissue->mesh->tets[r->refined.nodes[index].tet], blocks, 12);
    mat3 sum = {{{0}}};
    for (int c = 0; c < 4; c++) add_scaled(&sum, weights[c], blocks + 3 * c, 12);
    return sum;
}

static mat3 nominal_to_nominal(const remesher *r, int node, int other) {
    mat3 block;
    inverse_gather(r->inverse, 1, &node, 1, &other, &block.m[0][0], 3);
    return block;
}

/* ---- nested addition: bordered rank-3 form, c = 0 inside an element ------------------------------------------------ */

/* Compliance between one leaf corner (coded) and any handle of the present handles matrix. */
static mat3 corner_to_handle(remesher *r, int corner, int handle) {
    int place = corner < 0 ? -1 - corner : window_place(r->window, corner);
    if (corner >= 0 && place >= 0) place += MAX_CONTACTS;
    if (place < 0) /* nominal, not in the window */
        return handle < MAX_CONTACTS ? nominal_to_added(r, corner, handle)
                                     : nominal_to_nominal(r, corner, r->window[handle - MAX_CONTACTS]);
    mat3 block = {{{0}}};
    add_scaled(&block, 1.0, block_at(r->handles, place, handle), SNAPSHOT_LD);
    return block;
}

static mat3 interpolated(remesher *r, const added_node *node, int handle) {
    mat3 sum = {{{0}}};
    for (int c = 0; c < CORNERS; c++) {
        mat3 block = corner_to_handle(r, node->corners[c], handle);
        add_scaled(&sum, node->weights[c], &block.m[0][0], 3);
    }
    return sum;
}

/* The new row of the inverse is the interpolation of its leaf's rows; its diagonal block gains the surplus d^-1. */
static trocar_status nested_add(remesher *r, int index, report *why) {
    (void)why;
    const added_node *node = &r->refined.nodes[index];
    for (int j = 0; j < index; j++) {
        mat3 block = interpolated(r, node, j);
        put_symmetric(r->handles, index, j, &block);
    }
    for (int k = 0; k < MAX_WINDOW; k++) {
        if (r->window[k] < 0) continue;
        mat3 block = interpolated(r, node, MAX_CONTACTS + k);
        put_symmetric(r->handles, index, MAX_CONTACTS + k, &block);
    }
    leaf_point at;
    memcpy(at.corners, node->corners, sizeof at.corners);
    memcpy(at.weights, node->weights, sizeof at.weights);
    mat3 diagonal = surplus_compliance(r->tissue, &r->refined, node->tet, &at);
    for (int c = 0; c < CORNERS; c++) { /* w^T (corner to node): the node's own row is interpolated once more */
        int corner = node->corners[c];
        mat3 block = corner < 0 ? interpolated(r, node, -1 - corner) : nominal_to_added(r, corner, index);
        mat3 transposed = m3_transposed(&block);
        add_scaled(&diagonal, node->weights[c], corner < 0 ? &transposed.m[0][0] : &block.m[0][0], 3);
    }
    put_symmetric(r->handles, index, index, &diagonal);
    return TROCAR_OK;
}

static void nested_remove(remesher *r, int index) { (void)r, (void)index; } /* the surplus is dropped with its row */

static const remesh_operations nested = {nested_add, nested_remove, true};

/* ---- the paper's dense Woodbury update (eq. 4) --------------------------------------------------------------------- */

static void isolate(remesher *r, int index) {
    size_t n = (size_t)r->extended, first = (size_t)(r->tissue->dof_count + 3 * index);
    for (size_t i = 0; i < n; i++)
        for (size_t a = first; a < first + 3; a++) r->dense[a * n + i] = r->dense[i * n + a] = 0.0;
    for (size_t a = first; a < first + 3; a++) r->dense[a * n + a] = r->start;
}

/* First dof of a coded corner in the extended numbering, -1 where fixed. */
static int extended_dof(const remesher *r, int corner) {
    return corner >= 0 ? r->tissue->dof[corner] : r->tissue->dof_count + 3 * (-1 - corner);
}

static vec3 position_of(const remesher *r, int corner) {
    return corner >= 0 ? r->tissue->mesh->nodes[corner] : r->refined.nodes[-1 - corner].position;
}

/* Stiffness change of the patch: four new elements minus the leaf, minus the starting spring. 15 x 15, node-major. */
static void patch_change(const remesher *r, const added_node *node, const int corners[CORNERS + 1], double change[PATCH][PATCH]) {
    double youngs_modulus, poisson_ratio; /* averaged volumetric strain does not change inside an element */
    element_moduli(r->tissue, node->tet, &youngs_modulus, &poisson_ratio);
    memset(change, 0, sizeof(double[PATCH][PATCH]));
    for (int e = 0; e <= CORNERS; e++) { /* e < 4: the leaf with corner e replaced by the node; e = 4: the leaf itself */
        int local[4] = {0, 1, 2, 3};
        if (e < CORNERS) local[e] = CORNERS;
        vec3 x[4];
        for (int i = 0; i < 4; i++) x[i] = position_of(r, corners[local[i]]);
        double k[12][12];
        tet_stiffness(x, youngs_modulus, poisson_ratio, k);
        for (int a = 0; a < 12; a++)
            for (int b = 0; b < 12; b++)
                change[3 * local[a / 3] + a % 3][3 * local[b / 3] + b % 3] += e < CORNERS ? k[a][b] : -k[a][b];
    }
    for (int a = 3 * CORNERS; a < PATCH; a++) change[a][a] -= 1.0 / r->start;
}

/* dense -= A M A^T with A = dense V and M = change (I + V^T A change)^-1. */
static trocar_status woodbury_add(remesher *r, int index, report *why) {
    const added_node *node = &r->refined.nodes[index];
    int n = r->extended, corners[CORNERS + 1];
    memcpy(corners, node->corners, sizeof node->corners);
    corners[CORNERS] = -1 - index;
    double change[PATCH][PATCH], system[PATCH][PATCH], middle[PATCH][PATCH];
    patch_change(r, node, corners, change);

    double *left = r->left + (size_t)index * (size_t)n * PATCH, *right = r->right + (size_t)index * (size_t)n * PATCH;
    int dofs[PATCH];
    for (int a = 0; a < PATCH; a++) {
        int first = extended_dof(r, corners[a / 3]);
        dofs[a] = first < 0 ? -1 : first + a % 3;
        if (dofs[a] < 0) memset(right + (size_t)a * (size_t)n, 0, (size_t)n * sizeof(double));
        else memcpy(right + (size_t)a * (size_t)n, r->dense + (size_t)dofs[a] * (size_t)n, (size_t)n * sizeof(double));
    }
    for (int a = 0; a < PATCH; a++)      /* system = (I + B change)^T = I + change B, row-major; middle = change */
        for (int b = 0; b < PATCH; b++) {
            system[a][b] = a == b ? 1.0 : 0.0;
            for (int c = 0; c < PATCH; c++)
                system[a][b] += dofs[c] < 0 || dofs[b] < 0 ? 0.0 : change[a][c] * right[(size_t)b * (size_t)n + (size_t)dofs[c]];
            middle[a][b] = change[a][b];
        }
    lapack_int pivots[PATCH];            /* (I + change B)^-1 change = change (I + B change)^-1 = M */
    if (LAPACKE_dgesv(LAPACK_ROW_MAJOR, PATCH, PATCH, &system[0][0], PATCH, pivots, &middle[0][0], PATCH) != 0)
        return fail(why, TROCAR_NUMERIC, "Woodbury update of node %d is singular", index);
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasTrans, n, PATCH, PATCH, 1.0, right, n, &middle[0][0], PATCH, 0.0, left, n);
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasTrans, n, n, PATCH, -1.0, left, n, right, n, 1.0, r->dense, n);
    return TROCAR_OK;
}

static void woodbury_remove(remesher *r, int index) {
    int n = r->extended;
    double *left = r->left + (size_t)index * (size_t)n * PATCH, *right = r->right + (size_t)index * (size_t)n * PATCH;
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasTrans, n, n, PATCH, 1.0, left, n, right, n, 1.0, r->dense, n);
    isolate(r, index);
}

static const remesh_operations woodbury = {woodbury_add, woodbury_remove, false};

/* Copies the blocks between all handles in use from the dense inverse. */
static void gather_dense(remesher *r) {
    int dofs[MAX_HANDLES];
    for (int i = 0; i < MAX_CONTACTS; i++) dofs[i] = i < r->refined.count ? extended_dof(r, -1 - i) : -1;
    for (int k = 0; k < MAX_WINDOW; k++) dofs[MAX_CONTACTS + k] = r->window[k] < 0 ? -1 : r->tissue->dof[r->window[k]];
    size_t n = (size_t)r->extended;
    for (int i = 0; i < MAX_HANDLES; i++)
        for (int j = 0; j <= i; j++) {
            mat3 block = {{{0}}};
            if (dofs[i] >= 0 && dofs[j] >= 0) add_scaled(&block, 1.0, r->dense + (size_t)dofs[i] * n + dofs[j], (int)n);
            put_symmetric(r->handles, i, j, &block);
        }
}

static trocar_status woodbury_create(remesher *r, report *why) {
    const double *inverse = inverse_dense(r->inverse);
    if (!inverse) return fail(why, TROCAR_BAD_INPUT, "remeshing: woodbury needs the dense inverse; choose nested for this mesh");
    size_t dofs = (size_t)r->tissue->dof_count, n = dofs + 3 * MAX_CONTACTS;
    r->extended = (int)n;
    r->dense = calloc(n * n, sizeof(double));
    r->left = calloc(n * PATCH * MAX_CONTACTS, sizeof(double));
    r->right = calloc(n * PATCH * MAX_CONTACTS, sizeof(double));
    if (!r->dense || !r->left || !r->right)
        return fail(why, TROCAR_NO_MEMORY, "no memory for a second dense inverse (%.1f GB); choose remeshing: nested", 8e-9 * (double)(n * n));
    for (size_t j = 0; j < dofs; j++) memcpy(r->dense + j * n, inverse + j * dofs, dofs * sizeof(double));
    r->start = 1e4 * inverse[0];
    for (int i = 0; i < MAX_CONTACTS; i++) isolate(r, i);
    return TROCAR_OK;
}

/* ---- serving ------------------------------------------------------------------------------------------------------- */

trocar_status remesher_create(inverse *inv, remesh_method method, remesher **created, report *why) {
    remesher *r = calloc(1, sizeof *r);
    *created = r;
    if (!r) return fail(why, TROCAR_NO_MEMORY, "no memory");
    r->inverse = inv;
    r->tissue = inverse_tissue(inv);
    r->operations = method == REMESH_WOODBURY ? &woodbury : &nested;
    for (int k = 0; k < MAX_WINDOW; k++) r->window[k] = -1;
    r->handles = calloc((size_t)SNAPSHOT_LD * SNAPSHOT_LD, sizeof(double));
    r->gathered = malloc((size_t)9 * MAX_WINDOW * MAX_COLUMNS * sizeof(double));
    trocar_status status = r->handles && r->gathered ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory");
    if (status == TROCAR_OK && method == REMESH_WOODBURY) status = woodbury_create(r, why);
    if (status == TROCAR_OK) return TROCAR_OK;
    remesher_free(r);
    *created = NULL;
    return status;
}

void remesher_free(remesher *r) {
    if (!r) return;
    free(r->handles);
    free(r->gathered);
    free(r->dense);
    free(r->left);
    free(r->right);
    free(r);
}

/* Place of a node in a list that it is added to where it is missing. */
static int place_in(int *nodes, int *count, int node) {
    for (int i = 0; i < *count; i++)
        if (nodes[i] == node) return i;
    nodes[*count] = node;
    return (*count)++;
}

/* Rows of new places, in one gather: to the whole window and to the added nodes, as weighted corners of their elements. */
static void fill_window_places(remesher *r, int count, const int *places) {
    int rows[MAX_WINDOW], columns[MAX_COLUMNS], column_count = 0, of_window[MAX_WINDOW], of_corner[MAX_CONTACTS][CORNERS];
    for (int p = 0; p < count; p++) rows[p] = r->window[places[p]];
    for (int k = 0; k < MAX_WINDOW; k++)
        if (r->window[k] >= 0) of_window[k] = place_in(columns, &column_count, r->window[k]);
    for (int i = 0; i < r->refined.count; i++)
        for (int c = 0; c < CORNERS; c++) of_corner[i][c] = place_in(columns, &column_count, r->tissue->mesh->tets[r->refined.nodes[i].tet][c]);
    const int ld = 3 * MAX_COLUMNS;
    inverse_gather(r->inverse, count, rows, column_count, columns, r->gathered, ld);
    for (int p = 0; p < count; p++) {
        const double *row = r->gathered + (size_t)(3 * p) * (size_t)ld;
        for (int k = 0; k < MAX_WINDOW; k++) {
            mat3 block = {{{0}}};
            if (r->window[k] < 0) continue;
            add_scaled(&block, 1.0, row + 3 * of_window[k], ld);
            put_symmetric(r->handles, MAX_CONTACTS + places[p], MAX_CONTACTS + k, &block);
        }
        for (int i = 0; i < r->refined.count; i++) {
            mat3 block = {{{0}}};
            double weights[CORNERS];
            nominal_weights(r, i, weights);
            for (int c = 0; c < CORNERS; c++) add_scaled(&block, weights[c], row + 3 * of_corner[i][c], ld);
            put_symmetric(r->handles, MAX_CONTACTS + places[p], i, &block);
        }
    }
}

/* Nodes that are still wanted keep their places; new ones take the free places. */
static trocar_status move_window(remesher *r, const remesh_request *request, report *why) {
    int places[MAX_WINDOW], count = 0;
    trocar_status status = r->operations->keeps_window ? inverse_prefetch(r->inverse, request->window_count, request->window, why) : TROCAR_OK;
    if (status != TROCAR_OK) return status;
    for (int k = 0; k < MAX_WINDOW; k++) {
        bool wanted = false;
        for (int i = 0; i < request->window_count && !wanted; i++) wanted = request->window[i] == r->window[k];
        if (!wanted) r->window[k] = -1;
    }
    for (int i = 0; i < request->window_count; i++) {
        if (window_place(r->window, request->window[i]) >= 0) continue;
        places[count] = window_place(r->window, -1);
        r->window[places[count++]] = request->window[i];
    }
    if (r->operations->keeps_window && count > 0) fill_window_places(r, count, places);
    return TROCAR_OK;
}

static trocar_status update_nodes(remesher *r, const refinement *wanted, report *why) {
    int kept = 0;
    while (kept < r->refined.count && kept < wanted->count && r->refined.nodes[kept].id == wanted->nodes[kept].id) kept++;
    for (; r->refined.count > kept; r->refined.count--) r->operations->remove(r, r->refined.count - 1);
    for (; r->refined.count < wanted->count; r->refined.count++) {
        r->refined.nodes[r->refined.count] = wanted->nodes[r->refined.count];
        trocar_status status = r->operations->add(r, r->refined.count, why);
        if (status != TROCAR_OK) return status;
    }
    return TROCAR_OK;
}

trocar_status remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, report *why) {
    if (request->wanted.count > MAX_CONTACTS || request->window_count > MAX_WINDOW)
        return fail(why, TROCAR_BAD_INPUT, "a request of %d added nodes and %d in the window: at most %d and %d", request->wanted.count,
                    request->window_count, MAX_CONTACTS, MAX_WINDOW);
    trocar_status status = move_window(r, request, why);
    if (status == TROCAR_OK) status = update_nodes(r, &request->wanted, why);
    if (status != TROCAR_OK) return status;
    if (!r->operations->keeps_window) gather_dense(r);
    snapshot->serial = request->serial;
    snapshot->added_count = r->refined.count;
    for (int i = 0; i < r->refined.count; i++) snapshot->ids[i] = r->refined.nodes[i].id;
    memcpy(snapshot->window, r->window, sizeof r->window);
    memcpy(snapshot->compliance, r->handles, (size_t)SNAPSHOT_LD * SNAPSHOT_LD * sizeof(double));
    return TROCAR_OK;
}

trocar_status remesher_resume(remesher *r, const remesh_request *request, const compliance_snapshot *snapshot, report *why) {
    static const refinement nothing = {.count = 0};
    bool answered = snapshot->serial != 0 && snapshot->serial == request->serial;
    trocar_status status = update_nodes(r, &nothing, why);
    for (int k = 0; k < MAX_WINDOW; k++) r->window[k] = answered ? snapshot->window[k] : -1;
    if (status != TROCAR_OK || !answered) return status;
    status = update_nodes(r, &request->wanted, why);
    memcpy(r->handles, snapshot->compliance, sizeof snapshot->compliance); /* rows by another way round differ in the last bits */
    return status;
}
