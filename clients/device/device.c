/* trocar-device: a virtual haptic device. */
#include <stdlib.h>
#include <string.h>

#include "device/implant_errors.h"
#include "device/implant_player.h"
#include "device/player.h"
#include "device/profile_check.h"
#include "shared/options.h"
#include "shared/output.h"
#include "shared/patient.h"
#include "shared/poselog.h"

const char *argp_program_version = "trocar-device " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

typedef struct {
    play_settings play;
    const char *report_path, *csv_path, *log_path, *scene_path, *plan_path;
    bool start_given, patient;
    const char *script_option; /* an option given that only makes sense with a script; NULL if none */
    const char *plan_option, *image_option; /* options given that only make sense with a plan, or only with the image operator; NULL if none */
    const char *errors_path, *stabilise;
    bool follows_image, strands;
    int seed;                /* -1 if not given; likewise the members below */
    double image_error, splay, speed_spread;
    profile_settings check;  /* settings for checking a device profile instead of playing; check.profile is NULL if no check was requested */
    const char *check_option, *play_option; /* options given that only make sense for this check, or that make no sense for it; NULL if none */
} options;

enum { OPTION_SPEED = 256, OPTION_REPORT, OPTION_CSV, OPTION_LOG, OPTION_URL, OPTION_START, OPTION_HAND, OPTION_REALTIME,
       OPTION_WAIT, OPTION_SETTLE, OPTION_NEEDLE, OPTION_SCENE, OPTION_PATIENT,
       OPTION_PLAN, OPTION_OPERATOR, OPTION_STRANDS, OPTION_STABILISE, OPTION_SEED, OPTION_IMAGE_ERROR, OPTION_SPLAY, OPTION_SPEED_SPREAD, OPTION_ERRORS,
       OPTION_PROFILE, OPTION_DEVICE_DELAY, OPTION_ROUND_TRIP };

