#include "bench/bench_dose.h"

#include <math.h>
#include <stdlib.h>

#include "bench/baseline.h"
#include "common/timing.h"
#include "shared/json.h"
#include "shared/options.h"
#include "shared/output.h"
#include "trocar.h"

typedef struct {
    const char *json_path;
    int side, seeds;
} options;

typedef struct {
    const options *options;
    trocar_dose_source *source;
    trocar_dose *dose;
    int64_t voxels;
    double *plain;           /* a plain array, one element per voxel, for comparison */
    histogram baseline, pass, add, remove;
    output json_file;
} bench;

/* ---- command line ------------------------------------------------------------------------------------------------ */

enum { OPTION_SIDE = 256, OPTION_SEEDS, OPTION_JSON };

static const struct argp_option option_list[] = {
    {"side", OPTION_SIDE, "N", 0, "Voxels of 1 mm along each side of the grid (default 100)", 0},
    {"seeds", OPTION_SEEDS, "N", 0, "Seeds that are added, and removed again (default 200)", 0},
    {"json", OPTION_JSON, "FILE", 0, "Also write the results as JSON", 0},
    {0},
};

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case OPTION_SIDE: o->side = parse_whole(state, "side", text, 1, 500); break;
    case OPTION_SEEDS: o->seeds = parse_whole(state, "seeds", text, 1, TROCAR_MAX_DOSE_SEEDS); break;
    case OPTION_JSON: o->json_path = text; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Adds seeds to a dose grid one by one, then removes them, and prints the processor time. For comparison, a pass over as much memory: adding a number to a field of doubles "
    "of the same size.", NULL, NULL, NULL};

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static trocar_status prepare(bench *b, trocar_error *why) {
    const options *o = b->options;
    double half = 0.5e-3 * o->side;
    trocar_dose_grid grid = {{-half, -half, -half}, 1e-3, {o->side, o->side, o->side}};
    trocar_status status = o->json_path ? output_open(&b->json_file, o->json_path, why) : TROCAR_OK;
    if (status == TROCAR_OK) status = trocar_dose_source_create("I-125 6711", &b->source, why);
    if (status == TROCAR_OK) status = trocar_dose_create(b->source, &grid, &b->dose, why);
    if (status != TROCAR_OK) return status;
    b->voxels = trocar_dose_point_count(b->dose);
    b->plain = calloc((size_t)b->voxels, sizeof *b->plain);
    return b->plain ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for %lld doubles", (long long)b->voxels);
}

/* Times a pass over an array as large as the dose grid, in CPU time: on a busy machine, adding a seed takes longer than one of the scheduler's time slices, so
   wall-clock time would mislead. */
static void measure_pass(bench *b) {
    for (int repeat = 0; repeat < 100; repeat++) {
        int64_t start = processor_ns();
        for (int64_t i = 0; i < b->voxels; i++) b->plain[i] += 1.0;
        __asm__ volatile("" : : "r"(b->plain) : "memory"); /* keeps the compiler from optimising the loop away */
        if (repeat >= 5) histogram_add(&b->pass, processor_ns() - start);
    }
}

static trocar_dose_seed seed_at(const bench *b, int index) {
    double reach = 0.4e-3 * b->options->side, angle = 2.4 * index;
    return (trocar_dose_seed){{reach * cos(angle), reach * sin(1.7 * angle), reach * sin(angle)}, {0.2 * cos(angle), 0.2 * sin(angle), 1.0}, 0.5};
}

static trocar_status measure(bench *b, trocar_error *why) {
    baseline_measure(&b->baseline);
    measure_pass(b);
    int32_t id = 0;
    for (int i = 0; i < b->options->seeds; i++) {
        trocar_dose_seed seed = seed_at(b, i);
        int64_t start = processor_ns();
        trocar_status status = trocar_dose_add(b->dose, &seed, &id, why);
        histogram_add(&b->add, processor_ns() - start);
        if (status != TROCAR_OK) return status;
    }
    for (int i = 0; i < b->options->seeds; i++) {
        int64_t start = processor_ns();
        trocar_status status = trocar_dose_remove(b->dose, id - i, why);
        histogram_add(&b->remove, processor_ns() - start);
        if (status != TROCAR_OK) return status;
    }
    return TROCAR_OK;
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

static void print_row(const bench *b, const char *what, const histogram *time, FILE *out) {
    fprintf(out, "%-16s %8.2f  %8.2f  %8.2f  %13.2f\n", what, 1e3 * histogram_quantile(time, 0.5), 1e3 * histogram_quantile(time, 0.99), 1e3 * histogram_max(time),
            per_baseline(&b->baseline, time));
}

static void print_table(const bench *b, FILE *out) {
    fprintf(out, "%lld voxels, %d seeds (I-125 6711)\n", (long long)b->voxels, b->options->seeds);
    fprintf(out, "baseline: dgemm of order %d, p50 %.1f us, p99 %.1f us\n\n", BASELINE_ORDER, 1e6 * histogram_quantile(&b->baseline, 0.5),
            1e6 * histogram_quantile(&b->baseline, 0.99));
    fprintf(out, "                   p50 ms    p99 ms    max ms   p50/baseline\n");
    print_row(b, "pass over memory", &b->pass, out);
    print_row(b, "add a seed", &b->add, out);
    print_row(b, "remove a seed", &b->remove, out);
}

static void json_row(json *j, const bench *b, const char *name, const histogram *time) {
    json_line(j), json_open(j, name, '{');
    json_time(j, time);
    json_number(j, "p50_per_baseline", per_baseline(&b->baseline, time));
    json_close(j, '}');
}

static void write_json(const bench *b, FILE *out) {
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_line(&j), json_text(&j, "benchmark", "dose");
    json_line(&j), json_integer(&j, "voxels", b->voxels);
    json_line(&j), json_integer(&j, "seeds", b->options->seeds);
    json_row(&j, b, "baseline", &b->baseline);
    json_row(&j, b, "pass", &b->pass);
    json_row(&j, b, "add", &b->add);
    json_row(&j, b, "remove", &b->remove);
    json_close(&j, '}');
    fputc('\n', out);
}

trocar_status bench_dose(int count, char **arguments, trocar_error *why) {
    options o = {.side = 100, .seeds = 200};
    argp_parse(&parser, count, arguments, 0, NULL, &o);

    static bench b;
    b = (bench){.options = &o};
    trocar_status status = prepare(&b, why);
    if (status == TROCAR_OK) status = measure(&b, why);
    if (status == TROCAR_OK) print_table(&b, stdout);
    if (status == TROCAR_OK && o.json_path) write_json(&b, b.json_file.file);
    if (status == TROCAR_OK) status = output_commit(&b.json_file, why);
    trocar_dose_free(b.dose);
    trocar_dose_source_free(b.source);
    free(b.plain);
    output_abandon(&b.json_file);
    return status;
}
