/* The worker's task: maintain the inverse of the refined stiffness matrix at the few nodes that the needle can touch. See docs/mechanics.md, "Node addition"
   and "Remeshing methods". */
#ifndef TROCAR_REMESH_H
#define TROCAR_REMESH_H

#include "inverse/inverse.h"
#include "snapshot/snapshot.h"

typedef struct remesher remesher;

/* Creates a remesher that uses nested addition. Rows are computed only at the handles, regardless of the size of the mesh. `inv` must outlive the remesher. */
trocar_status remesher_create(inverse *inv, remesher **created, trocar_error *why);
void remesher_free(remesher *r);

/* Changes the refined mesh to the wanted one (removals first, then the new nodes in order) and fills the snapshot, including those lines of the needle
   that have been measured so far. A removal costs one update of the inverse, plus the updates for the nodes that depend on the removed one
   (refinement_hangs_on) or, with the implicit method or moved nodes, for all nodes added later. Worker only; does not allocate memory. */
trocar_status remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);

/* Measures up to `most` new lines of the last served request, in their order, and fills the snapshot again. Measuring the mesh's resolution takes a
   millisecond per element and is therefore separate from the rows. */
trocar_status remesher_measure(remesher *r, const remesh_request *request, int most, compliance_snapshot *snapshot, trocar_error *why);
bool remesher_must_measure(const remesher *r, const remesh_request *request); /* true if the request contains new lines */

/* Serves the request and measures all its lines. The answer depends only on the request. */
trocar_status remesher_answer(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);

/* Prefetches blocks from the owner of the inverse along the line of the last served request: a few nodes per call, the nearest ones first. Returns false
   if nothing is left to prefetch. For idle time; does not change any answer. */
bool remesher_look_ahead(remesher *r);

/* Restarts after the inverse has changed. Measured lines are kept. */
trocar_status remesher_forget(remesher *r, trocar_error *why);

/* Restores the state immediately after `request` was answered with `snapshot`; starts empty if the snapshot answers another request. After the removal of a
   node on a face that was not the last one, the compliances differ by rounding errors; otherwise they are bitwise identical. */
trocar_status remesher_resume(remesher *r, const remesh_request *request, const compliance_snapshot *snapshot, trocar_error *why);

#endif
