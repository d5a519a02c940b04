#include "inverse/sparse_inverse_columns.h"

#include <cblas.h>
#include <stdlib.h>
#include <string.h>

enum { WIDTH = 3 * HALF_BLOCK, SIDE = 3 * PRODUCT_BLOCK, PANEL = 512 /* most rows of Y packed at once */ };

/* A supernode is a set of consecutive columns of L with the same sparsity pattern, stored as a dense block with a triangle at the top. In CHOLMOD's arrays,
   `super` is the first column, `pi` the index in `s` of the first row number, and `px` the index in `x` of the first value. Supernodes are in postorder, so a
   supernode's subtree is a range of supernodes that ends with it. */
struct sparse_columns {
    const tissue *tissue;
    const int *super, *pi, *px, *rows;
    const double *values;
    int supernodes;
    int *supernode;          /* [dof_count]: supernode that contains each column */
    int *parent;             /* for each supernode: parent in the elimination tree, or -1 */
    int *lowest;             /* for each supernode: first supernode of its subtree */
    int *height;             /* for each supernode: number of columns on the path from its first column to the root */
    int *start;              /* for each supernode: first column used by the current solve, or -1; all -1 between calls */
    double *x;               /* dof_count x WIDTH, column-major; all zero between calls */
    double *update;          /* workspace, (maxesize + 1) x WIDTH entries, where maxesize is CHOLMOD's */
    double *left, *right;    /* PANEL x SIDE: packed rows of Y */
    double *product;         /* SIDE x SIDE */
    int *way;                /* supernodes that contribute to the product */
};

/* ---- the tree --------------------------------------------------------------------------------------------------------- */

static int width(const sparse_columns *h, int s) { return h->super[s + 1] - h->super[s]; }
static const int *rows_below(const sparse_columns *h, int s) { return h->rows + h->pi[s] + width(h, s); }
static int count_below(const sparse_columns *h, int s) { return h->pi[s + 1] - h->pi[s] - width(h, s); }

static void find_tree(sparse_columns *h) {
    for (int s = 0; s < h->supernodes; s++) {
        for (int c = h->super[s]; c < h->super[s + 1]; c++) h->supernode[c] = s;
        h->lowest[s] = s;
        h->start[s] = -1;
    }
    for (int s = 0; s < h->supernodes; s++) {
        h->parent[s] = count_below(h, s) > 0 ? h->supernode[rows_below(h, s)[0]] : -1;
        if (h->parent[s] >= 0 && h->lowest[s] < h->lowest[h->parent[s]]) h->lowest[h->parent[s]] = h->lowest[s];
    }
    for (int s = h->supernodes - 1; s >= 0; s--) h->height[s] = width(h, s) + (h->parent[s] >= 0 ? h->height[h->parent[s]] : 0);
}

static int column_of(const sparse_columns *h, int dof) { return h->tissue->column[dof / 3]; }
static int supernode_of(const sparse_columns *h, int dof) { return h->supernode[column_of(h, dof)]; }
static bool passes(const sparse_columns *h, int dof, int s) { return supernode_of(h, dof) >= h->lowest[s] && supernode_of(h, dof) <= s; }

int sparse_columns_length(const sparse_columns *h, int dof) {
    int s = supernode_of(h, dof);
    return h->height[s] - (column_of(h, dof) - h->super[s]);
}

int sparse_columns_longest(const sparse_columns *h) {
    int longest = 0;
    for (int dof = 0; dof < h->tissue->dof_count; dof += 3)
        if (sparse_columns_length(h, dof) > longest) longest = sparse_columns_length(h, dof);
    return longest;
}

/* ---- solving ---------------------------------------------------------------------------------------------------------- */

static void touch(sparse_columns *h, int s, int column) {
    if (h->start[s] < 0 || column < h->start[s]) h->start[s] = column;
}

