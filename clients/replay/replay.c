/* trocar-replay: simulates a recorded pose log in lockstep, one tick per pose, without a network or a clock. By default it replays a single needle, which
   becomes needle 0 of the simulation whatever its index, because all needles have the same properties. With --all, it replays every needle in the log, with the
   commands that leave, take and reset needles. */
#include <inttypes.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/handover.h"
#include "common/messages.h"
#include "common/progress.h"
#include "replay/comparison.h"
#include "replay/pvd.h"
#include "replay/region_motion.h"
#include "replay/seed_table.h"
#include "replay/tick_row.h"
#include "replay/vtu.h"
#include "shared/events.h"
#include "shared/options.h"
#include "shared/output.h"
#include "shared/patient.h"
#include "shared/poselog.h"
#include "shared/command_replay.h"
#include "trocar.h"

const char *argp_program_version = "trocar-replay " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

typedef struct {
    const char *scene_path, *pose_path, *log_path, *csv_path, *json_path, *vtu_prefix, *pvd_prefix, *golden_path, *shift_path, *region, *seeds_path;
    double at;               /* s after the first pose; NaN for the last pose */
    double tolerance;        /* as a fraction of the component's peak */
    int needle;              /* needle to replay; -1 for that of the first pose */
    int every;               /* log only every Nth wrench; 0 logs all */
    bool quiet, patient, all;
} options;

/* A needle replayed with --all. */
typedef struct {
    bool begun;              /* true once a pose of `session` has reset the needle */
    bool taken;              /* true if the next pose continues the insertion from where the needle rested */
    int64_t session, utime;  /* of the needle's last pose */
    hand_clutch clutch;      /* offset between the needle and the hand that has taken it */
    waiting_drop waiting;
} replayed_needle;

typedef struct {
    const options *options;
    trocar_scene *scene;
    patient_frame frame;     /* for --patient */
    const patient_frame *patient; /* coordinates of the output files: &frame, or NULL for mesh coordinates */
    pose_log poses;          /* counts and commands in the log */
    pose_stream *stream;     /* the poses in the log, read one after another */
    pose_step now;
    int64_t before;          /* utime of the previous pose */
    trocar_model *model;
    trocar_sim *sim;
    trocar_output result;              /* of the last tick */
    trocar_picture *picture;           /* snapshot of the state, for --vtu and --pvd */
    double *displacements;             /* m, 3 per node of the mesh, for --shift; otherwise NULL */
    output log_file, csv_file, json_file, shift_file, seeds_file;
    region_motion motion;
    comparison comparison;
    pvd_series series;
    bool dumped;             /* true once --vtu has written its state */
    int64_t logged;          /* events written to log_file so far */
    bool has_probe;          /* true if the scene has a probe */
    int commands_done;       /* commands in the log that have been handled */
    int refused, refused_before; /* commands refused in this replay, and those that the server had already refused */
    trocar_error refusal;    /* why the first command was refused in this replay */
    replayed_needle needles[TROCAR_MAX_NEEDLES];
    waiting_change change;
    int gaps;                /* gaps longer than POSE_LOG_GAP */
} replay;

/* ---- command line ------------------------------------------------------------------------------------------------ */

