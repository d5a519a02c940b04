/* What the worker does for a needle: maintain the inverse of the refined stiffness matrix at the few nodes that the needle can touch. See docs/mechanics.md,
   "Node addition" and "Remeshing methods". */
#ifndef TROCAR_REMESH_H
#define TROCAR_REMESH_H

#include "inverse/inverse.h"
#include "snapshot/snapshot.h"

typedef struct remesher remesher;

/* Creates a remesher that uses nested addition. It computes rows only at the handles, however large the mesh is. `inv` must outlive it. */
trocar_status remesher_create(inverse *inv, remesher **created, trocar_error *why);
void remesher_free(remesher *r);

/* Changes the refined mesh to the wanted one, first removing nodes, then adding new ones in order. Fills the snapshot, including whatever lines along the
   needle have been measured so far. Removing a node costs one update of the inverse, plus one for each node that depends on it (refinement_hangs_on) or, with
   the implicit method or moved nodes, for every node added later. Worker only; does not allocate memory. */
trocar_status remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);

/* Measures up to `most` new lines of the last served request, in the request's order, and fills the snapshot again. This is separate from remesher_serve
   because measuring the mesh's resolution takes a millisecond per element. */
trocar_status remesher_measure(remesher *r, const remesh_request *request, int most, compliance_snapshot *snapshot, trocar_error *why);
bool remesher_must_measure(const remesher *r, const remesh_request *request); /* whether the request contains lines not measured yet */

/* Serves the request and measures all its lines, so that the answer depends only on the request. */
trocar_status remesher_answer(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);

/* Prefetches blocks from the owner of the inverse for nodes along the line of the last served request. Each call fetches a few nodes, nearest first. Returns
   false if nothing is left to prefetch. For idle time; never changes an answer. */
bool remesher_look_ahead(remesher *r);

/* Starts over after the inverse has changed. Keeps the lines measured so far. */
trocar_status remesher_forget(remesher *r, trocar_error *why);

/* Restores the state just after `request` was answered with `snapshot`. If the snapshot answers another request, starts empty. The compliances are bitwise the
   same as then, or differ by rounding errors if a node on a face had been removed that was not the last node. */
trocar_status remesher_resume(remesher *r, const remesh_request *request, const compliance_snapshot *snapshot, trocar_error *why);

#endif
