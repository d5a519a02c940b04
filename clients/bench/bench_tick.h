/* trocar-bench tick: measures the time per tick as a function of the number of contacts. */
#ifndef TROCAR_BENCH_TICK_H
#define TROCAR_BENCH_TICK_H

#include "base/error.h"

/* Parses the options, runs the measurement, prints a table and, if requested, writes JSON. BAD_INPUT for a bad scene, or a mesh in which the needle
   gets too few contacts; argp exits on bad options. */
trocar_status bench_tick(int count, char **arguments, trocar_error *why);

#endif
