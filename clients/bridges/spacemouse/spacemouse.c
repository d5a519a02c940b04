/* trocar-spacemouse: drives a needle with a 3Dconnexion device or a joystick. The device's deflection sets the needle's velocity, as for a motorised
   needle holder. */
#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>

#include "common/messages.h"
#include "common/realtime.h"
#include "common/timing.h"
#include "device/playing.h"
#include "input.h"
#include "joystick.h"
#include "mapping.h"
#include "shared/motion.h"
#include "shared/options.h"
#include "shared/patient.h"
#include "shared/rate_control.h"
#include "spnav_device.h"
#include "trocar.h"
#include "trocar_client.h"

const char *argp_program_version = "trocar-spacemouse " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

static const double PATIENCE = 0.1;     /* s, stop the needle after this long without a wrench; the rendered force goes to zero sooner */
static const double SILENCE = 0.5;      /* s, tell the user after this long without a wrench */
static const double LONGEST_STEP = 0.01; /* s */

typedef struct {
    const char *scene_path, *lcm_url, *axes, *buttons;
    vec3 start;
    bool start_given, patient, use_joystick, realtime;
    const char *force_option;           /* name of an option given that applies only to joysticks, or NULL */
    int needle;
    double rate, max_speed, max_turn;   /* Hz, m/s, rad/s */
    joystick stick;
    spnav_device spnav;
    mapping map;
} options;

/* ---- command line ------------------------------------------------------------------------------------------------ */

enum { OPTION_AXES = 256, OPTION_BUTTONS, OPTION_DEAD_ZONE, OPTION_FULL_SCALE, OPTION_SPEED, OPTION_TURN, OPTION_FORCE, OPTION_LIMIT, OPTION_DIRECTION,
       OPTION_URL, OPTION_START, OPTION_REALTIME, OPTION_NEEDLE, OPTION_SCENE, OPTION_PATIENT };

static const struct argp_option option_list[] = {
    {"joystick", 'j', "FILE", OPTION_ARG_OPTIONAL, "A joystick instead of a 3Dconnexion device: /dev/input/event..., or the first in /dev/input/by-id", 0},
    {"axes", OPTION_AXES, "LIST", 0,
     "Axes of the device that move the needle (default right=x,up=y,forward=z,pitch=rx,yaw=ry,roll=rz; with --joystick "
     "forward=-y,right=x,up=-hat0y,roll=rz); other motions are disabled", 0},
    {"buttons", OPTION_BUTTONS, "LIST", 0,
     "Numbers of the buttons for clutch (the needle is still while it is held), reset, leave (again: take), seed and undo (default clutch=0,reset=1)", 0},
    {"dead-zone", OPTION_DEAD_ZONE, "SHARE", 0, "Fraction of the full deflection below which the needle does not move (default 0.05)", 0},
    {"full-scale", OPTION_FULL_SCALE, "COUNTS", 0, "Full deflection of a 3Dconnexion device (default 350)", 0},
    {"max-speed", OPTION_SPEED, "M/S", 0, "Speed along the needle at full deflection; half of it sideways (default 0.04)", 0},
    {"max-turn", OPTION_TURN, "RAD/S", 0, "Tilting at full deflection; twice that about the needle's axis (default 0.5)", 0},
    {0, 0, 0, 0, "The needle:", 1},
    {"scene", OPTION_SCENE, "FILE", 0, "Start at the scene's needle.start, in its direction", 1},
    {"start", OPTION_START, "X,Y,Z", 0, "Start of the base, m (default: the scene's, or 0.005,0.003,-0.201)", 1},
    {"patient", OPTION_PATIENT, 0, 0, "--start is in the patient's coordinates: mm, DICOM axes; needs --scene", 1},
    {"needle", OPTION_NEEDLE, "N", 0, "Index of the needle to hold, from 0 (default 0)", 1},
    {0, 0, 0, 0, "Force feedback of a joystick:", 2},
    {"full-force", OPTION_FORCE, "N", 0, "Axial force of the needle that is rendered by the joystick's full force (default 10); negative: reversed", 2},
    {"force-limit", OPTION_LIMIT, "SHARE", 0, "Limit of the force, as a fraction of the joystick's full force (default 0.5)", 2},
    {"force-direction", OPTION_DIRECTION, "DEGREES", 0, "Direction of the force against forward: 0 towards the user (default), 90 to the left, 180 away, 270 to the right", 2},
    {0, 0, 0, 0, "Connection:", 3},
    {"lcm-url", OPTION_URL, "URL", 0, "LCM network, or udp://HOST:PORT of a server with --listen; the secret is in $TROCAR_SECRET_FILE (default $LCM_DEFAULT_URL)", 3},
    {"rate", 'r', "HZ", 0, "Poses per second (default 1000)", 3},
    {"realtime", OPTION_REALTIME, 0, 0, "Run under SCHED_FIFO where permitted", 3},
    {0},
};

