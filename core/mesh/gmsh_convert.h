/* Uses Gmsh, loaded on demand, to read formats that msh_reader does not support. */
#ifndef TROCAR_GMSH_CONVERT_H
#define TROCAR_GMSH_CONVERT_H

#include "base/error.h"

/* Has Gmsh convert `path` to a temporary MSH 4.1 file, and returns that file, open but already unlinked. On failure, returns NULL and sets *status: BAD_INPUT
   if Gmsh is not installed or cannot read the file, SYSTEM if Gmsh cannot start or the temporary file cannot be written. A process has only one Gmsh session,
   so threads take turns; a session of the host's own is preserved. */
FILE *gmsh_convert(const char *path, trocar_status *status, trocar_error *why);

#endif