enum {
    OPTION_OUT = 256, OPTION_EVERY, OPTION_CSV, OPTION_VTU, OPTION_PVD, OPTION_AT, OPTION_COMPARE, OPTION_TOLERANCE,
    OPTION_SHIFT, OPTION_REGION, OPTION_NEEDLE, OPTION_PATIENT, OPTION_SEEDS, OPTION_ALL, OPTION_JSON
};

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene (required)", 0},
    {"poses", 'p', "FILE", 0, "LCM event log with poses on TROCAR_POSE (required)", 0},
    {"needle", OPTION_NEEDLE, "N", 0, "Replay only needle N of a log with several (default: the needle of the first pose)", 0},
    {"all", OPTION_ALL, 0, 0, "Replay all needles of the log, and its commands: a whole implant (not with --needle, --every and --compare)", 0},
    {"out", OPTION_OUT, "FILE", 0, "Write poses and wrenches as an LCM event log", 0},
    {"every", OPTION_EVERY, "N", 0, "Write only every Nth wrench, and no poses, to --out: a small golden log", 0},
    {"csv", OPTION_CSV, "FILE", 0, "Write one row per tick: time, base force and torque, depth, contacts, events, needle, positions of base and tip, the tip's roll minus the base's; in a scene with a probe, also its force on the hand, torque, contacts and position", 0},
    {"json-lines", OPTION_JSON, "FILE", 0, "Write the same as --csv as one JSON object per line", 0},
    {"vtu", OPTION_VTU, "PREFIX", 0, "Write PREFIX-tissue.vtu, PREFIX-needle.vtu and, in scenes with a probe or with membranes that are stiff in their plane, PREFIX-probe.vtu and PREFIX-membranes.vtu", 0},
    {"pvd", OPTION_PVD, "PREFIX", 0, "Write a time series for ParaView, 30 states per second: PREFIX.pvd and its .vtu files", 0},
    {"at", OPTION_AT, "SECONDS", 0, "Time of the state that --vtu writes, counted from the first pose (default: the end)", 0},
    {"compare", OPTION_COMPARE, "GOLDEN", 0,
     "Compare with the wrenches in an LCM event log, written by --out or recorded; exit status 1 if they differ", 0},
    {"tolerance", OPTION_TOLERANCE, "PERCENT", 0,
     "Allowed difference, relative to each component's peak in GOLDEN or to 0.1 N and 2 mN m if the peak is smaller (default 1)", 0},
    {"shift", OPTION_SHIFT, "FILE", 0, "Write shift and rotation of a region and its parts, the best rigid fit of their nodes, one row per tick", 0},
    {"region", OPTION_REGION, "NAME", 0, "Region for --shift (default: the scene's first)", 0},
    {"seeds", OPTION_SEEDS, "FILE", 0, "Write the seeds that the log's commands have left in the tissue, one row each: place and direction at the end and in the tissue at rest", 0},
    {"patient", OPTION_PATIENT, 0, 0, "Write files in the patient's coordinates (DICOM axes, positions in mm); the log keeps the mesh's", 0},
    {"quiet", 'q', 0, 0, "Print no progress bar and no summary", 0},
    {0},
};

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 's': o->scene_path = text; break;
    case 'p': o->pose_path = text; break;
    case OPTION_NEEDLE: o->needle = parse_index(state, "needle", text); break;
    case OPTION_OUT: o->log_path = text; break;
    case OPTION_CSV: o->csv_path = text; break;
    case OPTION_JSON: o->json_path = text; break;
    case OPTION_VTU: o->vtu_prefix = text; break;
    case OPTION_PVD: o->pvd_prefix = text; break;
    case OPTION_AT: o->at = parse_number(state, "at", text, 0, 1e6); break;
    case OPTION_EVERY: o->every = parse_whole(state, "every", text, 1, 1000000); break;
    case OPTION_COMPARE: o->golden_path = text; break;
    case OPTION_TOLERANCE: o->tolerance = 0.01 * parse_number(state, "tolerance", text, 0, 100); break;
    case OPTION_SHIFT: o->shift_path = text; break;
    case OPTION_REGION: o->region = text; break;
    case OPTION_SEEDS: o->seeds_path = text; break;
    case OPTION_PATIENT: o->patient = true; break;
    case OPTION_ALL: o->all = true; break;
    case 'q': o->quiet = true; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (!o->scene_path) argp_error(state, "--scene is missing");
        if (!o->pose_path) argp_error(state, "--poses is missing");
        if (!isnan(o->at) && !o->vtu_prefix) argp_error(state, "--at needs --vtu");
        if (o->region && !o->shift_path) argp_error(state, "--region needs --shift");
        if (o->every && !o->log_path) argp_error(state, "--every needs --out");
        if (o->all && (o->needle >= 0 || o->every || o->golden_path)) argp_error(state, "--all cannot be combined with --needle, --every or --compare");
        if (!isnan(o->tolerance) && !o->golden_path) argp_error(state, "--tolerance needs --compare");
        break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Runs recorded poses through the simulation in lockstep: one tick per pose, model time = the poses' utime. The same binary "
    "gives bit-identical results. The probe moves with the log's TROCAR_PROBE.\vExit status: 0, 1 if it failed or differs from GOLDEN, 2 for bad input.", NULL, NULL, NULL};

/* ---- set-up ------------------------------------------------------------------------------------------------------ */

/* Returns the time of the current pose, in s since the first. */
static double time_of(const replay *r, const trocar_needle_pose_t *pose) { return 1e-6 * (double)(pose->utime - r->poses.first.utime); }