/* Parses the lists of axes and buttons, which is possible only once all options have been read. */
static void parse_lists(options *o, const struct argp_state *state) {
    const char *axes = o->use_joystick ? "forward=-y,right=x,up=-hat0y,roll=rz" : "right=x,up=y,forward=z,pitch=rx,yaw=ry,roll=rz";
    const input_driver *driver = o->use_joystick ? &joystick_driver : &spnav_driver;
    char why[256];
    if (!mapping_parse_axes(&o->map, o->axes ? o->axes : axes, driver->axis_names, why, sizeof why)) argp_error(state, "--axes: %s", why);
    if (!mapping_parse_buttons(&o->map, o->buttons ? o->buttons : "clutch=0,reset=1", why, sizeof why)) argp_error(state, "--buttons: %s", why);
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 'j':
        o->use_joystick = true;
        o->stick.path = text;
        break;
    case 'r': o->rate = parse_number(state, "rate", text, 100, 4000); break;
    case OPTION_AXES: o->axes = text; break;
    case OPTION_BUTTONS: o->buttons = text; break;
    case OPTION_DEAD_ZONE: o->map.dead_zone = parse_number(state, "dead-zone", text, 0, 0.9); break;
    case OPTION_FULL_SCALE: o->spnav.full_scale = parse_number(state, "full-scale", text, 1, 1e6); break;
    case OPTION_SPEED: o->max_speed = parse_number(state, "max-speed", text, 1e-4, 0.5); break;
    case OPTION_TURN: o->max_turn = parse_number(state, "max-turn", text, 1e-3, 6); break;
    case OPTION_SCENE: o->scene_path = text; break;
    case OPTION_START:
        o->start = parse_vector(state, "start", text);
        o->start_given = true;
        break;
    case OPTION_PATIENT: o->patient = true; break;
    case OPTION_NEEDLE: o->needle = parse_index(state, "needle", text); break;
    case OPTION_FORCE:
        o->force_option = "--full-force";
        o->stick.force.full_force = parse_number(state, "full-force", text, -1e3, 1e3);
        if (fabs(o->stick.force.full_force) < 0.1) argp_error(state, "--full-force: %s: must be 0.1 N or more, or -0.1 N or less", text);
        break;
    case OPTION_LIMIT:
        o->force_option = "--force-limit";
        o->stick.force.limit = parse_number(state, "force-limit", text, 0, 1);
        break;
    case OPTION_DIRECTION:
        o->force_option = "--force-direction";
        o->stick.force.direction = parse_number(state, "force-direction", text, 0, 360);
        break;
    case OPTION_URL: o->lcm_url = text; break;
    case OPTION_REALTIME: o->realtime = true; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (o->force_option && !o->use_joystick) argp_error(state, "%s needs --joystick", o->force_option);
        if (o->patient && !o->scene_path) argp_error(state, "--patient needs --scene");
        parse_lists(o, state);
        break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Drives a needle of trocar-server with a 3Dconnexion device (through spacenavd) or a joystick: the deflection is a velocity. A joystick with force feedback "
    "renders the axial force.\vDevice, spacenavd and server may disconnect and return at any time; meanwhile the needle stays where it is.", NULL, NULL, NULL};

/* ---- the loop ------------------------------------------------------------------------------------------------------ */

