/* Main function of a program with several benchmarks: the first argument selects the benchmark, which parses the remaining arguments. */
#ifndef TROCAR_BENCH_MAIN_H
#define TROCAR_BENCH_MAIN_H

#include "base/error.h"

typedef struct {
    const char *name;        /* names of the program and the benchmark, separated by a space */
    trocar_status (*run)(int count, char **arguments, trocar_error *why); /* arguments[0] is `name` */
} benchmark;

/* Runs the benchmark selected by the arguments; `doc` is the text of --help, as in argp. Returns the exit status. */
int bench_main(int count, char **arguments, const benchmark *benchmarks, int benchmark_count, const char *doc);

#endif