static trocar_status check_dump_time(const replay *r, trocar_error *why) {
    double end = time_of(r, &r->poses.last);
    if (isnan(r->options->at) || r->options->at <= end) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: --at %g s is after the last pose at %g s", r->options->pose_path, r->options->at, end);
}

/* True if --vtu must write the state now: after the first tick at or after --at in which a needle moves. */
static bool dump_is_due(const replay *r, int tick) {
    if (!r->options->vtu_prefix || r->dumped) return false;
    return isnan(r->options->at) ? tick == r->poses.count - 1 : time_of(r, &r->now.pose) >= r->options->at;
}

static trocar_status open_outputs(replay *r, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    if (r->options->log_path) status = output_open(&r->log_file, r->options->log_path, why);
    if (status == TROCAR_OK && r->options->csv_path) status = output_open(&r->csv_file, r->options->csv_path, why);
    if (status == TROCAR_OK && r->options->json_path) status = output_open(&r->json_file, r->options->json_path, why);
    if (status == TROCAR_OK && r->options->pvd_prefix) status = pvd_open(&r->series, r->options->pvd_prefix, why);
    if (status == TROCAR_OK && r->options->shift_path) status = output_open(&r->shift_file, r->options->shift_path, why);
    if (status == TROCAR_OK && r->options->seeds_path) status = output_open(&r->seeds_file, r->options->seeds_path, why);
    if (r->shift_file.file)
        fprintf(r->shift_file.file, "t [s],%s,superior [mm],sagittal [deg],coronal [deg],axial [deg]\n",
                r->patient ? "left [mm],posterior [mm]" : "right [mm],anterior [mm]");
    return status;
}

/* Prepares to track the motion of the chosen region, which by default is the scene's first. */
static trocar_status prepare_shift(replay *r, trocar_error *why) {
    char region[256];
    r->displacements = malloc(3 * (size_t)trocar_model_node_count(r->model) * sizeof *r->displacements);
    if (!r->displacements) return fail(why, TROCAR_NO_MEMORY, "no memory for displacements");
    trocar_status status = trocar_scene_get(r->scene, "regions[0].name", region, sizeof region, why);
    if (status != TROCAR_OK) return status;
    trocar_error reason;
    status = region_motion_create(r->model, r->options->region ? r->options->region : region, &r->motion, &reason);
    return status == TROCAR_OK ? status : fail(why, status, "%s: %.900s", r->options->scene_path, reason.text);
}

static trocar_status create_simulation(replay *r, trocar_error *why) {
    trocar_model_options options = trocar_default_model_options();
    options.watch.progress = r->options->quiet ? NULL : progress_show;
    options.log = (trocar_log){r->options->quiet ? progress_warn : progress_log, "trocar-replay"};
    trocar_status status = trocar_model_create(r->scene, &options, &r->model, why);
    if (status == TROCAR_OK) status = trocar_sim_create(r->model, &r->sim, why);
    if (status == TROCAR_OK) status = trocar_picture_create(r->model, &r->picture, why);
    if (status != TROCAR_OK) return status;
    trocar_probe_shape ignored;
    r->has_probe = trocar_model_probe(r->model, &ignored) == 1;
    if (r->csv_file.file) tick_row_csv_head(r->csv_file.file, patient_unit(r->patient), r->has_probe);
    return r->options->shift_path ? prepare_shift(r, why) : TROCAR_OK;
}

static trocar_status prepare(replay *r, trocar_error *why) {
    trocar_status status = trocar_scene_load(r->options->scene_path, &r->scene, why);
    const options *o = r->options;
    if (status == TROCAR_OK) status = pose_log_scan(o->pose_path, o->needle, o->all, &r->poses, why);
    if (status == TROCAR_OK) status = check_dump_time(r, why);
    if (status == TROCAR_OK) status = pose_stream_open(o->pose_path, o->needle, o->all, &r->stream, why);
    if (status == TROCAR_OK && o->patient) {
        status = patient_frame_read(r->scene, &r->frame, why);
        r->patient = &r->frame;
    }
    if (status == TROCAR_OK && o->golden_path) status = comparison_begin(&r->comparison, o->golden_path, r->poses.first.session, o->tolerance, why);
    if (status == TROCAR_OK) status = open_outputs(r, why);
    return status == TROCAR_OK ? create_simulation(r, why) : status;
}

