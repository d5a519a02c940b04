/* Free displacement: how far the handles would be displaced without the requesting needle's own forces. See docs/mechanics.md, "Several needles". */
#ifndef TROCAR_FREE_DISPLACEMENT_H
#define TROCAR_FREE_DISPLACEMENT_H

#include "inverse/inverse.h"
#include "snapshot/snapshot.h"

/* Sets u_free of a snapshot that answers `request` to the nominal mesh's displacement under `others`. `inv` must include all attachments. The displacement of a
   contact node is interpolated in its nominal element; this is exact unless a load acts on an added node in the same element. Worker only; does not allocate
   memory. */
trocar_status free_displacement_find(inverse *inv, const remesh_request *request, const other_loads *others, compliance_snapshot *snapshot, trocar_error *why);

/* The handles' displacements under the residual loads, per relaxation term, for u_residual. Computed once per request. */
typedef struct {
    bool any;                /* some displacement is not zero */
    double time;             /* s, residual_loads.time of the request */
    vec3 u[MAX_RELAXATION][MAX_HANDLES]; /* m */
} residual_field;
trocar_status residual_displacement_find(inverse *inv, const remesh_request *request, const int window[MAX_WINDOW], residual_field *residual,
                                         trocar_error *why);

/* Adds the displacements (m) of these nodes due to nodal forces. */
trocar_status nodal_displacement_add(inverse *inv, const nodal_forces *loads, int count, const int *nodes, vec3 *displacement, trocar_error *why);

/* Converts the loads of other needles and of the probe to nodal forces, without duplicate nodes. Returns how many nodes there are; there can be at most
   loads_most_nodes(). */
int loads_most_nodes(const other_loads *others);
int loads_on_nodes(const mesh *m, const other_loads *others, int *nodes, vec3 *forces);

/* Adds the loads to the nodal forces `nominal` (N, node_count entries). */
void loads_spread(const mesh *m, const tissue_loads *loads, vec3 *nominal);

#endif
