#include "bench_scale.h"

#include <cblas.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

#include "json.h"
#include "options.h"
#include "output.h"
#include "progress.h"
#include "scale_timing.h"
#include "scene/scene.h"
#include "tick_timing.h"

enum { SPEEDS = 3, COUNTS = 6, MAX_SCENES = 32 };
static const double speeds[SPEEDS] = {0.005, 0.02, 0.05};        /* m/s */
static const int contact_counts[COUNTS] = {5, 10, 20, 30, 40, 60};
static const double TIMED_SPACING = 1e-3;                        /* m, between contact nodes where they are counted: room for 60 */

typedef struct {
    const char *scene_paths[MAX_SCENES], *json_path;
    int scene_count, ticks;
    double depth;
    inverse_choice inverse;  /* AUTO: the scene's */
} options;

/* One scene with one owner. */
typedef struct {
    scene scene;
    simulation simulation;
    double start_seconds, start_processor_seconds;
    double peak_bytes;       /* resident, of the process: rises from scene to scene */
    int counts;              /* contact counts that the mesh has */
    tick_timing ticks[COUNTS];
    scale_timing speeds[SPEEDS], figure8;
} measured;

/* ---- command line ------------------------------------------------------------------------------------------------ */

enum { OPTION_TICKS = 256, OPTION_JSON, OPTION_DEPTH, OPTION_INVERSE };

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene (at least one); may be given again", 0},
    {"inverse", OPTION_INVERSE, "OWNER", 0, "dense, sparse or condensed, in place of the scenes'", 0},
    {"depth", OPTION_DEPTH, "METRES", 0, "How far the needle goes at each speed (default 0.08)", 0},
    {"ticks", OPTION_TICKS, "N", 0, "Ticks timed for each number of contacts (default 1000)", 0},
    {"json", OPTION_JSON, "FILE", 0, "Write the results as JSON too", 0},
    {0},
};

static inverse_choice parse_inverse(const struct argp_state *state, const char *text) {
    for (int i = INVERSE_AUTO + 1; i < INVERSE_CHOICES; i++)
        if (strcmp(text, inverse_choice_name((inverse_choice)i)) == 0) return (inverse_choice)i;
    argp_error(state, "--inverse: '%s': dense, sparse or condensed", text);
    return INVERSE_AUTO;
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
    "Pushes the needle in at 5, 20 and 50 mm/s on each scene and plays the motion figure8: time of a tick by the number of contacts "
    "(1 mm apart or more), from crossing a face to the new contact node's row being at hand, to start, and memory. All times but the "
    "start's are processor time of one thread.", NULL, NULL, NULL};

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static const double APPROACH = 0.02; /* m, from further away: the needle's line is known before it touches the skin */

static trocar_status create(const options *o, const char *path, measured *m, report *why) {
    trocar_status status = scene_load(path, &m->scene, why);
    if (status != TROCAR_OK) return status;
    if (o->inverse != INVERSE_AUTO) m->scene.simulation.inverse = o->inverse;
    m->scene.simulation.progress.show = progress_show;
    int64_t wall = monotonic_ns(), processor = processor_ns();
    status = simulation_create(&m->scene.simulation, &m->simulation, why);
    m->start_seconds = 1e-9 * (double)(monotonic_ns() - wall);
    m->start_processor_seconds = 1e-9 * (double)(processor_ns() - processor);
    return status;
}

