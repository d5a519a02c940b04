#include "bench_remesh.h"

#include <cblas.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bench/baseline.h"
#include "model/model_parts.h"
#include "oracles/dense_matrix.h"
#include "remesh_timing.h"
#include "scene/scene.h"
#include "shared/json.h"
#include "shared/options.h"
#include "shared/output.h"

enum { MAX_SCENES = 16, MAX_ROWS_OF_SCENE = REMESH_METHODS * (REMESH_CHANGES + MAX_PATCH), SWEEPS = 20 };

typedef struct {
    const char *scene_paths[MAX_SCENES], *json_path;
    int scene_count, samples, contacts, touched;
    double seconds;
    bool valences;
} options;

typedef struct {
    remesh_case given;
    remesh_timing time;
} row;

typedef struct {
    int nodes, tetrahedra, unknowns;
    const char *inverse;
    histogram sweep;         /* time to read and write one triangle of the inverse, column by column; empty if the inverse is not dense */
    int row_count;
    row rows[MAX_ROWS_OF_SCENE];
} scene_result;

typedef struct {
    options *options;
    histogram baseline;
    scene_result *scenes;    /* scene_count */
    output json_file;
} bench;

/* ---- command line ------------------------------------------------------------------------------------------------ */

enum { OPTION_SAMPLES = 256, OPTION_SECONDS, OPTION_CONTACTS, OPTION_TOUCHED, OPTION_VALENCES, OPTION_JSON };

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene (at least one): its mesh, regions and inverse are used; repeat for several", 0},
    {"samples", OPTION_SAMPLES, "N", 0, "Nodes added and removed for each row (default 200)", 0},
    {"seconds", OPTION_SECONDS, "S", 0, "Time limit for a row; at least three nodes are measured (default 3)", 0},
    {"contacts", OPTION_CONTACTS, "N", 0, "Contact nodes present beforehand (default 10)", 0},
    {"touched", OPTION_TOUCHED, "N", 0, "Nodes of a moved node's patch (default: the most frequent in the first mesh)", 0},
    {"valences", OPTION_VALENCES, NULL, 0, "In the first mesh, move nodes of every valence", 0},
    {"json", OPTION_JSON, "FILE", 0, "Also write the results as JSON", 0},
    {0},
};

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 's':
        if (o->scene_count == MAX_SCENES) argp_error(state, "--scene: more than %d", MAX_SCENES);
        o->scene_paths[o->scene_count++] = text;
        break;
    case OPTION_SAMPLES: o->samples = (int)parse_number(state, "samples", text, 1, 1e6); break;
    case OPTION_SECONDS: o->seconds = parse_number(state, "seconds", text, 0, 3600); break;
    case OPTION_CONTACTS: o->contacts = (int)parse_number(state, "contacts", text, 0, MAX_CONTACTS - 1); break;
    case OPTION_TOUCHED: o->touched = (int)parse_number(state, "touched", text, 5, MAX_PATCH); break;
    case OPTION_VALENCES: o->valences = true; break;
    case OPTION_JSON: o->json_path = text; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (o->scene_count == 0) argp_error(state, "--scene is missing");
        break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Adds contact nodes to the inverse and removes them again, by every method: nodes added inside an element, nodes added on a "
    "face, and mesh nodes moved. Uses one thread, and volumetric strain by element as in the paper. Methods that need the dense "
    "inverse are left out if the scene uses another one.", NULL, NULL, NULL};

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static trocar_status measure_row(bench *b, inverse *inv, remesh_method method, remesh_change change, int touched, scene_result *result, trocar_error *why) {
    const options *o = b->options;
    if (method == REMESH_NESTED && change == MOVE_NODE) return TROCAR_OK;
    if (remesh_needs_dense(method) && !is_dense(inv)) return TROCAR_OK;
    row *r = &result->rows[result->row_count];
    r->given = (remesh_case){.method = method, .change = change, .touched = touched, .contacts = o->contacts, .samples = o->samples,
                             .seconds = o->seconds};
    trocar_status status = remesh_timing_measure(inv, &r->given, &r->time, why);
    result->row_count += status == TROCAR_OK && r->time.samples > 0;
    return status;
}

/* Measures the time that the memory accesses alone take, a lower bound for the sweeps of the dense methods. */
static void measure_sweep(inverse *inv, histogram *time) {
    size_t n = (size_t)inverse_tissue(inv)->dof_count;
    histogram_clear(time);
    double *numbers = is_dense(inv) ? dense_matrix(inv) : NULL;
    if (!numbers) return;
    for (int i = 0; i < SWEEPS; i++) {
        int64_t start = monotonic_ns();
        for (size_t j = 0; j < n; j++) cblas_dscal((int)(n - j), i % 2 ? 2.0 : 0.5, numbers + j * n + j, 1);
        histogram_add(time, monotonic_ns() - start);
    }
    free(numbers);
}

static int most_frequent(const int counts[MAX_PATCH + 1]) {
    int most = 0;
    for (int i = 1; i <= MAX_PATCH; i++)
        if (counts[i] > counts[most]) most = i;
    return most;
}

static trocar_status measure_rows(bench *b, model_parts *s, bool valences, scene_result *result, trocar_error *why) {
    int counts[MAX_PATCH + 1];
    trocar_status status = TROCAR_OK;
    remesh_timing_valences(&s->tissue, counts);
    if (b->options->touched == 0) b->options->touched = most_frequent(counts);
    for (remesh_method method = 0; method < REMESH_METHODS && status == TROCAR_OK; method++) {
        status = measure_row(b, s->inverse, method, ADD_INSIDE, 0, result, why);
        if (status == TROCAR_OK) status = measure_row(b, s->inverse, method, ADD_ON_FACE, 0, result, why);
        for (int touched = 5; touched <= MAX_PATCH && status == TROCAR_OK; touched++)
            if (counts[touched] > 0 && (valences || touched == b->options->touched))
                status = measure_row(b, s->inverse, method, MOVE_NODE, touched, result, why);
    }
    return status;
}

