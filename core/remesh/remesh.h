/* The worker's job: keep the inverse of the refined stiffness matrix at the few nodes that the needle can touch.
   See docs/mechanics.md, "Node addition" and "Remeshing methods". */
#ifndef TROCAR_REMESH_H
#define TROCAR_REMESH_H

#include "inverse/inverse.h"
#include "snapshot/snapshot.h"

/* How the inverse follows the changes of the mesh. Both form rows at the handles only, whatever the mesh's size, and take every kind of contact
   node, but for nested, which moves none. */
typedef enum {
    REMESH_NESTED,           /* bordered rank-3 form */
    REMESH_IMPLICIT,         /* low-rank factors of the nodes touched, never multiplied out */
    REMESH_METHODS,
} remesh_method;

typedef struct remesher remesher;

const char *remesh_name(remesh_method method);

/* `inv` must outlive it. */
trocar_status remesher_create(inverse *inv, remesh_method method, remesher **created, report *why);
void remesher_free(remesher *r);

/* Brings the refined mesh to what is wanted, first the removals, then the new nodes in order, and fills the snapshot; of the needle's
   lines, with those measured so far. A removal costs one
   update of the inverse and those of the nodes that hang on the removed one (refinement_hangs_on); with the implicit
   method, and where nodes were moved, those of all nodes added after it. Worker's side; allocates nothing. */
trocar_status remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, report *why);

/* What the mesh resolves along the needle's way takes a millisecond per element to measure, and is told apart from the rows: of the request
   served last, measures at most `most` lines that are new, in their order, and fills the snapshot again. */
trocar_status remesher_measure(remesher *r, const remesh_request *request, int most, compliance_snapshot *snapshot, report *why);
bool remesher_must_measure(const remesher *r, const remesh_request *request); /* are there new lines? */

/* Both. The answer depends on the request alone. */
trocar_status remesher_answer(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, report *why);

/* Prepares what the owner of the inverse will need further along the line of the last request served, one slice at a
   time, nearest first. False: nothing is left to do. For idle time; does not change any answer. */
bool remesher_look_ahead(remesher *r);

/* Starts anew: the inverse has changed. Lines that were measured stay. */
trocar_status remesher_forget(remesher *r, report *why);

/* Goes back to where it had just answered `request` with `snapshot`, as if nothing had been served since; starts empty where
   the snapshot answers another request. To the bit or to rounding: see simulation_restore; after the removal of a node on a face from
   among others, to rounding. */
trocar_status remesher_resume(remesher *r, const remesh_request *request, const compliance_snapshot *snapshot, report *why);

#endif
