/* Gmsh's global session, of which a process has one: used by one thread at a time, without disturbing a host program that uses Gmsh itself. */
#ifndef TROCAR_GMSH_SESSION_H
#define TROCAR_GMSH_SESSION_H

#include "base/report.h"

/* Runs `work` in a session. `work` must add a model, which becomes the current one. In a host's session the model is removed afterwards, and the
   host's model and options are restored. Returns the status of `work`; SYSTEM if Gmsh cannot start, with `name` in the message. */
trocar_status gmsh_session_run(const char *name, trocar_status (*work)(void *context), void *context, report *why);

#endif