/* Does forward substitution in the columns of a supernode, from h->start[s] on, and then updates later rows. */
static void eliminate(sparse_columns *h, int s, int right_sides) {
    int n = h->tissue->dof_count, ld = h->pi[s + 1] - h->pi[s], skipped = h->start[s] - h->super[s], below = count_below(h, s);
    int columns = width(h, s) - skipped;
    const double *first = h->values + h->px[s] + (size_t)skipped * (size_t)ld;
    double *x = h->x + h->start[s];
    cblas_dtrsm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, columns, right_sides, 1.0, first + skipped, ld, x, n);
    if (below == 0) return;
    const int *rows = rows_below(h, s);
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasNoTrans, below, right_sides, columns, 1.0, first + width(h, s), ld, x, n, 0.0, h->update, below);
    for (int j = 0; j < right_sides; j++)
        for (int i = 0; i < below; i++) h->x[(size_t)j * (size_t)n + (size_t)rows[i]] -= h->update[(size_t)j * (size_t)below + (size_t)i];
    touch(h, h->parent[s], rows[0]);
}

static void copy_way(const sparse_columns *h, int dof, const double *x, double *y) {
    size_t length = (size_t)sparse_columns_length(h, dof), n = (size_t)h->tissue->dof_count;
    int from = column_of(h, dof);
    for (int s = supernode_of(h, dof); s >= 0; s = h->parent[s]) {
        size_t columns = (size_t)(h->super[s + 1] - from);
        for (size_t a = 0; a < 3; a++) memcpy(y + a * length, x + a * n + from, columns * sizeof *y);
        y += columns;
        if (h->parent[s] >= 0) from = h->super[h->parent[s]];
    }
}

void sparse_columns_half_solve(sparse_columns *h, int count, const int *dofs, double *const *y) {
    size_t n = (size_t)h->tissue->dof_count;
    int first = h->supernodes;
    for (int i = 0; i < count; i++) {
        int column = column_of(h, dofs[i]), s = supernode_of(h, dofs[i]);
        for (size_t a = 0; a < 3; a++) h->x[(3 * (size_t)i + a) * n + (size_t)column + a] = 1.0;
        touch(h, s, column);
        if (s < first) first = s;
    }
    for (int s = first; s < h->supernodes; s++)
        if (h->start[s] >= 0) eliminate(h, s, 3 * count);
    for (int i = 0; i < count; i++) copy_way(h, dofs[i], h->x + 3 * (size_t)i * n, y[i]);
    for (int s = first; s < h->supernodes; s++) {
        if (h->start[s] < 0) continue;
        for (size_t j = 0; j < 3 * (size_t)count; j++)
            memset(h->x + j * n + h->start[s], 0, (size_t)(h->super[s + 1] - h->start[s]) * sizeof *h->x);
        h->start[s] = -1;
    }
}

/* ---- products --------------------------------------------------------------------------------------------------------- */

/* The rows or columns of a product to which one supernode contributes. */
typedef struct {
    int count, place[PRODUCT_BLOCK]; /* number and indices of the nodes whose path contains the supernode */
} side;

static side find_side(const sparse_columns *h, int s, int count, const int *dofs) {
    side found = {0};
    for (int i = 0; i < count; i++)
        if (passes(h, dofs[i], s)) found.place[found.count++] = i;
    return found;
}

/* Rows [from, from + rows) of a supernode. */
typedef struct {
    int supernode, from, rows;
} panel;

/* Packs the rows of panel `p` from each Y, with zeros above the start of a path. The result is column-major with leading dimension PANEL. */
static void pack(const sparse_columns *h, panel p, const side *of, const half_solved *solved, double *packed) {
    for (int i = 0; i < of->count; i++) {
        int dof = solved->dofs[of->place[i]], length = sparse_columns_length(h, dof), at = length - h->height[p.supernode] + p.from;
        int missing = at < 0 ? (-at < p.rows ? -at : p.rows) : 0;
        for (int a = 0; a < 3; a++) {
            double *column = packed + (size_t)(3 * i + a) * PANEL;
            memset(column, 0, (size_t)missing * sizeof *column);
            memcpy(column + missing, solved->y[of->place[i]] + (size_t)a * (size_t)length + at + missing, (size_t)(p.rows - missing) * sizeof *column);
        }
    }
}

