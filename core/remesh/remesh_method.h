/* What a way to update the inverse provides; for the methods' files only. */
#ifndef TROCAR_REMESH_METHOD_H
#define TROCAR_REMESH_METHOD_H

#include "inverse/inverse.h"
#include "refinement/patch.h"
#include "snapshot/free_displacement.h"
#include "snapshot/snapshot.h"

typedef struct remesher remesher; /* remesh.h */

enum { MAX_AHEAD = 640 };           /* nodes that are made ready in idle time */
enum { MAX_ROWS = MAX_WINDOW, MAX_COLUMNS = MAX_WINDOW + MAX_MOVED_PATCHES + 8 * MAX_CONTACTS };

/* Blocks of the nominal inverse that one step needs, fetched from its owner together. */
typedef struct {
    int row_count, rows[MAX_ROWS], column_count, columns[MAX_COLUMNS]; /* nominal nodes, each once */
    int *row_of, *column_of;         /* node_count: place among those, or -1 */
    double *blocks;                  /* 3 MAX_ROWS x 3 MAX_COLUMNS, row-major, m/N */
    trocar_status status;            /* of those asked for one by one since the start: the last failure, */
    report why;                      /* and its reason */
} gathered_blocks;

/* Nodes are in the inverse in the order of `refined`. The one that comes or goes is in order[count], not counted. */
typedef struct {
    trocar_status (*add)(remesher *, int slot, report *);   /* puts the contact node in `slot` into the inverse, behind all others */
    void (*remove)(remesher *, int slot, int position);     /* takes it out; those from `position` on in order had come after it */
    bool any_order;          /* `remove` takes out any node that no later one hangs on; else only the last one */
    trocar_status (*take_nodes)(remesher *, int count, const int *handles, report *); /* fills rows of nodes new in the window; NULL: not needed */
    trocar_status (*gather)(remesher *, report *);          /* fills all rows in use; NULL: they are kept up to date */
    void (*release)(remesher *);                            /* all but the shared part */
    bool finds_between_contacts; /* `add` fills the new node's part of between_contacts */
} remesh_operations;

/* First member of every method's struct. */
struct remesher {
    const remesh_operations *operations;
    inverse *inverse;
    const tissue *tissue;
    refinement refined;              /* what is in the inverse now; in the order in which it came there */
    int window[MAX_WINDOW];          /* nominal node of each place, or -1; only window_put changes it */
    int *place_of;                   /* node_count: place of each nominal node in the window, or -1 */
    double *handles;                 /* as compliance_snapshot.compliance, */
    void *handles_memory;            /* in here */
    vec3 line_tip, line_direction;   /* of the last request */
    bool line_new;                   /* not followed yet */
    int ahead_count, ahead_done, ahead[MAX_AHEAD]; /* nominal nodes along the line; made ready so far */
    resolver *resolver;
    int piece_count;
    line_piece pieces[MAX_PIECES];   /* of the last request */
    resolved_field resolved[MAX_CONTACTS]; /* at each contact node */
    contact_rows between_contacts[MAX_CONTACTS]; /* as in compliance_snapshot */
    left_field left;                 /* of the last request */
    patch patch;                     /* scratch */
    gathered_blocks gathered;        /* scratch */
};

/* M = change (I + block change)^-1 = (I + change block)^-1 change, symmetric: what a change of stiffness at `n` dofs takes off the inverse
   between their columns (Woodbury), where `block` is the inverse between them. Row-major; `middle`, n square, may be `change`. */
typedef struct { const double *entries; int ld; } strided_matrix;
trocar_status change_middle(int n, strided_matrix change, strided_matrix block, double *middle, report *why);

trocar_status remesher_init(remesher *r, const remesh_operations *operations, inverse *inv, report *why);
void remesher_release(remesher *r); /* what init has allocated */

trocar_status remesher_create_nested(inverse *inv, remesher **created, report *why);
trocar_status remesher_create_implicit(inverse *inv, remesher **created, report *why);

/* The handles in use: contact nodes in order, then the window. Returns how many. */
int handles_in_use(const remesher *r, int handles[MAX_HANDLES]);

/* Place of a nominal node in the window, or -1; puts a node (-1: none) in the place of what is there. */
int window_place(const remesher *r, int node);
void window_put(remesher *r, int place, int node);

/* The node of a handle in use, coded as a leaf corner: the nominal node of a moved one. */
int handle_node(const remesher *r, int handle);

/* The handle of a coded node, or -1. */
int handle_of_node(const remesher *r, int node);

double *handle_block(remesher *r, int handle, int other);    /* its ld is SNAPSHOT_LD */
mat3 handle_get(remesher *r, int handle, int other);
void handle_put(remesher *r, int handle, int other, const mat3 *block); /* and its transpose */

/* Between rows and columns given one by one after a start, fetched by the finish. */
void gather_start(remesher *r);
void gather_row(remesher *r, int node);
void gather_column(remesher *r, int node);
trocar_status gather_finish(remesher *r, report *why);

/* A block of the nominal inverse between nominal nodes: one of those gathered, in either order, or else from the owner. Zero where
   that fails: what was made of it is then given up (gathered.status). */
mat3 nominal_block(remesher *r, int node, int other);

#endif
