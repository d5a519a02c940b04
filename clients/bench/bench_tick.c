#include "bench/bench_tick.h"

#include <stdlib.h>
#include <string.h>

#include "bench/baseline.h"
#include "bench/tick_timing.h"
#include "shared/json.h"
#include "shared/motion.h"
#include "shared/options.h"
#include "shared/output.h"
#include "shared/patient.h"

enum { MAX_COUNTS = TROCAR_MAX_CONTACTS };

typedef struct {
    const char *scene_path, *json_path;
    int counts[MAX_COUNTS], count_count;   /* numbers of contacts for which to measure, and how many of these there are */
    int ticks;
    double spacing;                        /* m, spacing of the contact nodes; if 0, the scene's */
    vec3 start;                            /* m, or mm in patient coordinates; x is NAN to use the scene's start */
    bool patient;
} options;

typedef struct {
    const options *options;
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    double spacing;          /* m, spacing of the contact nodes */
    pose start;              /* pose of the needle's base at the start */
    histogram baseline;
    tick_timing rows[MAX_COUNTS][TIMED_MOTIONS];
    output json_file;
} bench;

/* ---- command line ------------------------------------------------------------------------------------------------ */

enum { OPTION_TICKS = 256, OPTION_JSON, OPTION_SPACING, OPTION_START, OPTION_PATIENT };

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene (required)", 0},
    {"contacts", 'c', "N,...", 0, "Numbers of contacts to measure (default 5,10)", 0},
    {"ticks", OPTION_TICKS, "N", 0, "Ticks timed for each number of contacts and each motion (default 1000)", 0},
    {"spacing", OPTION_SPACING, "METRES", 0, "Smallest distance between contact nodes (default: the scene's)", 0},
    {"start", OPTION_START, "X,Y,Z", 0, "Start of the base, m (default: the scene's needle.start, or 0.005,0.003,-0.201 along +z)", 0},
    {"patient", OPTION_PATIENT, 0, 0, "--start is in the patient's coordinates, mm", 0},
    {"json", OPTION_JSON, "FILE", 0, "Also write the results as JSON", 0},
    {0},
};

static void parse_counts(const struct argp_state *state, const char *text, options *o) {
    double numbers[MAX_COUNTS];
    o->count_count = 1;
    for (const char *c = text; *c; c++) o->count_count += *c == ',';
    if (o->count_count > MAX_COUNTS) argp_error(state, "--contacts: more than %d numbers", MAX_COUNTS);
    parse_numbers(state, "contacts", text, o->count_count, numbers);
    for (int i = 0; i < o->count_count; i++) o->counts[i] = whole_number(state, "contacts", numbers[i], 1, TROCAR_MAX_CONTACTS);
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 's': o->scene_path = text; break;
    case 'c': parse_counts(state, text, o); break;
    case OPTION_TICKS: o->ticks = parse_whole(state, "ticks", text, 1, 1000000); break;
    case OPTION_JSON: o->json_path = text; break;
    case OPTION_SPACING: o->spacing = parse_number(state, "spacing", text, 1e-5, 1); break;
    case OPTION_START: o->start = parse_vector(state, "start", text); break;
    case OPTION_PATIENT: o->patient = true; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (!o->scene_path) argp_error(state, "--scene is missing");
        break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Pushes the needle in until it has a number of contacts, then times each tick while it advances (20 mm/s) and while its "
    "base sweeps from side to side (30 mm/s). Runs in lockstep in one thread; the work of the server's worker is not timed.", NULL, NULL, NULL};

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static trocar_status choose_start(bench *b, trocar_error *why) {
    const options *o = b->options;
    patient_frame patient;
    trocar_status status = o->patient ? patient_frame_read(b->scene, &patient, why) : TROCAR_OK;
    b->start = MOTION_START;
    if (status == TROCAR_OK) find_start(b->scene, o->patient ? &patient : NULL, isnan(o->start.x) ? NULL : &o->start, &b->start);
    return status;
}

static trocar_status prepare(bench *b, trocar_error *why) {
    const options *o = b->options;
    trocar_status status = trocar_scene_load(o->scene_path, &b->scene, why);
    if (status == TROCAR_OK && o->spacing > 0.0) status = trocar_scene_set_number(b->scene, "contact.spacing", o->spacing, why);
    if (status == TROCAR_OK) status = trocar_scene_get_number(b->scene, "contact.spacing", &b->spacing, why);
    if (status == TROCAR_OK) status = choose_start(b, why);
    if (status == TROCAR_OK && o->json_path) status = output_open(&b->json_file, o->json_path, why);
    if (status == TROCAR_OK) status = trocar_model_create(b->scene, NULL, &b->model, why);
    return status == TROCAR_OK ? trocar_sim_create(b->model, &b->sim, why) : status;
}

