/* Reads formats other than this project's own with Gmsh, which is loaded when it is needed. */
#ifndef TROCAR_GMSH_CONVERT_H
#define TROCAR_GMSH_CONVERT_H

#include "base/error.h"

/* Lets Gmsh read `path` and write it as a temporary MSH 4.1 file, which is opened and whose name is then removed. Returns NULL, with the status in
   *status, if Gmsh is not installed or cannot read the file (BAD_INPUT), or if Gmsh cannot start or the temporary file cannot be written (SYSTEM). A
   process has only one Gmsh session, so one thread at a time uses it; the session of a host program that uses Gmsh itself is preserved. */
FILE *gmsh_convert(const char *path, trocar_status *status, trocar_error *why);

#endif