static void clean_up(replay *r) {
    output_abandon(&r->log_file);
    output_abandon(&r->csv_file);
    output_abandon(&r->json_file);
    pvd_abandon(&r->series);
    output_abandon(&r->shift_file);
    output_abandon(&r->seeds_file);
    region_motion_free(&r->motion);
    trocar_picture_free(r->picture);
    end_waiting_change(&r->change);
    trocar_sim_free(r->sim);
    trocar_model_free(r->model);
    trocar_scene_free(r->scene);
    free(r->displacements);
    comparison_free(&r->comparison);
    pose_stream_close(r->stream);
    pose_log_free(&r->poses);
}

/* ---- the run ----------------------------------------------------------------------------------------------------- */

static trocar_needle_wrench_t message_of_tick(const replay *r, int tick) {
    const trocar_needle_pose_t *p = &r->now.pose;
    trocar_needle_wrench_t m = wrench_message(&r->result);
    m.utime = m.pose_utime = p->utime;
    m.tick = tick;
    m.session = p->session;
    m.pose_seq = p->seq;
    m.needle = p->needle;
    return m;
}

static lcm_eventlog_t log_at(const replay *r) { return (lcm_eventlog_t){.f = r->log_file.file, .eventcount = r->logged}; }

static trocar_status log_tick(replay *r, int tick, const trocar_needle_wrench_t *wrench, trocar_error *why) {
    const char *path = r->options->log_path;
    int every = r->options->every;
    lcm_eventlog_t log = log_at(r);
    trocar_status status = TROCAR_OK;
    if (!every) status = log_write_pose(&log, &r->now.pose, path, why);
    if (status == TROCAR_OK && (!every || tick % every == 0)) status = log_write_wrench(&log, wrench, path, why);
    r->logged = log.eventcount;
    return status;
}

/* Starts the log with a status that names the scene and the type of inverse. In the log, a needle has its index from the recording, which may not exist in the
   scene. */
static trocar_status log_origin(replay *r, trocar_error *why) {
    int needles = trocar_model_needles(r->model), needle = r->poses.needle;
    lcm_eventlog_t log = log_at(r);
    r->logged++;
    trocar_status_t m = {.utime = r->poses.first.utime, .host = "", .scene = (char *)(uintptr_t)trocar_scene_path(r->scene),
                         .inverse = (char *)(uintptr_t)trocar_model_inverse(r->model), .message = "", .needle = needle,
                         .needle_count = needle < needles ? needles : needle + 1};
    return log_write_status(&log, &m, r->options->log_path, why);
}

/* Returns the index that the current pose's needle has in the simulation. */
static int needle_of(const replay *r) { return r->options->all ? r->now.pose.needle : 0; }

static void add_probe(const replay *r, tick_row *row) {
    trocar_probe p = trocar_view_probe(trocar_sim_view(r->sim));
    row->probe_force = axes_to_patient(r->patient, load_vec3(p.force));
    row->probe_torque = axes_to_patient(r->patient, load_vec3(p.torque));
    row->probe_contacts = p.contacts;
    row->probe_placed = p.placed;
    row->probe_base = mesh_to_patient(r->patient, load_vec3(p.base.position));
}

static void write_row(const replay *r) {
    int needle = needle_of(r);
    const trocar_output *w = &r->result;
    const trocar_view *view = trocar_sim_view(r->sim);
    char key[64], membrane[256] = "";
    snprintf(key, sizeof key, "membranes[%d].name", w->membrane);
    if (w->membrane >= 0) trocar_scene_get(r->scene, key, membrane, sizeof membrane, NULL);
    double joints[TROCAR_MAX_JOINTS][3];
    int count = trocar_view_centreline(view, needle, joints[0], TROCAR_MAX_JOINTS);
    tick_row row = {.time = time_of(r, &r->now.pose), .force = axes_to_patient(r->patient, load_vec3(w->force)),
                    .torque = axes_to_patient(r->patient, load_vec3(w->torque)), .depth = w->depth, .contacts = w->contacts,
                    .needle = r->now.pose.needle, .tip_lead = trocar_view_tip_lead(view, needle),
                    .base = mesh_to_patient(r->patient, load_vec3(trocar_view_base(view, needle).position)),
                    .tip = mesh_to_patient(r->patient, load_vec3(joints[count - 1])), .unit = patient_unit(r->patient), .has_probe = r->has_probe};
    events_text(w->events, membrane, row.events, sizeof row.events);
    if (r->has_probe) add_probe(r, &row);
    if (r->csv_file.file) tick_row_csv(&row, r->csv_file.file);
    if (r->json_file.file) tick_row_json(&row, r->json_file.file);
}

