/* The main function of a program with several benchmarks. The first argument selects the benchmark, which parses the rest. */
#ifndef TROCAR_BENCH_MAIN_H
#define TROCAR_BENCH_MAIN_H

#include "base/error.h"

typedef struct {
    const char *name;        /* program and benchmark, separated by a space */
    trocar_status (*run)(int count, char **arguments, trocar_error *why); /* arguments[0] is `name` */
} benchmark;

/* Runs the benchmark that the first argument selects and returns the exit status. `doc`: the text of --help, as for argp. */
int bench_main(int count, char **arguments, const benchmark *benchmarks, int benchmark_count, const char *doc);

#endif
