/* trocar-bench tick: measures how the time per tick depends on the number of contacts. */
#ifndef TROCAR_BENCH_TICK_H
#define TROCAR_BENCH_TICK_H

#include "base/error.h"

/* Parses the options, runs the measurement, prints a table and, if asked to, writes JSON. Returns BAD_INPUT if the scene is bad, or if the mesh gives the
   needle too few contacts. If an option is invalid, argp exits. */
trocar_status bench_tick(int count, char **arguments, trocar_error *why);

#endif
