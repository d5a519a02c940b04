/* The interface that a method of updating the inverse implements, private to these methods. tests/oracles has further methods, for comparison. */
#ifndef TROCAR_REMESH_METHOD_H
#define TROCAR_REMESH_METHOD_H

#include "inverse/inverse.h"
#include "refinement/patch.h"
#include "snapshot/free_displacement.h"
#include "snapshot/snapshot.h"

typedef struct remesher remesher; /* remesh.h */

enum { MAX_AHEAD = 640 };           /* nodes prefetched in idle time */
enum { MAX_ROWS = MAX_WINDOW, MAX_COLUMNS = MAX_WINDOW + MAX_MOVED_PATCHES + 8 * MAX_CONTACTS };

/* The blocks of the nominal inverse needed for one step, fetched from the owner of the inverse in a single call. */
typedef struct {
    int row_count, rows[MAX_ROWS], column_count, columns[MAX_COLUMNS]; /* nominal nodes, without duplicates */
    int *row_of, *column_of;         /* [node_count]: each node's index in `rows` or `columns`, or -1 */
    double *blocks;                  /* 3 MAX_ROWS x 3 MAX_COLUMNS, row-major, m/N */
    trocar_status status;            /* of the last single block that could not be fetched since gather_start; otherwise OK */
    trocar_error why;                /* error message of that failure */
} gathered_blocks;

/* What a method must provide. The nodes in the inverse are those of `refined`, in its order. A node being added or removed is in order[count], which is not
   counted. */
typedef struct {
    trocar_status (*add)(remesher *, int slot, trocar_error *);   /* adds the contact node in `slot` to the inverse, as the last one, and to between_contacts */
    void (*remove)(remesher *, int slot, int position);     /* removes the contact node in `slot` from the inverse; the nodes from `position` on in `order` were
                                                               added after it */
    bool any_order;          /* `remove` accepts any node on which no later one depends, not just the last */
    trocar_status (*take_nodes)(remesher *, int count, const int *handles, trocar_error *); /* fills the rows of nodes that are new in the window; NULL if not
                                                                                               needed */
    trocar_status (*gather)(remesher *, trocar_error *);          /* fills all rows in use; NULL if they are always up to date */
    void (*release)(remesher *);                            /* frees everything but the shared part */
} remesh_operations;

/* Data common to all methods. Each method's struct starts with this. */
struct remesher {
    const remesh_operations *operations;
    inverse *inverse;
    const tissue *tissue;
    refinement refined;              /* nodes now in the inverse, in the order they were added */
    int window[MAX_WINDOW];          /* nominal node at each place of the window, or -1. Modified only by window_put */
    int *place_of;                   /* [node_count]: each nominal node's place in the window, or -1 */
    double *handles;                 /* m/N, laid out like compliance_snapshot.compliance */
    vec3 line_tip, line_direction;   /* line of the last request */
    bool line_new;                   /* the line has not been followed yet */
    int ahead_count, ahead_done, ahead[MAX_AHEAD]; /* nominal nodes along the line, and how many of them have been prefetched */
    resolver *resolver;
    int piece_count;
    line_piece pieces[MAX_PIECES];   /* lines of the last request */
    resolved_field resolved[MAX_CONTACTS]; /* the mesh's resolution at each contact node */
    struct { line_in_tet line; vec3 at; } measured[MAX_CONTACTS]; /* line and point (m) for which each `resolved` was measured */
    contact_rows between_contacts[MAX_CONTACTS]; /* m/N, compliance of the nominal mesh, as in compliance_snapshot */
    residual_field residual;         /* displacements due to the residual loads of the last request */
    patch patch;                     /* scratch */
    gathered_blocks gathered;        /* scratch */
};

/* Computes the middle matrix of the Woodbury formula, M = change (I + block change)^-1 = (I + change block)^-1 change, which is symmetric. `change`: change in
   stiffness at n degrees of freedom. `block`: the inverse between them. The change reduces the inverse by H M H^T, where H holds the inverse's columns at these
   degrees of freedom. `middle`: n square, row-major; may be the same memory as `change`. */
typedef struct { const double *entries; int ld; } strided_matrix;
trocar_status change_middle(int n, strided_matrix change, strided_matrix block, double *middle, trocar_error *why);

trocar_status remesher_init(remesher *r, const remesh_operations *operations, inverse *inv, trocar_error *why);
void remesher_release(remesher *r); /* frees what remesher_init allocated */

trocar_status remesher_create_nested(inverse *inv, remesher **created, trocar_error *why);

/* Lists the handles in use: the contact nodes in order, then the window. Returns how many there are. */
int handles_in_use(const remesher *r, int handles[MAX_HANDLES]);

/* window_place returns where a nominal node is in the window, or -1. window_put puts a node there, or empties the place if `node` is -1. */
int window_place(const remesher *r, int node);
void window_put(remesher *r, int place, int node);

/* Returns the node of a handle in use, encoded like a leaf corner. For a moved node, this is the nominal node. */
int handle_node(const remesher *r, int handle);

/* Returns the handle of a node (encoded like a leaf corner), or -1 if it has none. */
int handle_of_node(const remesher *r, int node);

double *handle_block(remesher *r, int handle, int other);    /* leading dimension SNAPSHOT_LD */
mat3 handle_get(remesher *r, int handle, int other);
void handle_put(remesher *r, int handle, int other, const mat3 *block); /* also writes the transpose */

/* Fetch blocks of the nominal inverse. gather_start clears the list of rows and columns, gather_row and gather_column add to it, and gather_finish fetches the
   blocks between them. */
void gather_start(remesher *r);
void gather_row(remesher *r, int node);
void gather_column(remesher *r, int node);
trocar_status gather_finish(remesher *r, trocar_error *why);

/* Returns a block of the nominal inverse between two nominal nodes. Uses a gathered block, in either order, if there is one, and otherwise fetches the block
   from the owner. Returns zero on failure; callers then discard their results (see gathered.status). */
mat3 nominal_block(remesher *r, int node, int other);

#endif