static const struct argp_option option_list[] = {
    {"script", 's', "NAME", 0, "Motion to play (default figure8); 'list' shows all", 0},
    {"rate", 'r', "HZ", 0, "Poses per second (default 1000)", 0},
    {"duration", 'd', "SECONDS", 0, "How long to play; longer than the script repeats it (default: the script once)", 0},
    {"speed", OPTION_SPEED, "FACTOR", 0, "Play the script faster or slower (default 1)", 0},
    {"scene", OPTION_SCENE, "FILE", 0, "Start at the scene's needle.start, in its direction, and insert to its depth", 0},
    {"start", OPTION_START, "X,Y,Z", 0, "Start of the base, m (default: the scene's, or 0.005,0.003,-0.201)", 0},
    {"patient", OPTION_PATIENT, 0, 0, "--start and --csv are in the patient's coordinates: mm, DICOM axes; needs --scene", 0},
    {"needle", OPTION_NEEDLE, "N", 0, "Index of the needle to hold, from 0 (default 0)", 0},
    {"plan", OPTION_PLAN, "FILE", 0,
     "Carry out this implant instead of a script: insert all needles and leave them, then take each again, drop its seeds and pull it out. FILE "
     "is the table that python3 -m trocar.brachy.plan show --out writes; needs --scene", 0},
    {"hand", OPTION_HAND, "MASS,DAMPING,STIFFNESS", 0,
     "A simulated hand (kg, N s/m to ground, N/m to the script) holds the needle and is pushed by the wrench", 0},
    {0, 0, 0, 0, "Operator of a plan:", 1},
    {"operator", OPTION_OPERATOR, "KIND", 0,
     "marks: read the depth from the needle's marks at the template; image: move the tip to where an image of the displaced tissue shows each planned place, with "
     "errors and speeds as published (default marks)", 1},
    {"strands", OPTION_STRANDS, 0, 0, "The seeds of each needle are a strand: bring only the first one to its place, and leave the others at the planned distances", 1},
    {"stabilise", OPTION_STABILISE, "HOLES", 0, "Insert needles without seeds into these holes first, such as C4,I4, and take them out last", 1},
    {"seed", OPTION_SEED, "N", 0, "Seed of the random numbers of --operator image (default 1)", 1},
    {"image-error", OPTION_IMAGE_ERROR, "M", 0, "Error of the image along the needle, m, standard deviation over the needles (default 0.00065)", 1},
    {"splay", OPTION_SPLAY, "RAD", 0, "Tilt of the needle in its hole about each axis, rad, standard deviation; limited by the hole (default 0.0104)", 1},
    {"speed-spread", OPTION_SPEED_SPREAD, "S", 0, "Standard deviation of the logarithm of the needles' speeds (default 0.33)", 1},
    {"errors", OPTION_ERRORS, "FILE", 0, "Write the parts of each seed's misplacement: tissue, image, splay and remainder", 1},
    {0, 0, 0, 0, "Check of a device profile:", 2},
    {"profile", OPTION_PROFILE, "NAME or FILE", 0,
     "Check this profile against a simulated device instead of sending poses: whether the needle's travel fits into the workspace, and the margins of stability "
     "and passivity. --hand is the device with the hand, --rate the device's loop, and --scene has the travel. Status 1 if the profile is not suitable", 2},
    {"device-delay", OPTION_DEVICE_DELAY, "SECONDS", 0, "Round trip between bridge and simulated device (default: the profile's)", 2},
    {"round-trip", OPTION_ROUND_TRIP, "SECONDS", 0, "Round trip between bridge and server (default 0.001)", 2},
    {0, 0, 0, 0, "Connection:", 3},
    {"lcm-url", OPTION_URL, "URL", 0, "LCM network (default $LCM_DEFAULT_URL)", 3},
    {"realtime", OPTION_REALTIME, 0, 0, "Run under SCHED_FIFO where permitted", 3},
    {"wait", OPTION_WAIT, "SECONDS", 0, "Give up if the server has not answered for this long (default 5)", 3},
    {"settle", OPTION_SETTLE, "SECONDS", 0, "Wait before the script begins, while the server ramps the force up (default 0.3)", 3},
    {0, 0, 0, 0, "Output:", 4},
    {"report", OPTION_REPORT, "FILE", 0, "Also write the report as JSON", 4},
    {"csv", OPTION_CSV, "FILE", 0, "Write every wrench as a row", 4},
    {"write-log", OPTION_LOG, "FILE", 0, "Write the poses as an LCM event log instead of sending them; needs no network", 4},
    {0},
};

static void list_scripts(void) {
    for (int i = 0; motion_at(i); i++)
        printf("%-8s %4.1f s  %s\n", motion_at(i)->name, motion_at(i)->duration, motion_at(i)->summary);
    exit(EXIT_SUCCESS);
}

static const motion *parse_script(const struct argp_state *state, const char *name) {
    if (strcmp(name, "list") == 0) list_scripts();
    const motion *script = motion_find(name);
    if (!script) argp_error(state, "--script: no script '%s'; --script list shows all", name);
    return script;
}

static hand parse_hand(const struct argp_state *state, const char *text) {
    double n[3];
    parse_numbers(state, "hand", text, 3, n);
    if (n[0] <= 0 || n[1] < 0 || n[2] <= 0)
        argp_error(state, "--hand: %s: mass and stiffness must be positive, damping not negative", text);
    return (hand){.mass = n[0], .damping = n[1], .stiffness = n[2]};
}

/* Returns the name of an option that only makes sense with a script. NULL for any other, which may be used with --plan. */
static const char *script_option(int key) {
    switch (key) {
    case 's': return "--script";
    case 'd': return "--duration";
    case OPTION_START: return "--start";
    case OPTION_PATIENT: return "--patient";
    case OPTION_NEEDLE: return "--needle";
    case OPTION_HAND: return "--hand";
    case OPTION_REPORT: return "--report";
    case OPTION_LOG: return "--write-log";
    default: return NULL;
    }
}