/* Writes the motion of the region. A rotation in the sagittal, coronal or axial plane is one about that plane's normal. */
static trocar_status shift_tick(replay *r, trocar_error *why) {
    trocar_status status = trocar_view_displacements(trocar_sim_view(r->sim), r->displacements, why);
    if (status != TROCAR_OK) return status;
    rigid_motion m = region_motion_of(&r->motion, r->displacements);
    m = (rigid_motion){axes_to_patient(r->patient, m.shift), axes_to_patient(r->patient, m.turn)};
    const double mm = 1e3, degrees = 180 / M_PI;
    fprintf(r->shift_file.file, "%.6f,%.6f,%.6f,%.6f,%.6f,%.6f,%.6f\n", time_of(r, &r->now.pose), mm * m.shift.x, mm * m.shift.y,
            mm * m.shift.z, degrees * m.turn.x, degrees * m.turn.y, degrees * m.turn.z);
    return TROCAR_OK;
}

static trocar_status export_state(replay *r, trocar_error *why) {
    trocar_sim_take_picture(r->sim, r->picture);
    trocar_status status = vtu_write_tissue(r->model, r->picture, r->patient, r->options->vtu_prefix, why);
    if (status == TROCAR_OK) status = vtu_write_needle(r->model, r->picture, &r->result, r->patient, r->options->vtu_prefix, why);
    return status == TROCAR_OK ? vtu_write_probe(r->model, r->picture, r->patient, r->options->vtu_prefix, why) : status;
}

static trocar_status add_to_series(replay *r, double time, trocar_error *why) {
    if (!pvd_is_due(&r->series, time)) return TROCAR_OK;
    trocar_sim_take_picture(r->sim, r->picture);
    return pvd_take(&r->series, r->model, r->picture, &r->result, r->patient, time, why);
}

/* ---- all needles ------------------------------------------------------------------------------------------------- */

static trocar_status carry_out(replay *r, const logged_command *logged, trocar_error *why) {
    const trocar_command_t *c = &logged->command;
    int needle = r->options->all ? c->needle : 0;
    replayed_needle *n = &r->needles[needle];
    trocar_status status;
    if (logged->change) return replay_change(&r->change, r->sim, logged, why);
    if (r->options->all && n->begun && c->session != n->session)
        return fail(why, TROCAR_BAD_INPUT, "needle %d: another session holds the needle", needle);
    switch (c->command) {
    case TROCAR_COMMAND_T_DROP_SEED:
    case TROCAR_COMMAND_T_UNDO: return replay_seed_command(&n->waiting, r->sim, needle, logged, why);
    case TROCAR_COMMAND_T_LEAVE:
        status = trocar_sim_leave(r->sim, needle, why);
        if (status == TROCAR_OK) status = trocar_sim_work(r->sim, NULL, why);
        if (status == TROCAR_OK) n->begun = false; /* nobody holds the needle now */
        return status;
    case TROCAR_COMMAND_T_TAKE:
        status = trocar_sim_take(r->sim, needle, why);
        if (status == TROCAR_OK) status = trocar_sim_work(r->sim, NULL, why);
        if (status == TROCAR_OK) n->taken = true;
        return status;
    case TROCAR_COMMAND_T_CLEAR: /* without `all`, only seed commands are replayed, and so only what this one does to seeds */
        status = replay_seed_command(&n->waiting, r->sim, needle, logged, why);
        if (status != TROCAR_OK || !r->options->all) return status;
        /* fall through */
    case TROCAR_COMMAND_T_RESET:
        n->begun = n->taken = false;
        return remove_needle(r->sim, needle, why);
    case TROCAR_COMMAND_T_RELEASE:
        n->begun = false;
        return TROCAR_OK;
    default: return TROCAR_OK;
    }
}

static void note_refusal(replay *r, const trocar_error *reason) {
    if (r->refused++ == 0) r->refusal = *reason;
}

