/* Free displacement: the displacement of the tissue at the handles without the forces of the requesting needle. See docs/mechanics.md, "Several needles". */
#ifndef TROCAR_FREE_DISPLACEMENT_H
#define TROCAR_FREE_DISPLACEMENT_H

#include "inverse/inverse.h"
#include "snapshot/snapshot.h"

/* Fills u_free of a snapshot that answers `request` with the displacement of the nominal mesh caused by `others`. `inv` must include all attachments. The
   displacement of a contact node is interpolated in its nominal element, which is exact as long as no load acts on an added node in the same element.
   Worker only; does not allocate memory. */
trocar_status free_displacement_find(inverse *inv, const remesh_request *request, const other_loads *others, compliance_snapshot *snapshot, trocar_error *why);

/* Displacement of the handles under the residual loads of each term, for u_residual. A remesher computes it once per request. */
typedef struct {
    bool any;                /* true if any displacement is not zero */
    double time;             /* s, residual_loads.time of the request */
    vec3 u[MAX_RELAXATION][MAX_HANDLES]; /* m */
} residual_field;
trocar_status residual_displacement_find(inverse *inv, const remesh_request *request, const int window[MAX_WINDOW], residual_field *residual,
                                         trocar_error *why);

/* Adds the displacements (m) of these nodes caused by forces on nodes. */
trocar_status nodal_displacement_add(inverse *inv, const nodal_forces *loads, int count, const int *nodes, vec3 *displacement, trocar_error *why);

/* Converts the loads of other needles and of the probe to forces on nodes, without duplicate nodes. Returns the number of nodes, at most loads_most_nodes(). */
int loads_most_nodes(const other_loads *others);
int loads_on_nodes(const mesh *m, const other_loads *others, int *nodes, vec3 *forces);

/* Adds the loads to the nodal forces `nominal` (node_count, N). */
void loads_spread(const mesh *m, const tissue_loads *loads, vec3 *nominal);

#endif
