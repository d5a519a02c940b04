/* trocar-bench: times parts of the simulation. One benchmark per name, each with its own options. */
#include <stdlib.h>
#include <string.h>

#include "bench_remesh.h"
#include "bench_scale.h"
#include "bench_tick.h"
#include "options.h"
#include "realtime.h"

const char *argp_program_version = "trocar-bench " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

typedef struct {
    const char *name;
    trocar_status (*run)(int count, char **arguments, report *why); /* arguments[0]: name of program and benchmark */
} benchmark;

static const benchmark benchmarks[] = {
    {"trocar-bench tick", bench_tick},
    {"trocar-bench remesh", bench_remesh},
    {"trocar-bench scale", bench_scale},
};

typedef struct {
    const benchmark *benchmark;
    int first;               /* argument with its name */
} choice;

static const benchmark *find_benchmark(const char *name) {
    for (size_t i = 0; i < sizeof benchmarks / sizeof *benchmarks; i++)
        if (strcmp(strchr(benchmarks[i].name, ' ') + 1, name) == 0) return &benchmarks[i];
    return NULL;
}

/* The first argument names the benchmark, which parses the rest. */
static error_t parse_option(int key, char *text, struct argp_state *state) {
    choice *chosen = state->input;
    switch (key) {
    case ARGP_KEY_ARG:
        chosen->benchmark = find_benchmark(text);
        if (!chosen->benchmark) argp_error(state, "no benchmark '%s'; --help lists all", text);
        chosen->first = state->next - 1;
        state->next = state->argc;
        break;
    case ARGP_KEY_NO_ARGS: argp_error(state, "no benchmark given; --help lists all"); break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    NULL, parse_option, "BENCHMARK [OPTION...]",
    "Times parts of the simulation relative to a matrix product, so that machines can be compared by ratios."
    "\vBenchmarks ('trocar-bench BENCHMARK --help' shows the options of one):\n\n"
    "  tick    a tick of the haptic loop against the number of contacts\n"
    "  remesh  adding or removing a contact node against the size of the mesh and the node's valence, by every method\n"
    "  scale   an insertion against the size of the mesh, for each owner of the inverse", NULL, NULL, NULL};

int main(int count, char **arguments) {
    choice chosen = {0};
    argp_parse(&parser, count, arguments, ARGP_IN_ORDER, NULL, &chosen);
    realtime_flush_denormals();   /* as every thread of the server does */

    report why;
    arguments[chosen.first] = (char *)chosen.benchmark->name;
    trocar_status status = chosen.benchmark->run(count - chosen.first, arguments + chosen.first, &why);
    if (status == TROCAR_OK) return EXIT_SUCCESS;
    fprintf(stderr, "%s: %s\n", chosen.benchmark->name, why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