/* Executes a needle's pending drop if that is possible now; otherwise counts it as refused. `next`: the needle's next command, or NULL. */
static void end_waiting(replay *r, int needle, const logged_command *next) {
    waiting_drop *w = &r->needles[needle].waiting;
    if (!end_waiting_drop(w, r->sim, needle, next)) note_refusal(r, &w->reason);
}

static void try_again(replay *r, int needle) {
    waiting_drop *w = &r->needles[needle].waiting;
    if (!try_waiting_drop(w, r->sim, needle)) note_refusal(r, &w->reason);
}

static trocar_status log_command(replay *r, const logged_command *logged, trocar_error *why) {
    lcm_eventlog_t log = log_at(r);
    trocar_status status = logged->change ? log_write_change(&log, logged, r->options->log_path, why) : log_write_command(&log, &logged->command, r->options->log_path, why);
    if (status == TROCAR_OK && logged->answer != ANSWER_UNKNOWN)
        status = log_write_reply(&log, &logged->command, logged->answer == ANSWER_DONE, r->options->log_path, why);
    r->logged = log.eventcount;
    return status;
}

/* Executes a command. As in the server, a refused command changes nothing. */
static trocar_status run_command(replay *r, const logged_command *logged, trocar_error *why) {
    trocar_error reason;
    if (!logged->change) end_waiting(r, r->options->all ? logged->command.needle : 0, logged);
    bool refused_before = logged->answer == ANSWER_REFUSED;
    trocar_status status = refused_before ? TROCAR_OK : carry_out(r, logged, &reason);
    bool refused = status == TROCAR_BAD_INPUT || status == TROCAR_NUMERIC;
    if (status != TROCAR_OK && !refused) {
        *why = reason;
        return status;
    }
    r->refused_before += refused_before;
    if (refused) note_refusal(r, &reason);
    return r->log_file.file && !r->options->every ? log_command(r, logged, why) : TROCAR_OK;
}

/* Executes the commands that arrived before this pose. */
static trocar_status run_commands(replay *r, int pose, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    for (; status == TROCAR_OK && r->commands_done < r->poses.command_count && r->poses.commands[r->commands_done].next_pose <= pose; r->commands_done++)
        status = run_command(r, &r->poses.commands[r->commands_done], why);
    return status;
}

/* Decides, as the server does, whether to use a pose. Skips it (*dt = 0) if the needle is resting, or if another session holds it. A session that is silent for
   too long loses the needle. */
static trocar_status follow_needle(replay *r, trocar_pose *base, double *dt, trocar_error *why) {
    static const int64_t SILENCE = 2000000; /* us */
    const trocar_needle_pose_t *m = &r->now.pose;
    replayed_needle *n = &r->needles[m->needle];
    pose hand = pose_of_message(m);
    bool same = n->begun && m->session == n->session;
    double since = same && !n->taken ? 1e-6 * (double)(m->utime - n->utime) : 1.0 / trocar_model_rate(r->model);
    *dt = 0.0;
    if (trocar_sim_needle_state(r->sim, m->needle) != TROCAR_NEEDLE_HELD) return TROCAR_OK;
    if (n->begun && !same && m->utime - n->utime < SILENCE) return TROCAR_OK;
    *dt = fmin(since, POSE_LOG_GAP);
    r->gaps += since > POSE_LOG_GAP;
    trocar_pose at = trocar_view_base(trocar_sim_view(r->sim), m->needle);
    if (n->taken) n->clutch = clutch_engage(hand, &at);
    else if (!same) n->clutch.engaged = false;
    bool anew = !n->taken && !same;
    n->begun = true;
    n->taken = false;
    n->session = m->session;
    n->utime = m->utime;
    *base = library_pose(clutch_follow(&n->clutch, hand));
    if (!anew) return TROCAR_OK;
    end_waiting(r, m->needle, NULL);
    return trocar_sim_reset(r->sim, m->needle, base, why);
}

/* Moves the probe to its newest pose before this needle pose, and logs all probe poses since the previous one. */
static trocar_status follow_probe(replay *r, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    int count = r->now.probe_count;
    if (count > 0 && r->has_probe) {
        trocar_pose to = base_of_probe(&r->now.probes[count - 1]);
        status = trocar_sim_set_probe(r->sim, &to, why);
    }
    if (!r->log_file.file || r->options->every) return status;
    lcm_eventlog_t log = log_at(r);
    for (int i = 0; i < count && status == TROCAR_OK; i++) status = log_write_probe(&log, &r->now.probes[i], r->options->log_path, why);
    r->logged = log.eventcount;
    return status;
}

