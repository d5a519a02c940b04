/* trocar-bench dose: measures how long it takes to add a seed to a dose grid. */
#ifndef TROCAR_BENCH_DOSE_H
#define TROCAR_BENCH_DOSE_H

#include "base/error.h"

/* Parses the options, runs the measurement, prints a table and, if asked to, writes JSON. Returns BAD_INPUT or SYSTEM if a file cannot be written. If an option
   is invalid, argp exits. */
trocar_status bench_dose(int count, char **arguments, trocar_error *why);

#endif
