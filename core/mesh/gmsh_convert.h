/* Reads formats that msh_reader does not support, with Gmsh, which is loaded when needed. */
#ifndef TROCAR_GMSH_CONVERT_H
#define TROCAR_GMSH_CONVERT_H

#include "base/error.h"

/* Has Gmsh convert `path` to a temporary MSH 4.1 file, which is opened and then unlinked. Returns NULL, with the status in *status, if Gmsh is not
   installed or cannot read the file (BAD_INPUT), or if Gmsh cannot start or the temporary file cannot be written (SYSTEM). A process has only one Gmsh
   session, so threads take turns; if the host program uses Gmsh itself, its session is preserved. */
FILE *gmsh_convert(const char *path, trocar_status *status, trocar_error *why);

#endif