static trocar_status check_needles(const replay *r, trocar_error *why) {
    int needles = trocar_model_needles(r->model);
    if (r->poses.most_needle >= needles)
        return fail(why, TROCAR_BAD_INPUT, "%s: a pose or a command of needle %d: the scene's \"needles\" is %d", r->options->pose_path, r->poses.most_needle, needles);
    for (int i = 0; i < needles; i++) { /* until its first pose, each needle waits outside the tissue */
        trocar_pose away = {{0, 0, -10.0}, {1, 0, 0, 0}};
        trocar_status status = trocar_sim_reset(r->sim, i, &away, why);
        if (status != TROCAR_OK) return status;
    }
    return TROCAR_OK;
}

static trocar_status dump(replay *r, trocar_error *why) {
    r->dumped = true;
    return export_state(r, why);
}

/* Returns the length of a tick in s, as pose_log_interval does. */
static double interval_of(replay *r, int tick) {
    double dt = tick == 0 ? 1.0 / trocar_model_rate(r->model) : 1e-6 * (double)(r->now.pose.utime - r->before);
    if (tick == 0 || dt <= POSE_LOG_GAP) return dt;
    r->gaps++;
    return POSE_LOG_GAP;
}

static trocar_status run_tick(replay *r, int tick, trocar_error *why) {
    trocar_pose base = library_pose(pose_of_message(&r->now.pose));
    double dt = 0.0;
    trocar_error reason;
    try_again(r, needle_of(r));
    if (try_waiting_change(&r->change, r->sim, &reason) != TROCAR_OK) note_refusal(r, &reason);
    trocar_status status = run_commands(r, tick, why);
    if (status == TROCAR_OK) status = follow_probe(r, why);
    if (status != TROCAR_OK) return status;
    if (r->options->all) {
        status = follow_needle(r, &base, &dt, why);
        if (status != TROCAR_OK || dt == 0.0) return status;
    } else {
        dt = interval_of(r, tick);
    }
    status = trocar_sim_step(r->sim, needle_of(r), &base, dt, &r->result, why);
    if (status != TROCAR_OK) return status;
    if (r->csv_file.file || r->json_file.file) write_row(r);
    if (r->shift_file.file) status = shift_tick(r, why);
    trocar_needle_wrench_t message = message_of_tick(r, tick);
    if (status == TROCAR_OK && r->log_file.file) status = log_tick(r, tick, &message, why);
    if (status == TROCAR_OK && r->options->golden_path) status = comparison_add(&r->comparison, &message, why);
    if (status == TROCAR_OK && dump_is_due(r, tick)) status = dump(r, why);
    return status == TROCAR_OK ? add_to_series(r, time_of(r, &r->now.pose), why) : status;
}

static trocar_status run_all(replay *r, trocar_error *why) {
    enum { LONG_LOG = 5000 };
    bool progress = !r->options->quiet && isatty(STDERR_FILENO) && r->poses.count >= LONG_LOG;
    trocar_pose start = library_pose(pose_of_message(&r->poses.first));
    trocar_status status = r->options->all ? check_needles(r, why) : trocar_sim_reset(r->sim, 0, &start, why);
    if (status == TROCAR_OK && r->log_file.file) status = log_origin(r, why);
    for (int tick = 0; tick < r->poses.count && status == TROCAR_OK; tick++) {
        status = pose_stream_next(r->stream, &r->now, why);
        if (status == TROCAR_OK && r->now.ended) status = fail(why, TROCAR_BAD_INPUT, "%s: it was shortened while it was being replayed", r->options->pose_path);
        if (status == TROCAR_OK) status = run_tick(r, tick, why);
        r->before = r->now.pose.utime;
        if (progress) progress_show("replay", (double)(tick + 1) / r->poses.count, NULL);
    }
    if (status == TROCAR_OK) status = run_commands(r, r->poses.count, why);
    for (int i = 0; i < trocar_model_needles(r->model); i++) end_waiting(r, i, NULL);
    if (status == TROCAR_OK) status = pose_stream_next(r->stream, &r->now, why);
    if (status == TROCAR_OK) status = follow_probe(r, why);
    if (status == TROCAR_OK && r->options->vtu_prefix && !r->dumped) status = dump(r, why); /* no pose at or after --at moved a needle */
    if (status == TROCAR_OK && r->seeds_file.file) status = seed_table_write(r->seeds_file.file, r->scene, r->model, r->sim, r->patient, why);
    if (status == TROCAR_OK) status = output_commit(&r->seeds_file, why);
    if (status == TROCAR_OK) status = output_commit(&r->log_file, why);
    if (status == TROCAR_OK) status = output_commit(&r->csv_file, why);
    if (status == TROCAR_OK) status = output_commit(&r->json_file, why);
    if (status == TROCAR_OK) status = pvd_close(&r->series, why);
    if (status == TROCAR_OK) status = output_commit(&r->shift_file, why);
    return status == TROCAR_OK && r->options->golden_path ? comparison_end(&r->comparison, why) : status;
}