/* Returns the name of an option that only makes sense with a plan; NULL for any other. */
static const char *plan_option(int key) {
    switch (key) {
    case OPTION_OPERATOR: return "--operator";
    case OPTION_STRANDS: return "--strands";
    case OPTION_STABILISE: return "--stabilise";
    case OPTION_ERRORS: return "--errors";
    default: return NULL;
    }
}

/* Returns the name of an option that only makes sense with --operator image; NULL for any other. */
static const char *image_option(int key) {
    switch (key) {
    case OPTION_SEED: return "--seed";
    case OPTION_IMAGE_ERROR: return "--image-error";
    case OPTION_SPLAY: return "--splay";
    case OPTION_SPEED_SPREAD: return "--speed-spread";
    default: return NULL;
    }
}

/* Returns the name of an option that only makes sense when checking a profile; NULL for any other. */
static const char *check_option(int key) { return key == OPTION_DEVICE_DELAY ? "--device-delay" : key == OPTION_ROUND_TRIP ? "--round-trip" : NULL; }

/* Returns the name of an option that makes no sense when checking a profile; NULL for any other. */
static const char *play_option(int key) {
    switch (key) {
    case OPTION_HAND:
    case OPTION_REPORT: return NULL;
    case OPTION_PLAN: return "--plan";
    case OPTION_SPEED: return "--speed";
    case OPTION_CSV: return "--csv";
    case OPTION_URL: return "--lcm-url";
    case OPTION_REALTIME: return "--realtime";
    case OPTION_WAIT: return "--wait";
    case OPTION_SETTLE: return "--settle";
    default: return script_option(key);
    }
}

