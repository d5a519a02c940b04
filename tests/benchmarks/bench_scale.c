#include "bench_scale.h"

#include <cblas.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

#include "bench/tick_timing.h"
#include "common/progress.h"
#include "scale_timing.h"
#include "shared/json.h"
#include "shared/options.h"
#include "shared/output.h"

enum { SPEEDS = 3, COUNTS = 6, MAX_SCENES = 32 };
static const double speeds[SPEEDS] = {0.005, 0.02, 0.05};        /* m/s */
static const int contact_counts[COUNTS] = {5, 10, 20, 30, 40, 60};
static const double TIMED_SPACING = 1e-3;                        /* m, between contact nodes when times are measured against their number; room for 60 nodes */

typedef struct {
    const char *scene_paths[MAX_SCENES], *json_path;
    int scene_count, ticks;
    double depth;
    const char *inverse;     /* kind of inverse, or NULL for the one the scene sets */
} options;

/* Results for one scene with one kind of inverse. */
typedef struct {
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    double start_seconds, start_processor_seconds;
    double peak_bytes;       /* the process's resident memory, which grows from scene to scene */
    int counts;              /* number of contact counts the mesh permits */
    tick_timing ticks[COUNTS];
    scale_timing speeds[SPEEDS], figure8;
    scale_timing with, without; /* the second speed again, with all nodes cached; only `with` includes the time to measure the mesh's resolution */
} measured;

/* ---- command line ------------------------------------------------------------------------------------------------ */

enum { OPTION_TICKS = 256, OPTION_JSON, OPTION_DEPTH, OPTION_INVERSE };

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene (at least one); repeat for several", 0},
    {"inverse", OPTION_INVERSE, "OWNER", 0, "dense, sparse or condensed (default: as in the scenes)", 0},
    {"depth", OPTION_DEPTH, "METRES", 0, "How far the needle goes at each speed (default 0.08)", 0},
    {"ticks", OPTION_TICKS, "N", 0, "Ticks timed for each number of contacts (default 1000)", 0},
    {"json", OPTION_JSON, "FILE", 0, "Also write the results as JSON", 0},
    {0},
};

static const char *parse_inverse(const struct argp_state *state, const char *text) {
    static const char *const owners[] = {"dense", "sparse", "condensed"};
    for (size_t i = 0; i < sizeof owners / sizeof *owners; i++)
        if (strcmp(text, owners[i]) == 0) return owners[i];
    argp_error(state, "--inverse: '%s': expected dense, sparse or condensed", text);
    return NULL;
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 's':
        if (o->scene_count == MAX_SCENES) argp_error(state, "--scene: more than %d", MAX_SCENES);
        o->scene_paths[o->scene_count++] = text;
        break;
    case OPTION_INVERSE: o->inverse = parse_inverse(state, text); break;
    case OPTION_DEPTH: o->depth = parse_number(state, "depth", text, 1e-3, 1); break;
    case OPTION_TICKS: o->ticks = (int)parse_number(state, "ticks", text, 1, 1e6); break;
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
    "On each scene, inserts the needle at 5, 20 and 50 mm/s and plays the motion figure8. Measures the time of a tick by number of "
    "contacts (at least 1 mm apart), the time from crossing a face until the new contact node's row is available, with and without "
    "that of measuring on patches what the mesh resolves, start-up time, and memory. All times except start-up are processor time of one thread.", NULL, NULL, NULL};

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static const double APPROACH = 0.02; /* m, extra distance at the start, so that the needle's line has been measured before it touches the skin */

static trocar_status create(const options *o, const char *path, measured *m, trocar_error *why) {
    const trocar_model_options options = {.watch.progress = progress_show};
    trocar_status status = trocar_scene_load(path, &m->scene, why);
    if (status == TROCAR_OK && o->inverse) status = trocar_scene_set(m->scene, "inverse", o->inverse, why);
    if (status != TROCAR_OK) return status;
    int64_t wall = monotonic_ns(), processor = processor_ns();
    status = trocar_model_create(m->scene, &options, &m->model, why);
    if (status == TROCAR_OK) status = trocar_sim_create(m->model, &m->sim, why);
    m->start_seconds = 1e-9 * (double)(monotonic_ns() - wall);
    m->start_processor_seconds = 1e-9 * (double)(processor_ns() - processor);
    return status;
}

