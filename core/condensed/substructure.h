/* The factor of a region's stiffness after the elimination of all other nodes: L_RR L_RR^T = K_RR - K_RI K_II^-1 K_IR (Schur complement). The method is
   multifrontal (Duff and Reid, ACM TOMS 9, 1983; Liu, SIAM Review 34, 1992). It uses CHOLMOD's order and supernodes for the graph of the nodes rather than
   of the dofs, so that CHOLMOD's 32-bit indices suffice for 250 000 nodes. Columns of the factor outside the region are freed as soon as they have been
   applied. Their contribution to the region is subtracted immediately, instead of being passed from front to front. */
#ifndef TROCAR_SUBSTRUCTURE_H
#define TROCAR_SUBSTRUCTURE_H

#include "inverse/inverse.h"
#include "linalg/panels.h"

typedef struct {
    tissue *tissue;
    team *team;              /* shares the work; NULL if the calling thread works alone */
    cholmod_factor *symbolic; /* symbolic factor of the nodes' graph */
    int nodes;               /* free nodes */
    int region_count;        /* number of the region's nodes */
    int *region;             /* for each position in the order: index of the node in the region, or -1 */
    bool *filled;            /* for each block of the region's triangle: true if it has entries, see `panels` */
    int *first_child, *next; /* tree of the fronts by supernode: first child, and next sibling in the order of decreasing memory; -1 if there is none */
    int *sequence;           /* fronts in the order of their elimination */
    double bytes;            /* peak memory of the elimination, including fronts, the region's triangle, its scratch, and K in the order of elimination */
    double operations;
} substructure;

/* Determines the order of elimination and its cost for this team. K must be assembled. Writes the region's free nodes in the order of the triangle to `nodes`.
   NO_MEMORY; BAD_INPUT if the mesh is too large for CHOLMOD's indices. */
trocar_status substructure_plan(tissue *t, team *team, int count, const int *region, int *nodes, substructure *s, trocar_error *why);
void substructure_free(substructure *s);

/* Computes `corner`, L_RR, bitwise identical for any team. BLAS must use one thread. NO_MEMORY; BAD_INPUT if the fixed nodes do not constrain the body. */
trocar_status substructure_eliminate(const substructure *s, panels *corner, inverse_progress progress, trocar_error *why);

#endif