static void add_product(const sparse_columns *h, const side *rows, const side *columns, double *out, int ld) {
    for (int j = 0; j < 3 * columns->count; j++)
        for (int i = 0; i < 3 * rows->count; i++)
            out[(size_t)(3 * rows->place[i / 3] + i % 3) * (size_t)ld + (size_t)(3 * columns->place[j / 3] + j % 3)] += h->product[j * SIDE + i];
}

/* Lists the supernodes on the paths of these nodes, each once. Returns how many there are. */
static int collect_ways(sparse_columns *h, int count, const int *dofs) {
    int found = 0;
    for (int i = 0; i < count; i++)
        for (int s = supernode_of(h, dofs[i]); s >= 0 && h->start[s] < 0; s = h->parent[s]) {
            h->start[s] = 0;
            h->way[found++] = s;
        }
    for (int k = 0; k < found; k++) h->start[h->way[k]] = -1;
    return found;
}

void sparse_columns_product(sparse_columns *h, const half_solved *rows, const half_solved *columns, double *out, int ld) {
    for (int i = 0; i < 3 * rows->count; i++) memset(out + (size_t)i * (size_t)ld, 0, 3 * (size_t)columns->count * sizeof *out);
    int supernodes = collect_ways(h, rows->count, rows->dofs);
    for (int k = 0; k < supernodes; k++) {
        int s = h->way[k];
        side left = find_side(h, s, rows->count, rows->dofs), right = find_side(h, s, columns->count, columns->dofs);
        if (right.count == 0) continue;
        for (int from = 0; from < width(h, s); from += PANEL) {
            int depth = width(h, s) - from < PANEL ? width(h, s) - from : PANEL;
            pack(h, (panel){s, from, depth}, &left, rows, h->left);
            pack(h, (panel){s, from, depth}, &right, columns, h->right);
            cblas_dgemm(CblasColMajor, CblasTrans, CblasNoTrans, 3 * left.count, 3 * right.count, depth, 1.0, h->left, PANEL, h->right, PANEL,
                        from == 0 ? 0.0 : 1.0, h->product, SIDE);
        }
        add_product(h, &left, &right, out, ld);
    }
}

/* ---- creation --------------------------------------------------------------------------------------------------------- */

trocar_status sparse_columns_create(const tissue *t, sparse_columns **created, trocar_error *why) {
    const cholmod_factor *f = t->factor;
    size_t n = (size_t)t->dof_count, supernodes = f->nsuper;
    sparse_columns *h = calloc(1, sizeof *h);
    *created = h;
    if (!h) return fail(why, TROCAR_NO_MEMORY, "no memory");
    *h = (sparse_columns){.tissue = t, .super = f->super, .pi = f->pi, .px = f->px, .rows = f->s, .values = f->x, .supernodes = (int)supernodes,
                       .supernode = malloc(n * sizeof(int)), .parent = malloc(supernodes * sizeof(int)), .lowest = malloc(supernodes * sizeof(int)),
                       .height = malloc(supernodes * sizeof(int)), .start = malloc(supernodes * sizeof(int)), .way = malloc(supernodes * sizeof(int)),
                       .x = calloc(n * WIDTH, sizeof(double)), .update = malloc((f->maxesize + 1) * WIDTH * sizeof(double)),
                       .left = malloc(sizeof(double[PANEL * SIDE])), .right = malloc(sizeof(double[PANEL * SIDE])),
                       .product = malloc(sizeof(double[SIDE * SIDE]))};
    if (h->supernode && h->parent && h->lowest && h->height && h->start && h->way && h->x && h->update && h->left && h->right && h->product) {
        find_tree(h);
        return TROCAR_OK;
    }
    sparse_columns_free(h);
    *created = NULL;
    return fail(why, TROCAR_NO_MEMORY, "no memory to solve for %zu unknowns", n);
}

void sparse_columns_free(sparse_columns *h) {
    if (!h) return;
    free(h->supernode);
    free(h->parent);
    free(h->lowest);
    free(h->height);
    free(h->start);
    free(h->way);
    free(h->x);
    free(h->update);
    free(h->left);
    free(h->right);
    free(h->product);
    free(h);
}
