/* The worker's task: maintain the inverse of the refined stiffness matrix at the few nodes that the needle can touch. See docs/mechanics.md, "Node addition"
   and "Remeshing methods". */
#ifndef TROCAR_REMESH_H
#define TROCAR_REMESH_H

#include "inverse/inverse.h"
#include "snapshot/snapshot.h"

/* Methods to update the inverse when the mesh changes. Both form rows at the handles only, whatever the mesh's size, and support every kind of contact node,
   except that nested does not support moved nodes. */
typedef enum {
    REMESH_NESTED,           /* bordered rank-3 form */
    REMESH_IMPLICIT,         /* low-rank factors of the touched nodes, never multiplied out */
    REMESH_METHODS,
} remesh_method;

typedef struct remesher remesher;

const char *remesh_name(remesh_method method);

/* `inv` must outlive the remesher. */
trocar_status remesher_create(inverse *inv, remesh_method method, remesher **created, report *why);
void remesher_free(remesher *r);

/* Updates the refined mesh to the wanted one, first the removals, then the new nodes in order, and fills the snapshot, with the needle's lines that have been
   measured so far. A removal costs one update of the inverse, plus those of the nodes that depend on the removed one (refinement_hangs_on); with the implicit
   method, and with moved nodes, plus those of all nodes added later. Worker only; allocates nothing. */
trocar_status remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, report *why);

/* Measures at most `most` new lines of the last served request, in their order, and fills the snapshot again. Measuring the mesh's resolution takes a
   millisecond per element, so it is separate from the rows. */
trocar_status remesher_measure(remesher *r, const remesh_request *request, int most, compliance_snapshot *snapshot, report *why);
bool remesher_must_measure(const remesher *r, const remesh_request *request); /* true if there are new lines */

/* Serves the request and measures all its lines. The answer depends on the request alone. */
trocar_status remesher_answer(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, report *why);

/* Prefetches from the owner of the inverse along the line of the last served request, one slice per call, nearest first. Returns false if nothing is left to
   do. For idle time; changes no answer. */
bool remesher_look_ahead(remesher *r);

/* Restarts after a change of the inverse. Measured lines are kept. */
trocar_status remesher_forget(remesher *r, report *why);

/* Restores the state directly after `request` was answered with `snapshot`; starts empty if the snapshot answers another request. Exact to the bit or to
   rounding: see trocar_sim_restore; after the removal of a node on a face that was not the last one, to rounding. */
trocar_status remesher_resume(remesher *r, const remesh_request *request, const compliance_snapshot *snapshot, report *why);

#endif
