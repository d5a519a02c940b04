/* bench_parts scale: measures tick and worker on meshes of every size, with every kind of inverse. It cannot be part of trocar-bench, because it uses
   library internals (see scale_timing.h). */
#ifndef TROCAR_BENCH_SCALE_H
#define TROCAR_BENCH_SCALE_H

#include "base/error.h"

/* Parses the options, measures, prints a table and, if requested, writes JSON. Returns BAD_INPUT for a bad scene. Bad options make argp exit. */
trocar_status bench_scale(int count, char **arguments, trocar_error *why);

#endif
