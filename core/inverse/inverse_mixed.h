/* A mixture of two inverses for the same mesh, (1 - weight) K0^-1 + weight K1^-1, used while moduli change during a run. It is positive definite for every
   weight from 0 to 1. Not thread-safe. */
#ifndef TROCAR_INVERSE_MIXED_H
#define TROCAR_INVERSE_MIXED_H

#include "inverse/inverse.h"

/* Creates a mixture equal to `first`. NO_MEMORY. */
trocar_status inverse_create_mixed(inverse *first, inverse **created, trocar_error *why);

/* Changes the mixture; both inverses must stay valid while it is in use. Because compliances are mixed linearly, so is 1 / E in the mixture's tissue. A contact
   node makes an element of the mesh softer; with these moduli, it never makes it softer than is consistent with the mixture. RT */
void inverse_mix(inverse *mixed, inverse *first, inverse *second, double weight);

#endif
