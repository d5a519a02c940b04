/* trocar-bench remesh: the time of one contact node more or less, by every method. */
#ifndef TROCAR_BENCH_REMESH_H
#define TROCAR_BENCH_REMESH_H

#include "base/report.h"

/* Parses the options, measures, prints a table and writes JSON if asked to. BAD_INPUT for a bad scene; argp ends the
   program at bad options. */
trocar_status bench_remesh(int count, char **arguments, report *why);

#endif
