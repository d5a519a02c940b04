/* State of nested addition, for remesh_nested.c, nested_rows.c and nested_removal.c only. Notation as in remesh_nested.c. */
#ifndef TROCAR_NESTED_H
#define TROCAR_NESTED_H

#include "remesh/remesh_method.h"
#include "linalg/row_triples.h"

enum {
    REACHED = 12,                         /* nominal nodes that an addition can reach: of two elements, and of those beside them */
    MAX_EXTRA = REACHED + 4,             /* nominal nodes that one addition needs and that are not in the window */
    MAX_PLACES = MAX_HANDLES + MAX_EXTRA, /* handles, then extra nodes */
    NESTED_LD = 3 * MAX_PLACES,
};

typedef struct {
    bool on_face;                         /* the surplus couples to the old nodes */
    double weights[4];                    /* nominal weights: its weights at the nominal nodes of its element */
    int nominal_count, nominal[REACHED];  /* nominal nodes that the coupling reaches through the nodes that it touches, */
    mat3 coupling[REACHED];               /* and c_j there, N/m */
    mat3 chain[MAX_CONTACTS];             /* G_ij = S_i sum_touched F_i^T c_j, i < j */
    mat3 surplus;                         /* S_j, m/N */
} bordering;

typedef struct {
    remesher shared;
    bordering borders[MAX_CONTACTS];
    int extra_count, extra[MAX_EXTRA];  /* of the addition in progress */
    double (*nominal)[NESTED_LD];         /* NESTED_LD rows: K^-1 between the places in use, m/N: [3 i + a][3 j + b] */
    double (*factors)[3][NESTED_LD];      /* MAX_CONTACTS times: F_j^T, m/N times N/m: F_j(i) at [j][b][3 i + a] */
    void *nominal_memory, *factors_memory; /* these two */
} nested_remesher;

/* Place of a coded node, or -1; F_j there. */
int nested_place(const nested_remesher *r, int node);
mat3 nested_factor(const nested_remesher *r, int j, int place);

/* The columns of the handles in use, and of contact node `slot` that is being added (-1: none). */
column_ranges nested_columns(const nested_remesher *r, int slot);

/* The same, with the extra nodes. */
column_ranges nested_all_columns(const nested_remesher *r, int slot);

/* Fills `nominal` and `factors` of places that are new: in the window, or extra nodes. */
trocar_status nested_enter(nested_remesher *r, int count, const int *places, report *why);

/* The contact node in `slot`, as an interpolation of nominal nodes: its rows and columns of `nominal`. */
void nested_interpolate(nested_remesher *r, int slot);

/* The inverse with the first `count` contact nodes between a nominal node's place and all handles: three rows, SNAPSHOT_LD apart. */
void nested_inverse_rows(const nested_remesher *r, int count, int place, const column_ranges *columns, double *rows);

/* Makes the columns of a symmetric matrix equal to the rows of this place, at the other places. */
void nested_mirror(double *matrix, int ld, int place, int count, const int *places);

/* The rows of the handles in use gain F S F^T, or lose it again. */
void nested_update_rows(nested_remesher *r, int slot, double sign);

/* Exchanges the node in `slot`, no longer in the order, with those from `position` on in it, so that it can be removed as the last one:
   changes factors, chains and surpluses. */
void nested_move_to_end(nested_remesher *r, int slot, int position);

#endif
