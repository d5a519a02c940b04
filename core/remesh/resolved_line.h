/* The worker's part of the local compliance: what the mesh resolves of the needle, along its way and at its contact nodes. */
#ifndef TROCAR_RESOLVED_LINE_H
#define TROCAR_RESOLVED_LINE_H

#include "remesh/remesh_method.h"

/* Is there a line in the request that has not been measured? */
bool lines_are_new(const remesher *r, const remesh_request *request);

/* Brings the pieces up to date with a request: measures those that are new, at most so many. */
trocar_status resolve_pieces(remesher *r, const remesh_request *request, int most, report *why);

/* At the contact node in `slot`, which comes next in the order, with those before it in the mesh. */
trocar_status resolve_contact(remesher *r, int slot, report *why);

#endif
