#include "bench/bench_main.h"

#include <stdlib.h>
#include <string.h>

#include "common/realtime.h"
#include "shared/options.h"

typedef struct {
    const benchmark *benchmarks;
    int count;
    const benchmark *chosen;
    int first;               /* index of the argument that names the benchmark */
} choice;

static const benchmark *find_benchmark(const choice *c, const char *name) {
    for (int i = 0; i < c->count; i++)
        if (strcmp(strchr(c->benchmarks[i].name, ' ') + 1, name) == 0) return &c->benchmarks[i];
    return NULL;
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    choice *c = state->input;
    switch (key) {
    case ARGP_KEY_ARG:
        c->chosen = find_benchmark(c, text);
        if (!c->chosen) argp_error(state, "no benchmark '%s'; --help lists all", text);
        c->first = state->next - 1;
        state->next = state->argc;
        break;
    case ARGP_KEY_NO_ARGS: argp_error(state, "no benchmark given; --help lists all"); break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

int bench_main(int count, char **arguments, const benchmark *benchmarks, int benchmark_count, const char *doc) {
    const struct argp parser = {NULL, parse_option, "BENCHMARK [OPTION...]", doc, NULL, NULL, NULL};
    choice c = {.benchmarks = benchmarks, .count = benchmark_count};
    argp_parse(&parser, count, arguments, ARGP_IN_ORDER, NULL, &c);
    realtime_flush_denormals();   /* as every thread of the server does, so that the times are comparable */

    trocar_error why;
    arguments[c.first] = (char *)c.chosen->name;
    trocar_status status = c.chosen->run(count - c.first, arguments + c.first, &why);
    if (status == TROCAR_OK) return EXIT_SUCCESS;
    fprintf(stderr, "%s: %s\n", c.chosen->name, why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
