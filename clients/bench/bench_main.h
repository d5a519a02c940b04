/* Main function of a program with several benchmarks: the first argument names one, which parses the rest. */
#ifndef TROCAR_BENCH_MAIN_H
#define TROCAR_BENCH_MAIN_H

#include "base/report.h"

typedef struct {
    const char *name;        /* of the program and the benchmark, with a space in between */
    trocar_status (*run)(int count, char **arguments, report *why); /* arguments[0]: the name */
} benchmark;

/* `doc`: text of --help, as in argp. Returns the exit status. */
int bench_main(int count, char **arguments, const benchmark *benchmarks, int benchmark_count, const char *doc);

#endif
