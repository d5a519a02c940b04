/* State of the nested addition method, shared by remesh_nested.c, nested_rows.c and nested_removal.c only. The notation is explained in remesh_nested.c. */
#ifndef TROCAR_NESTED_H
#define TROCAR_NESTED_H

#include "remesh/remesh_method.h"
#include "linalg/row_triples.h"

enum {
    REACHED = 12,                         /* maximum number of nominal nodes that one addition couples to: those of two elements and their neighbours */
    MAX_EXTRA = REACHED + 4,             /* maximum number of nominal nodes that one addition needs outside the window */
    MAX_PLACES = MAX_HANDLES + MAX_EXTRA, /* handles, followed by extra nodes */
    NESTED_LD = 3 * MAX_PLACES,
};

typedef struct {
    bool on_face;                         /* the node is on a face, so its surplus is coupled to the old nodes */
    double weights[4];                    /* barycentric weights in the nominal element */
    int nominal_count, nominal[REACHED];  /* nominal nodes that the surplus is coupled to, directly or through contact nodes */
    mat3 coupling[REACHED];               /* N/m, c_j at the nodes in `nominal` */
    mat3 chain[MAX_CONTACTS];             /* G_ij = S_i sum_touched F_i^T c_j, i < j */
    mat3 surplus;                         /* S_j, m/N */
} bordering;

typedef struct {
    remesher shared;
    bordering borders[MAX_CONTACTS];
    int extra_count, extra[MAX_EXTRA];  /* nodes outside the window that the current addition needs */
    double (*nominal)[NESTED_LD];         /* NESTED_LD rows, m/N: K^-1 between the places in use, [3 i + a][3 j + b] */
    double (*factors)[3][NESTED_LD];      /* MAX_CONTACTS entries, dimensionless: F_j^T, where F_j(i) is at [j][b][3 i + a] */
} nested_remesher;

/* nested_place returns the place of a node (encoded like a leaf corner), or -1 if it has none. nested_factor returns F_j at a place. */
int nested_place(const nested_remesher *r, int node);
mat3 nested_factor(const nested_remesher *r, int j, int place);

/* Returns the column ranges of the handles in use and of contact node `slot`, which is being added. `slot` is -1 if none is. */
column_ranges nested_columns(const nested_remesher *r, int slot);

/* Returns the column ranges of the handles in use, of contact node `slot` and of the extra nodes. */
column_ranges nested_all_columns(const nested_remesher *r, int slot);

/* Fills the rows of `nominal` and `factors` for new places. Each is a window entry or an extra node. */
trocar_status nested_enter(nested_remesher *r, int count, const int *places, trocar_error *why);

/* Fills the rows and columns of `nominal` for the contact node in `slot`, interpolating between nominal nodes. */
void nested_interpolate(nested_remesher *r, int slot);

/* Computes the three rows of the inverse, with the first `count` contact nodes, that belong to a nominal node's place. Columns: all handles. The rows are
   SNAPSHOT_LD apart. */
void nested_inverse_rows(const nested_remesher *r, int count, int place, const column_ranges *columns, double *rows);

/* Copies the rows of `place` in a symmetric matrix into its columns at the other `places`. */
void nested_mirror(double *matrix, int ld, int place, int count, const int *places);

/* Adds F S F^T to the rows of the handles in use if `sign` is 1, or subtracts it if `sign` is -1. */
void nested_update_rows(nested_remesher *r, int slot, double sign);

/* Exchanges the node in `slot`, which is no longer in `order`, with each node from `position` on, so that it can then be removed as if it had been added last.
   Updates factors, chains and surpluses. */
void nested_move_to_end(nested_remesher *r, int slot, int position);

#endif
