/* The interface of a method that updates the inverse, private to the method's files; tests/oracles contains other methods for comparison. */
#ifndef TROCAR_REMESH_METHOD_H
#define TROCAR_REMESH_METHOD_H

#include "inverse/inverse.h"
#include "refinement/patch.h"
#include "snapshot/free_displacement.h"
#include "snapshot/snapshot.h"

typedef struct remesher remesher; /* remesh.h */

enum { MAX_AHEAD = 640 };           /* nodes prefetched in idle time */
enum { MAX_ROWS = MAX_WINDOW, MAX_COLUMNS = MAX_WINDOW + MAX_MOVED_PATCHES + 8 * MAX_CONTACTS };

/* Blocks of the nominal inverse that one step needs, fetched from the owner of the inverse in one call. */
typedef struct {
    int row_count, rows[MAX_ROWS], column_count, columns[MAX_COLUMNS]; /* nominal nodes, without duplicates */
    int *row_of, *column_of;         /* [node_count]: index of each node in `rows` or `columns`, or -1 */
    double *blocks;                  /* 3 MAX_ROWS x 3 MAX_COLUMNS, row-major, m/N */
    trocar_status status;            /* status of the last failed fetch of a single block since gather_start */
    trocar_error why;                /* error message of that failure */
} gathered_blocks;

/* The inverse contains the nodes in the order of `refined`. A node that is being added or removed is in order[count] and is not counted. */
typedef struct {
    trocar_status (*add)(remesher *, int slot, trocar_error *);   /* adds the contact node in `slot` to the inverse, after all others, and to between_contacts */
    void (*remove)(remesher *, int slot, int position);     /* removes the contact node in `slot` from the inverse; the nodes from `position` on in the
                                                               order were added after it */
    bool any_order;          /* true if `remove` accepts any node on which no later one depends; false if it accepts only the last node */
    trocar_status (*take_nodes)(remesher *, int count, const int *handles, trocar_error *); /* fills the rows of nodes that are new in the window; NULL if not
                                                                                         needed */
    trocar_status (*gather)(remesher *, trocar_error *);          /* fills all rows in use; NULL if they are always up to date */
    void (*release)(remesher *);                            /* frees everything except the shared part */
} remesh_operations;

/* Data common to all methods; first member of every method's struct. */
struct remesher {
    const remesh_operations *operations;
    inverse *inverse;
    const tissue *tissue;
    refinement refined;              /* nodes currently in the inverse, in the order of their addition */
    int window[MAX_WINDOW];          /* nominal node at each place of the window, or -1; changed only by window_put */
    int *place_of;                   /* [node_count]: place of each nominal node in the window, or -1 */
    double *handles;                 /* m/N, laid out like compliance_snapshot.compliance */
    vec3 line_tip, line_direction;   /* line of the last request */
    bool line_new;                   /* true if the line has not been followed yet */
    int ahead_count, ahead_done, ahead[MAX_AHEAD]; /* nominal nodes along the line, and number of those prefetched so far */
    resolver *resolver;
    int piece_count;
    line_piece pieces[MAX_PIECES];   /* lines of the last request */
    resolved_field resolved[MAX_CONTACTS]; /* resolution of the mesh at each contact node */
    struct { line_in_tet line; vec3 at; } measured[MAX_CONTACTS]; /* line and point (m) for which `resolved` was measured */
    contact_rows between_contacts[MAX_CONTACTS]; /* m/N, compliance of the nominal mesh, as in compliance_snapshot */
    residual_field residual;         /* displacement caused by the residual loads of the last request */
    patch patch;                     /* scratch */
    gathered_blocks gathered;        /* scratch */
};

/* Computes the middle matrix of Woodbury's formula, M = change (I + block change)^-1 = (I + change block)^-1 change, which is symmetric: a change in stiffness
   at n dofs reduces the inverse by H M H^T, where H are the inverse's columns at these dofs and `block` is the inverse between them. Row-major; `middle`
   (n square) may be the same memory as `change`. */
typedef struct { const double *entries; int ld; } strided_matrix;
trocar_status change_middle(int n, strided_matrix change, strided_matrix block, double *middle, trocar_error *why);

trocar_status remesher_init(remesher *r, const remesh_operations *operations, inverse *inv, trocar_error *why);
void remesher_release(remesher *r); /* frees the memory allocated by remesher_init */

trocar_status remesher_create_nested(inverse *inv, remesher **created, trocar_error *why);

/* Lists the handles in use: contact nodes in order, then the window. Returns their number. */
int handles_in_use(const remesher *r, int handles[MAX_HANDLES]);

/* window_place returns the place of a nominal node in the window, or -1. window_put assigns a node (-1: none) to a place. */
int window_place(const remesher *r, int node);
void window_put(remesher *r, int place, int node);

/* Returns the node of a handle in use, coded as a leaf corner; for a moved node, this is the nominal node. */
int handle_node(const remesher *r, int handle);

/* Returns the handle of a coded node, or -1. */
int handle_of_node(const remesher *r, int node);

double *handle_block(remesher *r, int handle, int other);    /* leading dimension SNAPSHOT_LD */
mat3 handle_get(remesher *r, int handle, int other);
void handle_put(remesher *r, int handle, int other, const mat3 *block); /* also writes the transpose */

/* Fetch blocks of the nominal inverse: gather_start begins a list of rows and columns, gather_finish fetches the blocks between them. */
void gather_start(remesher *r);
void gather_row(remesher *r, int node);
void gather_column(remesher *r, int node);
trocar_status gather_finish(remesher *r, trocar_error *why);

/* Returns a block of the nominal inverse between nominal nodes: a gathered one, in either order, or else one fetched from the owner. Zero after a failure,
   in which case the caller discards its results (gathered.status). */
mat3 nominal_block(remesher *r, int node, int other);

#endif
