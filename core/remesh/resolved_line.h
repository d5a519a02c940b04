/* Local compliance, on the worker's side: measures the mesh's resolution along the needle's path and at the contact nodes. */
#ifndef TROCAR_RESOLVED_LINE_H
#define TROCAR_RESOLVED_LINE_H

#include "remesh/remesh_method.h"

/* True if the request contains a line that has not been measured. */
bool lines_are_new(const remesher *r, const remesh_request *request);

/* Keeps only the measured lines that the request contains, and measures up to `most` of its new lines. */
trocar_status resolve_pieces(remesher *r, const remesh_request *request, int most, trocar_error *why);

/* Stores the resolution at the contact node in `slot`. */
void set_resolved(remesher *r, int slot, const resolved_field *resolved);

/* Measures the resolution at the contact node in `slot`, which is next in the order, in the mesh with the earlier nodes. */
trocar_status resolve_contact(remesher *r, int slot, trocar_error *why);

#endif
