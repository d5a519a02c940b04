/* bench_parts scale: measures on meshes of every size, with every kind of inverse. Internal, because it uses scale_timing.h. */
#ifndef TROCAR_BENCH_SCALE_H
#define TROCAR_BENCH_SCALE_H

#include "base/report.h"

/* Parses the options, measures, prints a table and, if asked to, writes JSON. BAD_INPUT for a bad scene; argp exits
   on bad options. */
trocar_status bench_scale(int count, char **arguments, report *why);

#endif