typedef struct {
    const options *options;
    trocar_client *client;
    input *in;
    rate_control_limits limits;
    rate_control_state drive;
    uint32_t presses[INPUT_BUTTONS];    /* how many presses of each button have been handled */
    int pending;                        /* the action that is waiting for its reply, or -1 */
    bool rests;                         /* the needle has been left resting in the tissue */
    double heard;                       /* s, arrival time of the last wrench, or start of the wait for the first one */
    int64_t tick;                       /* tick of the last wrench; -1 before the first */
    bool silent;                        /* the user has been told that no wrenches are arriving */
} bridge;

static void say(const char *text) { fprintf(stderr, "trocar-spacemouse: %s\n", text); }

/* Tells whether a command that changes the needle's owner or position is waiting for its reply. Meanwhile, no poses are sent. */
static bool waits(const bridge *b) { return b->pending == ACTION_RESET || b->pending == ACTION_LEAVE; }

static void ask(bridge *b, action_kind action) {
    bool needs_hold = action == ACTION_SEED || action == ACTION_UNDO;
    if (b->pending >= 0) say("the previous command still waits for its reply: press again");
    else if (b->rests && needs_hold) say("the needle is resting: take it first, with the button for leave");
    if (b->pending >= 0 || (b->rests && needs_hold)) return;
    switch (action) {
    case ACTION_RESET: trocar_client_reset(b->client); break;
    case ACTION_LEAVE: b->rests ? trocar_client_take(b->client) : trocar_client_leave(b->client); break;
    case ACTION_SEED: trocar_client_drop_seeds(b->client, 1, 0); break;
    case ACTION_UNDO: trocar_client_undo(b->client); break;
    default: return;
    }
    b->pending = action;
}

static void hear_reply(bridge *b) {
    char why[256], text[512];
    if (b->pending < 0) return;
    trocar_client_answer answer = trocar_client_reply(b->client, why, sizeof why);
    if (answer == TROCAR_CLIENT_WAITING) return;
    bool done = answer == TROCAR_CLIENT_DONE;
    static const char *const names[ACTIONS] = {[ACTION_RESET] = "reset", [ACTION_LEAVE] = "leave", [ACTION_SEED] = "seed", [ACTION_UNDO] = "undo"};
    snprintf(text, sizeof text, "%s: %s", b->rests && b->pending == ACTION_LEAVE ? "take" : names[b->pending], done ? "done" : why);
    say(text);
    if (b->pending == ACTION_RESET && done) {
        rate_control_begin(&b->drive, b->drive.home, b->drive.home);
        b->rests = false;
    }
    /* The server rejects a take command if the needle is not resting in the tissue, for example after a restart of the server. In that case, hold the needle
       as at the start. */
    if (b->pending == ACTION_LEAVE) b->rests = b->rests ? answer == TROCAR_CLIENT_UNANSWERED : done;
    b->heard = playing_now();
    b->pending = -1;
}

static void heed_buttons(bridge *b, const input_state *state) {
    for (int action = ACTION_RESET; action < ACTIONS; action++) {
        int button = b->options->map.buttons[action];
        if (button >= 0 && state->presses[button] != b->presses[button]) ask(b, action);
    }
    memcpy(b->presses, state->presses, sizeof b->presses);
}

/* Reports when wrenches stop arriving and when they arrive again. */
static void watch_server(bridge *b, bool answered, const trocar_client_wrench *w) {
    double now = playing_now();
    if (!answered) {
        if (b->silent || now - b->heard < SILENCE) return;
        b->silent = true;
        say(b->tick < 0 ? "no wrenches: waiting for trocar-server. If it runs, trocar-top shows who holds the needle"
                         : "the server is silent: the needle stays where it is until it answers");
        return;
    }
    if (b->tick < 0) say("the server answers");
    else if (w->tick < b->tick) say("the server was restarted: the part of the needle in the tissue counts as inserted and has no force; reset takes the needle out");
    else if (b->silent) say("the server answers again");
    b->silent = false;
    b->heard = now;
    b->tick = w->tick;
}

