/* Free displacement: where the tissue at the handles would be if the needle that asks exerted no force. See docs/mechanics.md, "Several
   needles". */
#ifndef TROCAR_FREE_DISPLACEMENT_H
#define TROCAR_FREE_DISPLACEMENT_H

#include "inverse/inverse.h"
#include "snapshot/snapshot.h"

/* Fills u_free of a snapshot that answers `request`: the displacement that `others` cause in the nominal mesh. `inv`: with all
   that is attached. A contact node's is
   interpolated from its nominal element, which is exact as long as no load acts on an added node of the same element. Worker's
   side; allocates nothing. */
trocar_status free_displacement_find(inverse *inv, const remesh_request *request, const other_loads *others, compliance_snapshot *snapshot, report *why);

/* The same for u_left, which a remesher finds once for each request: the displacement that each term of its left loads causes. */
typedef struct {
    bool any;                /* of these is not zero */
    double time;             /* s, left_loads.time of the request */
    vec3 u[MAX_RELAXATION][MAX_HANDLES]; /* m */
} left_field;
trocar_status left_displacement_find(inverse *inv, const remesh_request *request, const int window[MAX_WINDOW], left_field *left, report *why);

/* Adds the displacements of these nodes (m) that forces on nodes cause. */
trocar_status nodal_displacement_add(inverse *inv, const nodal_forces *loads, int count, const int *nodes, vec3 *displacement, report *why);

/* The loads of other needles and of the probe as forces on nodes, each node once. Returns the number of nodes, at most loads_most_nodes. */
int loads_most_nodes(const other_loads *others);
int loads_on_nodes(const mesh *m, const other_loads *others, int *nodes, vec3 *forces);

/* Adds the loads to nodal forces (node_count), N. */
void loads_spread(const mesh *m, const tissue_loads *loads, vec3 *nominal);

#endif
