/* The worker's part of local compliance: measures the mesh's resolution along the needle's path and at the contact nodes. */
#ifndef TROCAR_RESOLVED_LINE_H
#define TROCAR_RESOLVED_LINE_H

#include "remesh/remesh_method.h"

/* Returns whether the request contains a line that has not been measured. */
bool lines_are_new(const remesher *r, const remesh_request *request);

/* Measures up to `most` of the request's new lines, and discards measured lines that the request does not contain. */
trocar_status resolve_pieces(remesher *r, const remesh_request *request, int most, trocar_error *why);

/* Sets the resolution at the contact node in `slot` without measuring it. */
void set_resolved(remesher *r, int slot, const resolved_field *resolved);

/* Measures the resolution at the contact node in `slot`, the next one in order, in the mesh with the earlier nodes. */
trocar_status resolve_contact(remesher *r, int slot, trocar_error *why);

#endif