static trocar_status measure_scene(bench *b, int index, trocar_error *why) {
    static scene given;
    model_parts s;
    scene_result *result = &b->scenes[index];
    trocar_status status = scene_load(b->options->scene_paths[index], &given, why);
    given.simulation.volumetric = STRAIN_BY_ELEMENT;
    if (status == TROCAR_OK) status = model_parts_create(&given.simulation, &s, why);
    if (status != TROCAR_OK) return status;
    result->nodes = s.mesh.node_count;
    result->tetrahedra = s.mesh.tet_count;
    result->unknowns = s.tissue.dof_count;
    result->inverse = inverse_name(s.inverse);
    measure_sweep(s.inverse, &result->sweep);
    status = measure_rows(b, &s, b->options->valences && index == 0, result, why);
    model_parts_free(&s);
    return status;
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

static double micro(const histogram *time, double quantile) { return 1e6 * histogram_quantile(time, quantile); }

static int touched_by(const remesh_case *given) {
    return given->change == ADD_INSIDE ? 5 : given->change == ADD_ON_FACE ? 6 : given->touched;
}

static void print_scene(const bench *b, int index, FILE *out) {
    const scene_result *result = &b->scenes[index];
    fprintf(out, "%s: %d nodes, %d tetrahedra, %d unknowns, %s inverse; %d contact nodes already present\n", b->options->scene_paths[index],
            result->nodes, result->tetrahedra, result->unknowns, result->inverse, b->options->contacts);
    if (result->sweep.count > 0) fprintf(out, "reading and writing one triangle of the inverse: p50 %.0f us\n", micro(&result->sweep, 0.5));
    fprintf(out, "\nmethod            change  nodes   samples    add us: p50       p99       max    remove us: p50\n");
    for (int i = 0; i < result->row_count; i++) {
        const row *r = &result->rows[i];
        fprintf(out, "%-16s  %-6s  %5d  %8d  %13.1f  %8.1f  %8.1f  %16.1f\n", remesh_name(r->given.method), remesh_change_name(r->given.change),
                touched_by(&r->given), r->time.samples, micro(&r->time.add, 0.5), micro(&r->time.add, 0.99), 1e6 * histogram_max(&r->time.add),
                micro(&r->time.remove, 0.5));
    }
    fprintf(out, "\n");
}

static void write_time(json *j, const char *name, const histogram *time) {
    json_open(j, name, '{');
    json_time(j, time);
    json_close(j, '}');
}

static void write_row(json *j, const row *r) {
    json_line(j), json_open(j, NULL, '{');
    json_text(j, "method", remesh_name(r->given.method));
    json_text(j, "change", remesh_change_name(r->given.change));
    json_integer(j, "touched_nodes", touched_by(&r->given));
    json_integer(j, "samples", r->time.samples);
    write_time(j, "add", &r->time.add);
    write_time(j, "remove", &r->time.remove);
    json_close(j, '}');
}

static void write_scene(json *j, const bench *b, int index) {
    const scene_result *result = &b->scenes[index];
    json_line(j), json_open(j, NULL, '{');
    json_text(j, "scene", b->options->scene_paths[index]);
    json_integer(j, "nodes", result->nodes);
    json_integer(j, "tetrahedra", result->tetrahedra);
    json_integer(j, "unknowns", result->unknowns);
    json_text(j, "inverse", result->inverse);
    if (result->sweep.count > 0) write_time(j, "sweep", &result->sweep);
    else json_number(j, "sweep", NAN); /* null */
    json_open(j, "rows", '[');
    for (int i = 0; i < result->row_count; i++) write_row(j, &result->rows[i]);
    json_close(j, ']');
    json_close(j, '}');
}

static void write_json(const bench *b, FILE *out) {
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_line(&j), json_text(&j, "benchmark", "remesh");
    json_line(&j), json_integer(&j, "contacts", b->options->contacts);
    json_line(&j), json_open(&j, "baseline", '{');
    json_integer(&j, "dgemm_order", BASELINE_ORDER);
    json_time(&j, &b->baseline);
    json_close(&j, '}');
    json_line(&j), json_open(&j, "scenes", '[');
    for (int i = 0; i < b->options->scene_count; i++) write_scene(&j, b, i);
    json_close(&j, ']');
    json_close(&j, '}');
    fputc('\n', out);
}

trocar_status bench_remesh(int count, char **arguments, trocar_error *why) {
    options o = {.samples = 200, .contacts = 10, .seconds = 3.0};
    argp_parse(&parser, count, arguments, 0, NULL, &o);

    bench b = {.options = &o, .scenes = calloc((size_t)o.scene_count, sizeof *b.scenes)};
    trocar_status status = b.scenes ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the results");
    if (status == TROCAR_OK && o.json_path) status = output_open(&b.json_file, o.json_path, why);
    if (status == TROCAR_OK) baseline_measure(&b.baseline);
    for (int i = 0; i < o.scene_count && status == TROCAR_OK; i++) {
        status = measure_scene(&b, i, why);
        if (status == TROCAR_OK) print_scene(&b, i, stdout);
        fflush(stdout);
    }
    if (status == TROCAR_OK && o.json_path) write_json(&b, b.json_file.file);
    if (status == TROCAR_OK) status = output_commit(&b.json_file, why);
    output_abandon(&b.json_file);
    free(b.scenes);
    return status;
}