static trocar_status measure(const options *o, measured *m, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    double dt = 1.0 / trocar_model_rate(m->model);
    for (int i = 0; i < SPEEDS && status == TROCAR_OK; i++) {
        pose aside = MOTION_START; /* different nodes for each speed, so that none is cached */
        aside.position.y += 4e-3 * (i - 1);
        aside.position.z -= APPROACH;
        scale_case wanted = {.start = aside, .speed = speeds[i], .depth = o->depth + APPROACH, .dt = dt};
        status = scale_timing_measure(m->sim, &wanted, &m->speeds[i], why);
    }
    for (int i = 0; i < 2 && status == TROCAR_OK; i++) {
        scale_case wanted = {.start = MOTION_START, .speed = speeds[1], .depth = o->depth + APPROACH, .dt = dt, .free_patches = i == 1};
        wanted.start.position.z -= APPROACH;
        status = scale_timing_measure(m->sim, &wanted, i == 0 ? &m->with : &m->without, why);
    }
    if (status == TROCAR_OK) {
        scale_case wanted = {.start = MOTION_START, .script = motion_find("figure8"), .dt = dt};
        wanted.start.position.x -= 4e-3;
        status = scale_timing_measure(m->sim, &wanted, &m->figure8, why);
    }
    scale_timing_set_spacing(m->model, TIMED_SPACING);
    for (; m->counts < COUNTS && status == TROCAR_OK; m->counts++) {
        timing_case wanted = {.start = MOTION_START, .dt = dt, .contacts = contact_counts[m->counts], .ticks = o->ticks, .motion = TIMED_ADVANCE};
        /* the needle's path has room for fewer contacts than requested */
        if (tick_timing_measure(m->sim, m->scene, &wanted, &m->ticks[m->counts], why) != TROCAR_OK) break;
    }
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    m->peak_bytes = 1024.0 * (double)usage.ru_maxrss;
    return status;
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

static void print_motion(const char *name, const scale_timing *s, FILE *out) {
    fprintf(out, "%-7s  %9d  %6d  %10d  %8d  %10d  %13.2f  %6.2f  %6.2f  %16.2f  %12.2f  %6.2f  %11.1f  %8d\n", name, s->crossings, s->late_crossings,
            s->late_ticks, s->contacts, s->unanswered, 1e3 * histogram_quantile(&s->crossing, 0.5), 1e3 * histogram_quantile(&s->crossing, 0.99),
            1e3 * histogram_max(&s->crossing), 1e3 * histogram_max(&s->activation), 1e3 * histogram_quantile(&s->serve, 0.5),
            1e3 * histogram_max(&s->serve), 1e6 * histogram_quantile(&s->tick, 0.5), s->most_contacts);
}

static void print_patches(const measured *m, FILE *out) {
    static const char *const names[] = {"with", "without"};
    const scale_timing *both[] = {&m->with, &m->without};
    fprintf(out, "patch solves: p50 %.2f ms, p99 %.2f ms, max %.2f ms\n",
            1e3 * histogram_quantile(&m->with.patch, 0.5), 1e3 * histogram_quantile(&m->with.patch, 0.99), 1e3 * histogram_max(&m->with.patch));
    for (int i = 0; i < 2; i++)
        fprintf(out, "%.0f mm/s again, %s their time: answer p50 %.2f ms, p99 %.2f ms, max %.2f ms; %d of %d late; tick p50 %.1f us\n", 1e3 * speeds[1],
                names[i], 1e3 * histogram_quantile(&both[i]->crossing, 0.5), 1e3 * histogram_quantile(&both[i]->crossing, 0.99),
                1e3 * histogram_max(&both[i]->crossing), both[i]->late_crossings, both[i]->crossings, 1e6 * histogram_quantile(&both[i]->tick, 0.5));
}

static void print_scene(const measured *m, FILE *out) {
    fprintf(out, "\n%s: %d nodes, %d tetrahedra; inverse: %s\n", trocar_scene_path(m->scene), trocar_model_node_count(m->model),
            trocar_model_tet_count(m->model), trocar_model_description(m->model));
    fprintf(out, "start %.1f s (processor %.1f s), memory at most %.2f GB\n", m->start_seconds, m->start_processor_seconds, 1e-9 * m->peak_bytes);
    fprintf(out, "motion   crossings    late  late ticks  contacts  unanswered  answer p50 ms  p99 ms  max ms  active late max  serve p50 ms  "
                 "max ms  tick p50 us   at most\n");
    for (int i = 0; i < SPEEDS; i++) {
        char name[32];
        snprintf(name, sizeof name, "%.0f mm/s", 1e3 * speeds[i]);
        print_motion(name, &m->speeds[i], out);
    }
    print_motion("figure8", &m->figure8, out);
    print_patches(m, out);
    for (int i = 0; i < m->counts; i++)
        fprintf(out, "tick with %2d contacts: p50 %.1f us, p99 %.1f us, %.2f passes\n", contact_counts[i],
                1e6 * histogram_quantile(&m->ticks[i].time, 0.5), 1e6 * histogram_quantile(&m->ticks[i].time, 0.99), m->ticks[i].passes);
}

static void json_timed(json *j, const char *name, const histogram *time) {
    json_open(j, name, '{');
    json_time(j, time);
    json_close(j, '}');
}

/* Writes the members of a JSON object. */
static void json_motion(json *j, const scale_timing *s) {
    json_integer(j, "ticks", s->ticks);
    json_integer(j, "crossings", s->crossings);
    json_integer(j, "late_crossings", s->late_crossings);
    json_integer(j, "late_ticks", s->late_ticks);
    json_integer(j, "contacts", s->contacts);
    json_integer(j, "unanswered", s->unanswered);
    json_integer(j, "most_contacts", s->most_contacts);
    json_timed(j, "tick", &s->tick);
    json_timed(j, "serve", &s->serve);
    json_timed(j, "patch", &s->patch);
    json_timed(j, "crossing", &s->crossing);
    json_open(j, "activation", '{');
    json_integer(j, "count", s->activation.count);
    json_time(j, &s->activation);
    json_close(j, '}');
}

static void json_scene(json *j, const measured *m) {
    json_line(j), json_open(j, NULL, '{');
    json_text(j, "scene", trocar_scene_path(m->scene));
    json_text(j, "inverse", trocar_model_inverse(m->model));
    json_integer(j, "nodes", trocar_model_node_count(m->model));
    json_integer(j, "tetrahedra", trocar_model_tet_count(m->model));
    json_number(j, "start_s", m->start_seconds);
    json_number(j, "start_processor_s", m->start_processor_seconds);
    json_number(j, "peak_bytes", m->peak_bytes);
    json_line(j), json_open(j, "speeds", '[');
    for (int i = 0; i < SPEEDS; i++) {
        json_line(j), json_open(j, NULL, '{');
        json_number(j, "speed", speeds[i]);
        json_motion(j, &m->speeds[i]);
        json_close(j, '}');
    }
    json_close(j, ']');
    json_line(j), json_open(j, "figure8", '{');
    json_motion(j, &m->figure8);
    json_close(j, '}');
    json_line(j), json_open(j, "with_patches", '{');
    json_motion(j, &m->with);
    json_close(j, '}');
    json_line(j), json_open(j, "without_patches", '{');
    json_motion(j, &m->without);
    json_close(j, '}');
    json_line(j), json_open(j, "contacts", '[');
    for (int i = 0; i < m->counts; i++) {
        json_line(j), json_open(j, NULL, '{');
        json_integer(j, "contacts", contact_counts[i]);
        json_number(j, "passes", m->ticks[i].passes);
        json_time(j, &m->ticks[i].time);
        json_close(j, '}');
    }
    json_close(j, ']');
    json_close(j, '}');
}

/* ---- the benchmark ----------------------------------------------------------------------------------------------- */

static trocar_status run_scene(const options *o, int index, json *results, trocar_error *why) {
    static measured m;
    memset(&m, 0, sizeof m);
    trocar_status status = create(o, o->scene_paths[index], &m, why);
    if (status == TROCAR_OK) status = measure(o, &m, why);
    if (status == TROCAR_OK) print_scene(&m, stdout);
    if (status == TROCAR_OK && results->out) json_scene(results, &m);
    fflush(stdout);
    trocar_sim_free(m.sim);
    trocar_model_free(m.model);
    trocar_scene_free(m.scene);
    return status;
}

trocar_status bench_scale(int count, char **arguments, trocar_error *why) {
    options o = {.ticks = 1000, .depth = 0.08};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    openblas_set_num_threads(1);
    output file = {0};
    trocar_status status = o.json_path ? output_open(&file, o.json_path, why) : TROCAR_OK;
    json j = {.out = file.file};
    if (j.out) {
        json_open(&j, NULL, '{');
        json_line(&j), json_text(&j, "benchmark", "scale");
        json_line(&j), json_open(&j, "scenes", '[');
    }
    for (int i = 0; i < o.scene_count && status == TROCAR_OK; i++) status = run_scene(&o, i, &j, why);
    if (j.out) {
        json_close(&j, ']');
        json_close(&j, '}');
        fputc('\n', j.out);
    }
    if (status == TROCAR_OK) status = output_commit(&file, why);
    output_abandon(&file);
    return status;
}