static void move(bridge *b, const input_state *state, bool held, double dt) {
    int clutch = b->options->map.buttons[ACTION_CLUTCH];
    rate_control_command command = mapping_command(&b->options->map, state);
    if (clutch >= 0 && state->held[clutch]) command = (rate_control_command){0};
    bool guarded = b->tick >= 0 && playing_now() - b->heard < PATIENCE;
    if (held && guarded) rate_control_step(&b->drive, &b->limits, command, dt);
    else rate_control_begin(&b->drive, b->drive.home, b->drive.base); /* no server: the needle stops where it is */
}

/* Runs one period of the device loop. */
static void exchange(bridge *b, double dt) {
    const input_state *state = input_newest(b->in);
    trocar_client_wrench w;
    hear_reply(b);
    heed_buttons(b, state);
    bool answered = trocar_client_newest(b->client, &w), held = !b->rests && !waits(b);
    if (held) watch_server(b, answered, &w);
    move(b, state, held, dt);
    trocar_pose base = library_pose(b->drive.base);
    if (held) trocar_client_publish(b->client, base.position, base.orientation);
    input_render(b->in, held ? axial_push(w.force, b->drive.base.orientation) : 0);
}

static void run(bridge *b) {
    double period = 1 / b->options->rate, before = playing_now(), due = before;
    b->heard = before;
    while (!playing_interrupted()) {
        due = fmax(due + period, playing_now()); /* skip missed periods */
        sleep_until((int64_t)(1e9 * due));
        double now = playing_now();
        exchange(b, fmin(LONGEST_STEP, now - before));
        before = now;
    }
}

/* ---- set-up ---------------------------------------------------------------------------------------------------------- */

static trocar_status read_scene(const options *o, pose *start, double *length, trocar_error *why) {
    trocar_scene *scene;
    if (!o->scene_path) {
        if (o->start_given) start->position = o->start;
        return TROCAR_OK;
    }
    trocar_status status = trocar_scene_load(o->scene_path, &scene, why);
    if (status != TROCAR_OK) return status;
    patient_frame patient;
    status = trocar_scene_get_number(scene, "needle.length", length, why);
    if (status == TROCAR_OK && o->patient) status = patient_frame_read(scene, &patient, why);
    if (status == TROCAR_OK && !find_start(scene, o->patient ? &patient : NULL, o->start_given ? &o->start : NULL, start))
        status = fail(why, TROCAR_BAD_INPUT, "%s: has no needle.start: add it, or give --start", o->scene_path);
    trocar_scene_free(scene);
    return status;
}

static trocar_status drive(options *o, trocar_error *why) {
    bridge b = {.options = o, .pending = -1, .tick = -1};
    pose start = MOTION_START;
    double length = 0.2;
    trocar_status status = read_scene(o, &start, &length, why);
    if (status != TROCAR_OK) return status;
    b.limits = rate_control_defaults(length);
    b.limits.along_needle = true;
    if (o->max_speed > 0) b.limits.max_speed = o->max_speed;
    if (o->max_turn > 0) b.limits.max_turn_rate = o->max_turn;
    rate_control_begin(&b.drive, start, start);

    status = o->use_joystick ? input_start(&joystick_driver, &o->stick, &b.in, why) : input_start(&spnav_driver, &o->spnav, &b.in, why);
    if (status != TROCAR_OK) return status;
    trocar_client_options client = {.url = o->lcm_url, .needle = o->needle, .without_force = 1};
    if (o->realtime && playing_use_realtime()) client.priority = PRIORITY_DEVICE - 1;
    b.client = trocar_client_open(&client, why->text, sizeof why->text);
    if (b.client) run(&b);
    else status = TROCAR_BAD_INPUT;
    input_stop(b.in); /* first of all, switch the motors off */
    trocar_client_close(b.client);
    return status;
}

int main(int count, char **arguments) {
    static options o = {.rate = 1000, .map.dead_zone = 0.05, .spnav.full_scale = 350, .stick.force = {.full_force = 10, .limit = 0.5}};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    signal(SIGPIPE, SIG_IGN); /* libspnav may write to a daemon that has already exited */
    playing_heed_signals();
    trocar_error why;
    trocar_status status = drive(&o, &why);
    if (status == TROCAR_OK) return EXIT_SUCCESS;
    fprintf(stderr, "trocar-spacemouse: %s\n", why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