static void summarise(const replay *r) {
    double time = time_of(r, &r->poses.last);
    if (r->options->all) fprintf(stderr, "%d poses and %d commands, %d of them refused, over %.3f s\n", r->poses.count, r->commands_done, r->refused + r->refused_before, time);
    else fprintf(stderr, "%d poses of needle %d over %.3f s\n", r->poses.count, r->poses.needle, time);
    if (r->gaps) fprintf(stderr, "%d gaps longer than %g s counted as %g s\n", r->gaps, POSE_LOG_GAP, POSE_LOG_GAP);
    if (r->poses.skipped_sessions)
        fprintf(stderr, "%" PRId64 " poses of other needles and sessions skipped\n", r->poses.skipped_sessions);
    if (r->poses.skipped_old)
        fprintf(stderr, "%" PRId64 " repeated or late poses skipped\n", r->poses.skipped_old);
    if (r->poses.probe_count) fprintf(stderr, "%d poses of the probe%s\n", r->poses.probe_count, r->has_probe ? "" : " skipped: the scene has none (probe.surface)");
    if (r->poses.skipped_probes)
        fprintf(stderr, "%" PRId64 " poses of the probe skipped, as the server refuses them: out of order, not finite, or of a second session\n", r->poses.skipped_probes);
    int seeds = trocar_view_seeds(trocar_sim_view(r->sim), NULL, 0), changes = 0;
    for (int i = 0; i < r->poses.command_count; i++) changes += r->poses.commands[i].change != NULL;
    if (changes) fprintf(stderr, "%d changes of the tissue\n", changes);
    if (r->poses.command_count > changes) fprintf(stderr, "%d seeds\n", seeds);
    if (r->poses.skipped_commands)
        fprintf(stderr, "%" PRId64 " commands for seeds skipped: of other needles or sessions, or before the first pose\n", r->poses.skipped_commands);
}

/* Reports that the golden log was recorded with another type of inverse. Not silenced by --quiet, because it explains why the results are not bit-identical. */
static void name_other_owner(const replay *r) {
    const char *golden = r->comparison.inverse, *here = trocar_model_inverse(r->model);
    if (golden[0] == '\0' || strcmp(golden, here) == 0) return;
    fprintf(stderr, "%s: recorded with the %s inverse, replayed with the %s one: results agree only to rounding errors; for bit-identical results set "
            "`inverse: %s` in the scene\n", r->options->golden_path, golden, here, golden);
}

int main(int count, char **arguments) {
    options o = {.at = NAN, .tolerance = NAN, .needle = -1};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    if (isnan(o.tolerance)) o.tolerance = 0.01;
    static replay r;
    r.options = &o;
    trocar_error why;
    trocar_status status = prepare(&r, &why);
    if (status == TROCAR_OK) status = run_all(&r, &why);
    if (status == TROCAR_OK && !o.quiet) summarise(&r);
    if (r.refused) fprintf(stderr, "trocar-replay: %d of %d commands refused; the first: %s\n", r.refused, r.poses.command_count, r.refusal.text);
    if (status == TROCAR_OK && o.golden_path) name_other_owner(&r);
    bool differs = r.comparison.differing > 0;
    if (status == TROCAR_OK && o.golden_path && (differs || !o.quiet)) comparison_print(&r.comparison, stderr);
    clean_up(&r);
    if (status == TROCAR_OK) return differs ? EXIT_FAILURE : EXIT_SUCCESS;
    fprintf(stderr, "trocar-replay: %s\n", why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
