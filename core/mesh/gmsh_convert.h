/* Formats other than this project's own, by way of Gmsh, which is loaded when it is needed. */
#ifndef TROCAR_GMSH_CONVERT_H
#define TROCAR_GMSH_CONVERT_H

#include "base/report.h"

/* Lets Gmsh read `path` and write it as a temporary MSH 4.1 file, opens that and removes its name. NULL and the status in *status: BAD_INPUT if Gmsh is
   not installed or cannot read the file, SYSTEM if it cannot start or the temporary file cannot be written. Gmsh's session, of which a process has one, is
   used by one thread at a time; that of a host program that uses Gmsh itself is preserved. */
FILE *gmsh_convert(const char *path, trocar_status *status, report *why);

#endif
