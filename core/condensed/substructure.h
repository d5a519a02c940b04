/* Eliminates all nodes outside a region and factorises the remaining stiffness (Schur complement): L_RR L_RR^T = K_RR - K_RI K_II^-1 K_IR. The method is
   multifrontal (Duff and Reid, ACM TOMS 9, 1983; Liu, SIAM Review 34, 1992). CHOLMOD's ordering and supernodes are computed for the graph of nodes rather
   than dofs, so that 32-bit indices are enough for 250 000 nodes. To save memory, columns of the factor outside the region are freed as soon as they have
   been applied: their contribution to the region is subtracted at once, instead of being passed from front to front. */
#ifndef TROCAR_SUBSTRUCTURE_H
#define TROCAR_SUBSTRUCTURE_H

#include "inverse/inverse.h"
#include "linalg/panels.h"

typedef struct {
    tissue *tissue;
    team *team;              /* threads that share the work; NULL if the calling thread works alone */
    cholmod_factor *symbolic; /* symbolic factor of the graph of nodes */
    int nodes;               /* number of free nodes */
    int region_count;        /* number of free nodes in the region */
    int *region;             /* for each position in the elimination order: the node's index in the region's triangle, or -1 */
    bool *filled;            /* for each block of the region's triangle: true if it has entries; see `panels` */
    int *first_child, *next; /* tree of fronts, indexed by supernode: first child, and next sibling in elimination order; -1 if there is none */
    int *sequence;           /* fronts in elimination order */
    double bytes;            /* peak memory of the elimination: fronts, the region's triangle, scratch, and K in elimination order */
    double operations;
} substructure;

/* Plans the elimination: finds the order, and estimates the cost with this team. K must be assembled. Writes the region's free nodes to `nodes`, in the row
   order of the triangle. NO_MEMORY; BAD_INPUT if the mesh is too large for CHOLMOD's indices. */
trocar_status substructure_plan(tissue *t, team *team, int count, const int *region, int *nodes, substructure *s, trocar_error *why);
void substructure_free(substructure *s);

/* Computes `corner` = L_RR. The result is bitwise identical for any team. BLAS must use one thread. NO_MEMORY; BAD_INPUT if the fixed nodes do not constrain
   the body. */
trocar_status substructure_eliminate(const substructure *s, panels *corner, inverse_progress progress, trocar_error *why);

#endif
