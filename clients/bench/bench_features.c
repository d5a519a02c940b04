#include "bench/bench_features.h"

#include <stdio.h>
#include <string.h>

#include "bench/tick_timing.h"
#include "shared/json.h"
#include "shared/motion.h"
#include "shared/options.h"
#include "shared/output.h"
#include "shared/patient.h"

static const double TURN_RATE = 6.0;                        /* rad/s, how fast the base turns */
static const double SERIES[][2] = {{0.25, 0.15}, {0.15, 2.5}, {0.1, 30.0}}; /* weight and time constant (s) of each relaxation term */
static const double GUIDE_END = 0.01;                       /* m, distance from the guide to the tip at the start */
static const double GUIDE_THICKNESS = 0.01;                 /* m, of the guide plate */
enum { PLAIN, WHOLE, VARIANTS, ROUNDS = 10 };               /* ROUNDS: how often each variant is measured, alternating so that machine load affects both */
static const char *const NAMES[VARIANTS] = {"without", "with"};

typedef struct {
    const char *scene_path, *json_path;
    int contacts, ticks;
    double spacing;          /* m, spacing of the contact nodes; if 0, the scene's */
} options;

typedef struct {
    const options *options;
    trocar_scene *scenes[VARIANTS];
    trocar_model *models[VARIANTS];
    trocar_sim *sims[VARIANTS];
    pose start;              /* pose of the needle's base at the start */
    tick_timing rows[TIMED_MOTIONS][VARIANTS];
    output json_file;
} bench;

/* ---- command line ------------------------------------------------------------------------------------------------ */

enum { OPTION_TICKS = 256, OPTION_JSON, OPTION_SPACING };

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene, without relaxation and guides (required)", 0},
    {"contacts", 'c', "N", 0, "Contacts while measuring (default 30)", 0},
    {"ticks", OPTION_TICKS, "N", 0, "Ticks timed for each row, rounded up to a multiple of 10 (default 2000)", 0},
    {"spacing", OPTION_SPACING, "METRES", 0, "Smallest distance between contact nodes (default: the scene's)", 0},
    {"json", OPTION_JSON, "FILE", 0, "Also write the results as JSON", 0},
    {0},
};

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 's': o->scene_path = text; break;
    case 'c': o->contacts = parse_whole(state, "contacts", text, 1, TROCAR_MAX_CONTACTS); break;
    case OPTION_TICKS: o->ticks = parse_whole(state, "ticks", text, ROUNDS, 1000000); break;
    case OPTION_JSON: o->json_path = text; break;
    case OPTION_SPACING: o->spacing = parse_number(state, "spacing", text, 1e-5, 1); break;
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
    "Times each tick with about N contacts, as 'trocar-bench tick' does, in the scene as it is and with a relaxation series of three terms, a "
    "guide in front of the skin and a base that turns at 6 rad/s. The two are measured alternately, and the last column is their ratio.", NULL, NULL, NULL};

/* ---- scenes ------------------------------------------------------------------------------------------------------ */

static trocar_status set_point(trocar_scene *scene, const char *key, vec3 value, trocar_error *why) {
    char text[128];
    snprintf(text, sizeof text, "[%.17g, %.17g, %.17g]", value.x, value.y, value.z);
    return trocar_scene_set(scene, key, text, why);
}

static trocar_status add_relaxation(trocar_scene *scene, trocar_error *why) {
    static const char *const keys[] = {"weight", "time"};
    trocar_status status = TROCAR_OK;
    for (int term = 0; term < (int)(sizeof SERIES / sizeof *SERIES); term++)
        for (int i = 0; i < 2 && status == TROCAR_OK; i++) {
            char key[64];
            snprintf(key, sizeof key, "relaxation[%d].%s", term, keys[i]);
            status = trocar_scene_set_number(scene, key, SERIES[term][i], why);
        }
    return status;
}

/* Adds a guide with a single hole, centred on the needle's axis. */
static trocar_status add_guide(trocar_scene *scene, pose start, trocar_error *why) {
    double length, diameter;
    vec3 axis = q_axis(start.orientation);
    trocar_status status = trocar_scene_get_number(scene, "needle.length", &length, why);
    if (status == TROCAR_OK) status = trocar_scene_get_number(scene, "needle.outer_diameter", &diameter, why);
    if (status == TROCAR_OK) status = set_point(scene, "guides[bench].origin", v3_axpy(length - GUIDE_END - GUIDE_THICKNESS, axis, start.position), why);
    if (status == TROCAR_OK) status = set_point(scene, "guides[bench].normal", axis, why);
    if (status == TROCAR_OK) status = trocar_scene_set_number(scene, "guides[bench].thickness", GUIDE_THICKNESS, why);
    return status == TROCAR_OK ? trocar_scene_set_number(scene, "guides[bench].hole_diameter", 1.1 * diameter, why) : status;
}

