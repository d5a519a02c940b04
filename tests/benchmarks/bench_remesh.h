/* bench_parts remesh: measures the time each method takes to add or remove a contact node. The methods are internal: a simulation uses only one of them, and
   trocar.h cannot time it separately. */
#ifndef TROCAR_BENCH_REMESH_H
#define TROCAR_BENCH_REMESH_H

#include "base/error.h"

/* Parses the options, measures, prints a table and, if requested, writes JSON. Returns BAD_INPUT for a bad scene. Bad options make argp exit. */
trocar_status bench_remesh(int count, char **arguments, trocar_error *why);

#endif