static trocar_status measure(bench *b, trocar_error *why) {
    const options *o = b->options;
    baseline_measure(&b->baseline);
    for (int i = 0; i < o->count_count; i++)
        for (timed_motion motion = 0; motion < TIMED_MOTIONS; motion++) {
            timing_case wanted = {.start = b->start, .dt = 1.0 / trocar_model_rate(b->model), .contacts = o->counts[i],
                                  .ticks = o->ticks, .motion = motion};
            trocar_status status = tick_timing_measure(b->sim, b->scene, &wanted, &b->rows[i][motion], why);
            if (status != TROCAR_OK) return status;
        }
    return TROCAR_OK;
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

static void print_row(const bench *b, timed_motion motion, const tick_timing *row, FILE *out) {
    fprintf(out, "%8d  %-7s  %8.1f  %8.1f  %8.1f  %13.4f  %6.2f  %8.2f ", row->contacts, timed_motion_name(motion),
            1e6 * histogram_quantile(&row->time, 0.5), 1e6 * histogram_quantile(&row->time, 0.99),
            1e6 * histogram_max(&row->time), per_baseline(&b->baseline, &row->time), row->passes, row->switches);
    for (int i = 0; i < TROCAR_STAGES; i++) fprintf(out, "%8.1f", 1e6 * row->stages[i]);
    if (row->unstable) fprintf(out, "  (%d ticks without equilibrium)", row->unstable);
    fprintf(out, "\n");
}

static void print_table(const bench *b, FILE *out) {
    const options *o = b->options;
    fprintf(out, "%s: %d nodes, %d tetrahedra; %g Hz, contact nodes at least %g mm apart, %d ticks per row\n", o->scene_path,
            trocar_model_node_count(b->model), trocar_model_tet_count(b->model), trocar_model_rate(b->model), 1e3 * b->spacing, o->ticks);
    fprintf(out, "baseline: dgemm of order %d, p50 %.1f us, p99 %.1f us\n\n", BASELINE_ORDER,
            1e6 * histogram_quantile(&b->baseline, 0.5), 1e6 * histogram_quantile(&b->baseline, 0.99));
    fprintf(out, "                                                                         mean us of stage\n"
                 "contacts  motion     p50 us    p99 us    max us  p50/baseline   passes  switches   tissue  needle contact  wrench\n");
    for (int i = 0; i < o->count_count; i++)
        for (timed_motion motion = 0; motion < TIMED_MOTIONS; motion++) print_row(b, motion, &b->rows[i][motion], out);
}

static void json_row(json *j, const bench *b, int index, timed_motion motion) {
    const tick_timing *row = &b->rows[index][motion];
    json_line(j), json_open(j, NULL, '{');
    json_integer(j, "contacts", b->options->counts[index]);
    json_text(j, "motion", timed_motion_name(motion));
    json_integer(j, "timed_contacts", row->contacts);
    json_time(j, &row->time);
    json_number(j, "p50_per_baseline", per_baseline(&b->baseline, &row->time));
    json_number(j, "passes", row->passes);
    json_number(j, "switches", row->switches);
    json_integer(j, "unstable", row->unstable);
    json_numbers(j, "stages_s", row->stages, TROCAR_STAGES);
    json_close(j, '}');
}

static void write_json(const bench *b, FILE *out) {
    const options *o = b->options;
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_line(&j), json_text(&j, "benchmark", "tick");
    json_line(&j), json_text(&j, "scene", o->scene_path);
    json_line(&j), json_integer(&j, "nodes", trocar_model_node_count(b->model));
    json_line(&j), json_integer(&j, "tetrahedra", trocar_model_tet_count(b->model));
    json_line(&j), json_number(&j, "rate_hz", trocar_model_rate(b->model));
    json_line(&j), json_number(&j, "contact_spacing_m", b->spacing);
    json_line(&j), json_integer(&j, "ticks", o->ticks);
    json_line(&j), json_open(&j, "baseline", '{');
    json_integer(&j, "dgemm_order", BASELINE_ORDER);
    json_time(&j, &b->baseline);
    json_close(&j, '}');
    json_line(&j), json_open(&j, "rows", '[');
    for (int i = 0; i < o->count_count; i++)
        for (timed_motion motion = 0; motion < TIMED_MOTIONS; motion++) json_row(&j, b, i, motion);
    json_close(&j, ']');
    json_close(&j, '}');
    fputc('\n', out);
}

trocar_status bench_tick(int count, char **arguments, trocar_error *why) {
    options o = {.counts = {5, 10}, .count_count = 2, .ticks = 1000, .start = {NAN, NAN, NAN}};
    argp_parse(&parser, count, arguments, 0, NULL, &o);

    static bench b;
    b = (bench){.options = &o};
    trocar_status status = prepare(&b, why);
    if (status == TROCAR_OK) status = measure(&b, why);
    if (status == TROCAR_OK) print_table(&b, stdout);
    if (status == TROCAR_OK && o.json_path) write_json(&b, b.json_file.file);
    if (status == TROCAR_OK) status = output_commit(&b.json_file, why);
    trocar_sim_free(b.sim);
    trocar_model_free(b.model);
    trocar_scene_free(b.scene);
    output_abandon(&b.json_file);
    return status;
}