static trocar_status measure(const options *o, measured *m, report *why) {
    trocar_status status = TROCAR_OK;
    double dt = 1.0 / m->scene.rate_hz;
    for (int i = 0; i < SPEEDS && status == TROCAR_OK; i++) {
        pose aside = MOTION_START; /* other nodes for each speed: none is at hand already */
        aside.position.y += 4e-3 * (i - 1);
        aside.position.z -= APPROACH;
        scale_case wanted = {.start = aside, .speed = speeds[i], .depth = o->depth + APPROACH, .dt = dt};
        status = scale_timing_measure(&m->simulation, &wanted, &m->speeds[i], why);
    }
    if (status == TROCAR_OK) {
        scale_case wanted = {.start = MOTION_START, .script = motion_find("figure8"), .dt = dt};
        wanted.start.position.x -= 4e-3;
        status = scale_timing_measure(&m->simulation, &wanted, &m->figure8, why);
    }
    m->simulation.insertion.settings.contact_spacing = TIMED_SPACING;
    for (; m->counts < COUNTS && status == TROCAR_OK; m->counts++) {
        timing_case wanted = {.start = MOTION_START, .dt = dt, .contacts = contact_counts[m->counts], .ticks = o->ticks, .motion = TIMED_ADVANCE};
        if (tick_timing_measure(&m->simulation, &wanted, &m->ticks[m->counts], why) != TROCAR_OK) break; /* fewer along the way */
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

static void print_scene(const measured *m, FILE *out) {
    const mesh *body = &m->simulation.mesh;
    fprintf(out, "\n%s: %d nodes, %d tetrahedra; inverse: %s\n", m->scene.path, body->node_count, body->tet_count, m->simulation.about_inverse.text);
    fprintf(out, "start %.1f s (processor %.1f s), memory at most %.2f GB\n", m->start_seconds, m->start_processor_seconds, 1e-9 * m->peak_bytes);
    fprintf(out, "motion   crossings    late  late ticks  contacts  unanswered  answer p50 ms  p99 ms  max ms  active late max  serve p50 ms  "
                 "max ms  tick p50 us   at most\n");
    for (int i = 0; i < SPEEDS; i++) {
        char name[32];
        snprintf(name, sizeof name, "%.0f mm/s", 1e3 * speeds[i]);
        print_motion(name, &m->speeds[i], out);
    }
    print_motion("figure8", &m->figure8, out);
    for (int i = 0; i < m->counts; i++)
        fprintf(out, "tick with %2d contacts: p50 %.1f us, p99 %.1f us, %.2f passes\n", contact_counts[i],
                1e6 * histogram_quantile(&m->ticks[i].time, 0.5), 1e6 * histogram_quantile(&m->ticks[i].time, 0.99), m->ticks[i].passes);
}

/* Members of an object, and its end. */
static void json_motion(const scale_timing *s, FILE *out) {
    fprintf(out, "\"ticks\": %d, \"crossings\": %d, \"late_crossings\": %d, \"late_ticks\": %d, \"contacts\": %d, \"unanswered\": %d, "
                 "\"most_contacts\": %d,\n       \"tick\": {",
            s->ticks, s->crossings, s->late_crossings, s->late_ticks, s->contacts, s->unanswered, s->most_contacts);
    json_time(&s->tick, out);
    fprintf(out, "}, \"serve\": {");
    json_time(&s->serve, out);
    fprintf(out, "}, \"crossing\": {");
    json_time(&s->crossing, out);
    fprintf(out, "}, \"activation\": {\"count\": %" PRId64 ", ", s->activation.count);
    json_time(&s->activation, out);
    fprintf(out, "}}");
}

static void json_scene(const measured *m, FILE *out) {
    const mesh *body = &m->simulation.mesh;
    fprintf(out, "    {\"scene\": ");
    json_string(m->scene.path, out);
    fprintf(out, ", \"inverse\": ");
    json_string(inverse_name(m->simulation.inverse), out);
    fprintf(out, ", \"nodes\": %d, \"tetrahedra\": %d, \"start_s\": %.6g, \"start_processor_s\": %.6g, \"peak_bytes\": %.9g,\n     \"speeds\": [",
            body->node_count, body->tet_count, m->start_seconds, m->start_processor_seconds, m->peak_bytes);
    for (int i = 0; i < SPEEDS; i++) {
        fprintf(out, "%s\n      {\"speed\": %g, ", i ? "," : "", speeds[i]);
        json_motion(&m->speeds[i], out);
    }
    fprintf(out, "],\n     \"figure8\": {");
    json_motion(&m->figure8, out);
    fprintf(out, ",\n     \"contacts\": [");
    for (int i = 0; i < m->counts; i++) {
        fprintf(out, "%s\n      {\"contacts\": %d, \"passes\": %.6g, ", i ? "," : "", contact_counts[i], m->ticks[i].passes);
        json_time(&m->ticks[i].time, out);
        fprintf(out, "}");
    }
    fprintf(out, "]}");
}

/* ---- the benchmark ----------------------------------------------------------------------------------------------- */

static trocar_status run_scene(const options *o, int index, FILE *json, report *why) {
    static measured m;
    memset(&m, 0, sizeof m);
    trocar_status status = create(o, o->scene_paths[index], &m, why);
    if (status != TROCAR_OK) return status;
    status = measure(o, &m, why);
    if (status == TROCAR_OK) print_scene(&m, stdout);
    if (status == TROCAR_OK && json) {
        fprintf(json, index ? ",\n" : "\n");
        json_scene(&m, json);
    }
    fflush(stdout);
    simulation_free(&m.simulation);
    return status;
}

trocar_status bench_scale(int count, char **arguments, report *why) {
    options o = {.ticks = 1000, .depth = 0.08};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    openblas_set_num_threads(1);
    output json = {0};
    trocar_status status = o.json_path ? output_open(&json, o.json_path, why) : TROCAR_OK;
    if (json.file) fprintf(json.file, "{\n  \"benchmark\": \"scale\",\n  \"scenes\": [");
    for (int i = 0; i < o.scene_count && status == TROCAR_OK; i++) status = run_scene(&o, i, json.file, why);
    if (json.file) fprintf(json.file, "\n  ]\n}\n");
    if (status == TROCAR_OK) status = output_commit(&json, why);
    output_abandon(&json);
    return status;
}
