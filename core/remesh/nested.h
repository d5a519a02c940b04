/* State of nested addition, for remesh_nested.c and nested_removal.c only. Notation as in remesh_nested.c. */
#ifndef TROCAR_NESTED_H
#define TROCAR_NESTED_H

#include "remesh/remesh_method.h"

enum { REACHED = 12 }; /* nominal nodes that an addition can reach: of two elements, and of those beside them */

typedef struct {
    bool on_face;                         /* the surplus couples to the old nodes */
    double weights[4];                    /* nominal weights: what the node owes to the nominal nodes of its element */
    double hats[MAX_CONTACTS];            /* s_j at the node: 1 of itself, 0 of later ones */
    int nominal_count, nominal[REACHED];  /* nominal nodes that the coupling reaches through the nodes that it touches, */
    mat3 coupling[REACHED];               /* and c_j there, N/m */
    mat3 chain[MAX_CONTACTS];             /* G_ij = S_i sum_touched F_i^T c_j, i < j */
    mat3 surplus;                         /* S_j, m/N */
} bordering;

typedef struct {
    remesher shared;
    bordering borders[MAX_CONTACTS];
    mat3 factors[MAX_HANDLES][MAX_CONTACTS]; /* F_j of each handle in use, m/N times N/m; on faces only */
} nested_remesher;

/* Exchanges the node in `slot`, no longer in the order, with those from `position` on in it, so that it can be removed as the last one:
   changes factors, chains and surpluses. */
void nested_move_to_end(nested_remesher *r, int slot, int position);

#endif
