/* Interface of the methods that update the inverse; private to the methods' files. */
#ifndef TROCAR_REMESH_METHOD_H
#define TROCAR_REMESH_METHOD_H

#include "inverse/inverse.h"
#include "refinement/patch.h"
#include "snapshot/free_displacement.h"
#include "snapshot/snapshot.h"

typedef struct remesher remesher; /* remesh.h */

enum { MAX_AHEAD = 640 };           /* nodes prefetched in idle time */
enum { MAX_ROWS = MAX_WINDOW, MAX_COLUMNS = MAX_WINDOW + MAX_MOVED_PATCHES + 8 * MAX_CONTACTS };

/* Blocks of the nominal inverse that one step needs, fetched from the owner in one call. */
typedef struct {
    int row_count, rows[MAX_ROWS], column_count, columns[MAX_COLUMNS]; /* nominal nodes, each once */
    int *row_of, *column_of;         /* node_count: index of each node in `rows` or `columns`, or -1 */
    double *blocks;                  /* 3 MAX_ROWS x 3 MAX_COLUMNS, row-major, m/N */
    trocar_status status;            /* last failure among blocks fetched one by one since gather_start */
    report why;                      /* error message of that failure */
} gathered_blocks;

/* Nodes are in the inverse in the order of `refined`. The node being added or removed is in order[count], not counted. */
typedef struct {
    trocar_status (*add)(remesher *, int slot, report *);   /* adds the contact node in `slot` to the inverse, after all others */
    void (*remove)(remesher *, int slot, int position);     /* removes it; the nodes from `position` on in the order were added later */
    bool any_order;          /* `remove` accepts any node on which no later one depends; otherwise only the last one */
    trocar_status (*take_nodes)(remesher *, int count, const int *handles, report *); /* fills the rows of new nodes in the window; NULL: not needed */
    trocar_status (*gather)(remesher *, report *);          /* fills all rows in use; NULL: they are always up to date */
    void (*release)(remesher *);                            /* frees everything except the shared part */
    bool finds_between_contacts; /* `add` fills the new node's part of between_contacts */
} remesh_operations;

/* Data common to all methods; first member of every method's struct. */
struct remesher {
    const remesh_operations *operations;
    inverse *inverse;
    const tissue *tissue;
    refinement refined;              /* nodes in the inverse now, in the order of their addition */
    int window[MAX_WINDOW];          /* nominal node of each place, or -1; only window_put changes it */
    int *place_of;                   /* node_count: place of each nominal node in the window, or -1 */
    double *handles;                 /* m/N, laid out like compliance_snapshot.compliance */
    void *handles_memory;            /* memory of `handles` */
    vec3 line_tip, line_direction;   /* line of the last request */
    bool line_new;                   /* the line has not been followed yet */
    int ahead_count, ahead_done, ahead[MAX_AHEAD]; /* nominal nodes along the line; number prefetched so far */
    resolver *resolver;
    int piece_count;
    line_piece pieces[MAX_PIECES];   /* lines of the last request */
    resolved_field resolved[MAX_CONTACTS]; /* resolution of the mesh at each contact node */
    contact_rows between_contacts[MAX_CONTACTS]; /* m/N, compliance of the nominal mesh, as in compliance_snapshot */
    residual_field residual;         /* displacement by the residual loads of the last request */
    patch patch;                     /* scratch */
    gathered_blocks gathered;        /* scratch */
};

/* M = change (I + block change)^-1 = (I + change block)^-1 change, symmetric: a stiffness change at `n` dofs subtracts M from the inverse, between its columns
   at those dofs (Woodbury); `block` is the inverse between the dofs. Row-major; `middle`, n square, may be `change`. */
typedef struct { const double *entries; int ld; } strided_matrix;
trocar_status change_middle(int n, strided_matrix change, strided_matrix block, double *middle, report *why);

trocar_status remesher_init(remesher *r, const remesh_operations *operations, inverse *inv, report *why);
void remesher_release(remesher *r); /* frees the memory allocated by init */

trocar_status remesher_create_nested(inverse *inv, remesher **created, report *why);
trocar_status remesher_create_implicit(inverse *inv, remesher **created, report *why);

/* The handles in use: contact nodes in order, then the window. Returns their number. */
int handles_in_use(const remesher *r, int handles[MAX_HANDLES]);

/* window_place: place of a nominal node in the window, or -1. window_put: puts a node (-1: none) into a place. */
int window_place(const remesher *r, int node);
void window_put(remesher *r, int place, int node);

/* The node of a handle in use, coded as a leaf corner; for a moved node, the nominal node. */
int handle_node(const remesher *r, int handle);

/* The handle of a coded node, or -1. */
int handle_of_node(const remesher *r, int node);

double *handle_block(remesher *r, int handle, int other);    /* leading dimension SNAPSHOT_LD */
mat3 handle_get(remesher *r, int handle, int other);
void handle_put(remesher *r, int handle, int other, const mat3 *block); /* also writes the transpose */

/* Fetch blocks of the nominal inverse: gather_start begins a list of rows and columns, gather_finish fetches the blocks between them. */
void gather_start(remesher *r);
void gather_row(remesher *r, int node);
void gather_column(remesher *r, int node);
trocar_status gather_finish(remesher *r, report *why);

/* A block of the nominal inverse between nominal nodes: gathered, in either order, or else fetched from the owner. Zero on failure; the caller then discards
   its results (gathered.status). */
mat3 nominal_block(remesher *r, int node, int other);

#endif
