/* trocar-bench features: measures how much a tick slows down with relaxation, a guide and a turning needle. */
#ifndef TROCAR_BENCH_FEATURES_H
#define TROCAR_BENCH_FEATURES_H

#include "base/error.h"

/* Parses the options, runs the measurement, prints a table and, if requested, writes JSON. BAD_INPUT for a bad scene, a scene that already has
   relaxation or guides, and a mesh in which the needle gets too few contacts; argp exits on bad options. */
trocar_status bench_features(int count, char **arguments, trocar_error *why);

#endif