static bool parse_operator(const struct argp_state *state, const char *kind) {
    if (strcmp(kind, "image") != 0 && strcmp(kind, "marks") != 0) argp_error(state, "--operator: no operator '%s': expected marks or image", kind);
    return strcmp(kind, "image") == 0;
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    if (script_option(key)) o->script_option = script_option(key);
    if (plan_option(key)) o->plan_option = plan_option(key);
    if (image_option(key)) o->image_option = image_option(key);
    if (check_option(key)) o->check_option = check_option(key);
    if (play_option(key)) o->play_option = play_option(key);
    switch (key) {
    case 's': o->play.script = parse_script(state, text); break;
    case 'r': o->play.rate = parse_number(state, "rate", text, 1, 20000); break;
    case 'd': o->play.duration = parse_number(state, "duration", text, 1e-3, 1e5); break;
    case OPTION_SPEED: o->play.speed = parse_number(state, "speed", text, 1e-3, 10); break;
    case OPTION_SCENE: o->scene_path = text; break;
    case OPTION_START:
        o->play.start.position = parse_vector(state, "start", text);
        o->start_given = true;
        break;
    case OPTION_PATIENT: o->patient = true; break;
    case OPTION_PLAN: o->plan_path = text; break;
    case OPTION_OPERATOR: o->follows_image = parse_operator(state, text); break;
    case OPTION_STRANDS: o->strands = true; break;
    case OPTION_STABILISE: o->stabilise = text; break;
    case OPTION_SEED: o->seed = parse_index(state, "seed", text); break;
    case OPTION_IMAGE_ERROR: o->image_error = parse_number(state, "image-error", text, 0, 0.1); break;
    case OPTION_SPLAY: o->splay = parse_number(state, "splay", text, 0, 0.5); break;
    case OPTION_SPEED_SPREAD: o->speed_spread = parse_number(state, "speed-spread", text, 0, 3); break;
    case OPTION_ERRORS: o->errors_path = text; break;
    case OPTION_NEEDLE: o->play.needle = parse_index(state, "needle", text); break;
    case OPTION_HAND:
        o->play.hand = parse_hand(state, text);
        o->play.closed_loop = true;
        o->check.mass = o->play.hand.mass;
        o->check.damping = o->play.hand.damping;
        o->check.stiffness = o->play.hand.stiffness;
        break;
    case OPTION_PROFILE: o->check.profile = text; break;
    case OPTION_DEVICE_DELAY: o->check.device_delay = parse_number(state, "device-delay", text, 0, 0.1); break;
    case OPTION_ROUND_TRIP: o->check.round_trip = parse_number(state, "round-trip", text, 0, 0.1); break;
    case OPTION_URL: o->play.lcm_url = text; break;
    case OPTION_REALTIME: o->play.realtime = true; break;
    case OPTION_WAIT: o->play.patience = parse_number(state, "wait", text, 0.01, 3600); break;
    case OPTION_SETTLE: o->play.settle = parse_number(state, "settle", text, 0, 60); break;
    case OPTION_REPORT: o->report_path = text; break;
    case OPTION_CSV: o->csv_path = text; break;
    case OPTION_LOG: o->log_path = text; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (o->log_path && (o->csv_path || o->report_path || o->play.closed_loop))
            argp_error(state, "--write-log plays without a server: it cannot be combined with --csv, --report or --hand");
        if (o->plan_path && !o->scene_path) argp_error(state, "--plan needs --scene");
        if (o->plan_path && o->script_option) argp_error(state, "--plan cannot be combined with %s", o->script_option);
        if (o->plan_option && !o->plan_path) argp_error(state, "%s needs --plan", o->plan_option);
        if (o->image_option && !o->follows_image) argp_error(state, "%s needs --operator image", o->image_option);
        if (o->patient && !o->scene_path) argp_error(state, "--patient needs --scene");
        if (o->check_option && !o->check.profile) argp_error(state, "%s needs --profile", o->check_option);
        if (o->play_option && o->check.profile) argp_error(state, "--profile sends no poses: it cannot be combined with %s", o->play_option);
        break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Plays a motion of the needle's base, or an implant, to trocar-server over LCM and reports round trips, losses and forces.",
    NULL, NULL, NULL};

static trocar_status write_poses(const play_settings *s, lcm_eventlog_t *log, const char *path, trocar_error *why) {
    static const int64_t epoch = INT64_C(1000000000000000);  /* us, timestamp of the first pose; fixed, so that logs are reproducible */
    static const int64_t session = 1;
    int64_t count = (int64_t)floor(s->duration * s->rate + 1e-9) + 1;
    for (int64_t k = 0; k < count; k++) {
        double t = (double)k / s->rate;
        pose base = motion_pose(s->script, s->start, t * s->speed);
        trocar_needle_pose_t message = message_of_pose(base, epoch + llround(1e6 * t), session, k);
        message.needle = s->needle;
        trocar_status status = log_write_pose(log, &message, path, why);
        if (status != TROCAR_OK) return status;
    }
    return TROCAR_OK;
}

static trocar_status write_log(const options *o, trocar_error *why) {
    output place;
    trocar_status status = output_open(&place, o->log_path, why);
    if (status != TROCAR_OK) return status;
    lcm_eventlog_t log = {.f = place.file};
    status = write_poses(&o->play, &log, o->log_path, why);
    if (status == TROCAR_OK) status = output_commit(&place, why);
    output_abandon(&place);
    return status;
}

static trocar_status play_and_report(const options *o, const patient_frame *patient, output *report_file, output *csv_file, recording *r, trocar_error *why) {
    recording_summary summary;
    trocar_status status = play(&o->play, r, why);
    if (status == TROCAR_OK) status = recording_summarise(r, &summary, why);
    if (status != TROCAR_OK) return status;
    summary_print(&summary, stdout);
    if (report_file->file) summary_write_json(&summary, report_file->file);
    if (csv_file->file) recording_write_csv(r, patient, csv_file->file);
    status = output_commit(report_file, why);
    return status == TROCAR_OK ? output_commit(csv_file, why) : status;
}

/* Opens the output files before anything else, so that a bad path is reported at once. */
static trocar_status run_live(const options *o, const patient_frame *patient, trocar_error *why) {
    output report_file = {0}, csv_file = {0};
    recording r = {0};
    trocar_status status = TROCAR_OK;
    if (o->report_path) status = output_open(&report_file, o->report_path, why);
    if (status == TROCAR_OK && o->csv_path) status = output_open(&csv_file, o->csv_path, why);
    if (status == TROCAR_OK) status = play_and_report(o, patient, &report_file, &csv_file, &r, why);
    output_abandon(&report_file);
    output_abandon(&csv_file);
    recording_free(&r);
    return status;
}

static void say_aside(const implant_plan *plan, const char *path) {
    static const double rounding = 1e-5; /* m */
    if (plan->greatest_aside > rounding)
        fprintf(stderr, "trocar-device: %s: seeds are up to %.2f mm off the axes of their holes and will be dropped on the axes\n", path, 1e3 * plan->greatest_aside);
}

static trocar_operator_options operator_options(const options *o) {
    trocar_operator_options chosen = trocar_default_operator_options(o->follows_image);
    if (o->seed >= 0) chosen.seed = (uint64_t)o->seed;
    if (o->image_error >= 0) chosen.image_error = o->image_error;
    if (o->splay >= 0) chosen.splay = o->splay;
    if (o->speed_spread >= 0) chosen.speed_spread = o->speed_spread;
    chosen.speed *= o->play.speed;
    chosen.strands = o->strands;
    return chosen;
}

static void print_implant(const implant_plan *plan, const implant_summary *done, const implant_errors *errors) {
    printf("implant             %d needles, %d seeds in %.0f s\n", done->needles, done->seeds, done->duration);
    printf("repeated            %d commands to drop a seed, because the previous seed was still in the needle\n", done->repeats);
    printf("greatest drag       %+.1f mm while it rested, of the needle in hole %s\n", 1e3 * done->greatest_drag, plan->needles[done->greatest_drag_needle].hole);
    printf("greatest force      %.2f N, in hole %s\n", done->greatest_force, plan->needles[done->greatest_force_needle].hole);
    implant_errors_print(errors, stdout);
}

static trocar_status carry_out(const options *o, const implant_plan *plan, trocar_operator *op, implant_watch *watch, output *csv, output *errors_file,
                               trocar_error *why) {
    static implant_errors errors;
    const play_settings *play = &o->play;
    implant_play how = {.lcm_url = play->lcm_url, .rate = play->rate, .patience = play->patience, .settle = play->settle, .realtime = play->realtime, .csv = csv->file};
    implant_summary done;
    trocar_status status = implant_carry_out(plan, op, &how, watch, &done, why);
    if (status != TROCAR_OK) return status;
    implant_errors_find(plan, op, watch, &errors);
    print_implant(plan, &done, &errors);
    if (errors_file->file) implant_errors_write_csv(&errors, plan, errors_file->file);
    status = output_commit(errors_file, why);
    return status == TROCAR_OK ? output_commit(csv, why) : status;
}

static trocar_status read_plan(const options *o, implant_plan *plan, trocar_operator **op, trocar_error *why) {
    trocar_scene *scene;
    trocar_model *model = NULL;
    trocar_operator_options chosen = operator_options(o);
    trocar_status status = trocar_scene_load(o->scene_path, &scene, why);
    if (status != TROCAR_OK) return status;
    status = trocar_model_create(scene, &(trocar_model_options){.mesh_only = 1}, &model, why);
    if (status == TROCAR_OK) status = implant_plan_read(model, o->plan_path, plan, why);
    if (status == TROCAR_OK && o->stabilise) status = implant_plan_stabilise(model, o->stabilise, plan, why);
    if (status == TROCAR_OK) status = implant_plan_operator(model, plan, &chosen, o->plan_path, op, why);
    trocar_model_free(model);
    trocar_scene_free(scene);
    return status;
}

static trocar_status run_implant(const options *o, trocar_error *why) {
    static implant_plan plan;
    static implant_watch watch;
    trocar_operator *op = NULL;
    output csv = {0}, errors = {0};
    trocar_status status = read_plan(o, &plan, &op, why);
    if (status == TROCAR_OK) say_aside(&plan, o->plan_path);
    if (status == TROCAR_OK && o->csv_path) status = output_open(&csv, o->csv_path, why);
    if (status == TROCAR_OK && o->errors_path) status = output_open(&errors, o->errors_path, why);
    if (status == TROCAR_OK) status = implant_watch_open(&watch, o->play.lcm_url, plan.node_count, why);
    if (status == TROCAR_OK) status = carry_out(o, &plan, op, &watch, &csv, &errors, why);
    implant_watch_close(&watch);
    trocar_operator_free(op);
    output_abandon(&errors);
    output_abandon(&csv);
    return status;
}

/* Takes the start pose, the depth and the patient frame from the scene, if there is one. */
static trocar_status choose_start(options *o, patient_frame *patient, trocar_error *why) {
    static motion script;
    trocar_scene *scene;
    double depth = MOTION_DEPTH;
    vec3 given = o->play.start.position;
    if (!o->scene_path) return TROCAR_OK;
    trocar_status status = trocar_scene_load(o->scene_path, &scene, why);
    if (status != TROCAR_OK) return status;
    if (o->patient) status = patient_frame_read(scene, patient, why);
    if (status == TROCAR_OK && !find_start(scene, o->patient ? patient : NULL, o->start_given ? &given : NULL, &o->play.start))
        status = fail(why, TROCAR_BAD_INPUT, "%s: has no needle.start: add it, or give --start", o->scene_path);
    if (status == TROCAR_OK) status = trocar_scene_get_number(scene, "needle.start.depth", &depth, why);
    trocar_scene_free(scene);
    if (depth != MOTION_DEPTH) {
        script = motion_to_depth(o->play.script, depth);
        o->play.script = &script;
    }
    return status;
}

/* Checks a device profile and prints the result. Returns SYSTEM if the profile is unsuitable. */
static trocar_status check_profile(options *o, trocar_error *why) {
    static profile_result result;
    output report_file = {0};
    o->check.scene = o->scene_path;
    o->check.rate = o->play.rate;
    trocar_status status = o->report_path ? output_open(&report_file, o->report_path, why) : TROCAR_OK;
    if (status == TROCAR_OK) status = profile_check(&o->check, &result, why);
    if (status == TROCAR_OK && report_file.file) {
        profile_write_json(&result, report_file.file);
        status = output_commit(&report_file, why);
    }
    output_abandon(&report_file);
    if (status != TROCAR_OK || profile_print(&result, stdout)) return status;
    return fail(why, TROCAR_SYSTEM, "%s: not suitable for this device", o->check.profile);
}

static trocar_status send_poses(options *o, trocar_error *why) {
    patient_frame patient;
    trocar_status status = choose_start(o, &patient, why);
    if (status != TROCAR_OK) return status;
    if (o->play.duration == 0) o->play.duration = o->play.script->duration / o->play.speed;
    return o->log_path ? write_log(o, why) : run_live(o, o->patient ? &patient : NULL, why);
}

int main(int count, char **arguments) {
    options o = {.play = {.script = motion_find("figure8"), .start = MOTION_START, .rate = 1000,
                          .speed = 1, .patience = 5, .settle = 0.3},
                 .seed = -1, .image_error = -1, .splay = -1, .speed_spread = -1,
                 .check = {.mass = -1, .damping = -1, .stiffness = -1, .device_delay = -1, .round_trip = 1e-3}};
    argp_parse(&parser, count, arguments, 0, NULL, &o);

    trocar_error why;
    trocar_status status = o.check.profile ? check_profile(&o, &why) : o.plan_path ? run_implant(&o, &why) : send_poses(&o, &why);
    if (status == TROCAR_OK) return EXIT_SUCCESS;
    fprintf(stderr, "trocar-device: %s\n", why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
