/* trocar-bench features: measures how much slower a tick is with relaxation, a guide and a turning needle. */
#ifndef TROCAR_BENCH_FEATURES_H
#define TROCAR_BENCH_FEATURES_H

#include "base/error.h"

/* Parses the options, runs the measurement, prints a table and, if asked to, writes JSON. Returns BAD_INPUT if the scene is bad or already has relaxation or
   guides, or if the mesh gives the needle too few contacts. If an option is invalid, argp exits. */
trocar_status bench_features(int count, char **arguments, trocar_error *why);

#endif