static trocar_status load_variant(bench *b, int variant, trocar_error *why) {
    const options *o = b->options;
    trocar_status status = trocar_scene_load(o->scene_path, &b->scenes[variant], why);
    trocar_scene *scene = b->scenes[variant];
    if (status == TROCAR_OK && trocar_scene_count(scene, "relaxation") + trocar_scene_count(scene, "guides") > 0)
        return fail(why, TROCAR_BAD_INPUT, "%s: has relaxation or guides already: use a scene without", o->scene_path);
    if (status == TROCAR_OK && o->spacing > 0.0) status = trocar_scene_set_number(scene, "contact.spacing", o->spacing, why);
    if (status == TROCAR_OK) find_start(scene, NULL, NULL, &b->start);
    if (status == TROCAR_OK && variant == WHOLE) status = add_relaxation(scene, why);
    if (status == TROCAR_OK && variant == WHOLE) status = add_guide(scene, b->start, why);
    if (status == TROCAR_OK) status = trocar_model_create(scene, NULL, &b->models[variant], why);
    return status == TROCAR_OK ? trocar_sim_create(b->models[variant], &b->sims[variant], why) : status;
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static trocar_status measure_round(bench *b, timed_motion motion, int variant, trocar_error *why) {
    const options *o = b->options;
    timing_case wanted = {.start = b->start, .dt = 1.0 / trocar_model_rate(b->models[variant]), .contacts = o->contacts,
                          .ticks = (o->ticks + ROUNDS - 1) / ROUNDS, .motion = motion, .turn_rate = variant == WHOLE ? TURN_RATE : 0.0};
    tick_timing part;
    trocar_status status = tick_timing_measure(b->sims[variant], b->scenes[variant], &wanted, &part, why);
    if (status == TROCAR_OK) tick_timing_add(&b->rows[motion][variant], &part);
    return status;
}

static trocar_status measure(bench *b, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    for (timed_motion motion = 0; motion < TIMED_MOTIONS; motion++)
        for (int round = 0; round < ROUNDS; round++)
            for (int variant = 0; variant < VARIANTS && status == TROCAR_OK; variant++) status = measure_round(b, motion, variant, why);
    return status;
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

static double ratio_of(const tick_timing *rows, double quantile) {
    return histogram_quantile(&rows[WHOLE].time, quantile) / histogram_quantile(&rows[PLAIN].time, quantile);
}

static void print_table(const bench *b, FILE *out) {
    const options *o = b->options;
    fprintf(out, "%s: %d nodes; %d contacts, %g Hz; relaxation of three terms, a guide, and a base turning at %g rad/s, with against without\n\n", o->scene_path,
            trocar_model_node_count(b->models[PLAIN]), o->contacts, trocar_model_rate(b->models[PLAIN]), TURN_RATE);
    fprintf(out, "motion   features  contacts    p50 us    p99 us    max us  passes  p50 with / without\n");
    for (timed_motion motion = 0; motion < TIMED_MOTIONS; motion++)
        for (int variant = 0; variant < VARIANTS; variant++) {
            const tick_timing *row = &b->rows[motion][variant];
            fprintf(out, "%-7s  %-8s  %8d  %8.1f  %8.1f  %8.1f  %6.2f", timed_motion_name(motion), NAMES[variant], row->contacts, 1e6 * histogram_quantile(&row->time, 0.5),
                    1e6 * histogram_quantile(&row->time, 0.99), 1e6 * histogram_max(&row->time), row->passes);
            if (variant == WHOLE) fprintf(out, "  %18.3f", ratio_of(b->rows[motion], 0.5));
            if (row->unstable) fprintf(out, "  (%d ticks without equilibrium)", row->unstable);
            fprintf(out, "\n");
        }
}

static void write_json(const bench *b, FILE *out) {
    const options *o = b->options;
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_line(&j), json_text(&j, "benchmark", "features");
    json_line(&j), json_text(&j, "scene", o->scene_path);
    json_line(&j), json_integer(&j, "nodes", trocar_model_node_count(b->models[PLAIN]));
    json_line(&j), json_number(&j, "rate_hz", trocar_model_rate(b->models[PLAIN]));
    json_line(&j), json_integer(&j, "contacts", o->contacts);
    json_line(&j), json_open(&j, "rows", '[');
    for (timed_motion motion = 0; motion < TIMED_MOTIONS; motion++)
        for (int variant = 0; variant < VARIANTS; variant++) {
            const tick_timing *row = &b->rows[motion][variant];
            json_line(&j), json_open(&j, NULL, '{');
            json_text(&j, "motion", timed_motion_name(motion));
            json_text(&j, "features", NAMES[variant]);
            json_integer(&j, "timed_contacts", row->contacts);
            json_time(&j, &row->time);
            json_number(&j, "passes", row->passes);
            json_integer(&j, "unstable", row->unstable);
            if (variant == WHOLE) json_number(&j, "p50_ratio", ratio_of(b->rows[motion], 0.5));
            json_close(&j, '}');
        }
    json_close(&j, ']');
    json_close(&j, '}');
    fputc('\n', out);
}

trocar_status bench_features(int count, char **arguments, trocar_error *why) {
    options o = {.contacts = 30, .ticks = 2000};
    argp_parse(&parser, count, arguments, 0, NULL, &o);

    static bench b;
    b = (bench){.options = &o, .start = MOTION_START};
    trocar_status status = o.json_path ? output_open(&b.json_file, o.json_path, why) : TROCAR_OK;
    for (int variant = 0; variant < VARIANTS && status == TROCAR_OK; variant++) status = load_variant(&b, variant, why);
    if (status == TROCAR_OK) status = measure(&b, why);
    if (status == TROCAR_OK) print_table(&b, stdout);
    if (status == TROCAR_OK && o.json_path) write_json(&b, b.json_file.file);
    if (status == TROCAR_OK) status = output_commit(&b.json_file, why);
    for (int variant = 0; variant < VARIANTS; variant++) {
        trocar_sim_free(b.sims[variant]);
        trocar_model_free(b.models[variant]);
        trocar_scene_free(b.scenes[variant]);
    }
    output_abandon(&b.json_file);
    return status;
}
