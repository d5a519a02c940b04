#include "settings.h"

#include <stdlib.h>
#include <string.h>

#include "common/host_port.h"
#include "profile.h"
#include "shared/options.h"
#include "shared/patient.h"

static const char STANDARD_PORT[] = "10001";
static const double STANDARD_LENGTH = 0.2; /* m, length of the needles in the scenes of this project */

enum { OPTION_SERVICE = 256, OPTION_EVENTS, OPTION_DEVICE, OPTION_HANDLE, OPTION_URL, OPTION_NEEDLE, OPTION_RATE, OPTION_REALTIME, OPTION_REPORT,
       OPTION_PROFILE, OPTION_ROTATION, OPTION_SCALE, OPTION_START, OPTION_OFFSET, OPTION_POINT, OPTION_LENGTH, OPTION_ORIENTATION, OPTION_DIRECTION,
       OPTION_TOOL, OPTION_CLUTCH, OPTION_MAX_FORCE, OPTION_MAX_RATE, OPTION_FORCE_SCALE, OPTION_TOOL_MASS, OPTION_FORCE_KEY, OPTION_SCENE, OPTION_PATIENT,
       OPTION_MEASURE_DELAY };

static const struct argp_option option_list[] = {
    {"profile", OPTION_PROFILE, "FILE", 0, "Read options from a YAML file: long names and values; the command line overrides it", 0},
    {0, 0, 0, 0, "Connection:", 1},
    {"service", OPTION_SERVICE, "HOST[:PORT]", 0, "Haply Inverse Service (default 127.0.0.1:10001)", 1},
    {"events", OPTION_EVENTS, "PORT", 0, "The service's events, whose warnings are printed; 0: none (default 10020)", 1},
    {"device", OPTION_DEVICE, "ID", 0, "Inverse3 to use (default: the first)", 1},
    {"handle", OPTION_HANDLE, "ID", 0, "VerseGrip to use (default: the first)", 1},
    {"lcm-url", OPTION_URL, "URL", 0, "LCM network, or udp://HOST:PORT of a server with --listen; the secret is in $TROCAR_SECRET_FILE (default $LCM_DEFAULT_URL)", 1},
    {"needle", OPTION_NEEDLE, "N", 0, "Index of the needle to hold, from 0 (default 0)", 1},
    {"rate", OPTION_RATE, "HZ", 0, "Messages per second, if the service answers in time (default 1000)", 1},
    {"realtime", OPTION_REALTIME, 0, 0, "Run under SCHED_FIFO where permitted", 1},
    {0, 0, 0, 0, "Workspace, in the scene's frame unless said otherwise:", 2},
    {"rotation", OPTION_ROTATION, "W,X,Y,Z", 0, "From the device's frame to the scene's (default 0,0,0.7071068,0.7071068: forward is z, up is y)", 2},
    {"scale", OPTION_SCALE, "FACTOR", 0, "Motion of the needle per motion of the hand (default: the scene's device.scale, or 1)", 2},
    {"scene", OPTION_SCENE, "FILE", 0, "Take start, direction and length of the needle, and the scales of motion and force, from the server's scene", 2},
    {"patient", OPTION_PATIENT, 0, 0, "--start and --offset are in the patient's coordinates: mm, DICOM axes; needs --scene", 2},
    {"point", OPTION_POINT, "POINT", 0, "The needle's point at the cursor: base or tip (default base)", 2},
    {"length", OPTION_LENGTH, "M", 0, "Length of the scene's needle, for --point tip (default: the scene's, or 0.2)", 2},
    {"start", OPTION_START, "X,Y,Z", 0, "Position of that point when the bridge starts, m (default: the scene's, or 0.005,0.003,-0.201 for the base, 0.005,0.003,-0.001 for the tip)", 2},
    {"offset", OPTION_OFFSET, "X,Y,Z", 0, "Instead of --start: position of the device's origin in the scene, m", 2},
    {"orientation", OPTION_ORIENTATION, "FROM", 0, "The needle's orientation: handle, or fixed (default handle)", 2},
    {"direction", OPTION_DIRECTION, "X,Y,Z", 0, "The needle's direction if it is fixed or there is no handle (default: the scene's, or 0,0,1)", 2},
    {"tool", OPTION_TOOL, "W,X,Y,Z", 0, "The needle's orientation in the handle's frame (default 0,0,0.7071068,0.7071068: along the handle's y)", 2},
    {"clutch", OPTION_CLUTCH, "BUTTON", 0, "While this button of the handle is pressed, the needle stays where it is (default a)", 2},
    {0, 0, 0, 0, "Force:", 3},
    {"max-force", OPTION_MAX_FORCE, "N", 0, "Largest force (default 3)", 3},
    {"max-force-rate", OPTION_MAX_RATE, "N/S", 0, "Largest change of the force per second (default 400)", 3},
    {"force-scale", OPTION_FORCE_SCALE, "FACTOR", 0, "Force on the hand per force on the needle (default: the scene's device.force_scale, or 1)", 3},
    {"tool-mass", OPTION_TOOL_MASS, "KG", 0, "Mass at the cursor whose weight is compensated, in addition to the service's own compensation (default 0)", 3},
    {"force-key", OPTION_FORCE_KEY, "KEY", 0, "Name of the force in set_cursor_force: vector or values (default: by the service's version)", 3},
    {0, 0, 0, 0, "Output:", 4},
    {"measure-delay", OPTION_MEASURE_DELAY, 0, 0, "Push the device gently for 5 s, print its delay and mass for the scene, and exit", 4},
    {"report", OPTION_REPORT, "SECONDS", 0, "Print rate and round trip this often; 0: at the end only (default 10)", 4},
    {0},
};

static quat parse_rotation(const struct argp_state *state, const char *option, const char *text) {
    double n[4];
    parse_numbers(state, option, text, 4, n);
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] + n[3] * n[3]);
    if (!(length > 0.99 && length < 1.01)) argp_error(state, "--%s: %s: expected a quaternion w,x,y,z of unit length", option, text);
    return q_unit((quat){n[0], n[1], n[2], n[3]});
}

/* Parses one of two words: returns true for `second`, false for `first`, and exits with an error otherwise. */
static bool parse_word(const struct argp_state *state, const char *option, const char *text, const char *first, const char *second) {
    if (strcmp(text, first) != 0 && strcmp(text, second) != 0) argp_error(state, "--%s: '%s': expected %s or %s", option, text, first, second);
    return strcmp(text, second) == 0;
}

static void parse_text(const struct argp_state *state, const char *option, const char *text, size_t size, char *copy) {
    if (strlen(text) >= size || strlen(text) == 0) argp_error(state, "--%s: '%s': expected 1 to %zu characters", option, text, size - 1);
    else strcpy(copy, text);
}

static void parse_service(const struct argp_state *state, haply_settings *o, const char *text) {
    char port[6];
    if (!split_host_port(text, STANDARD_PORT, o->host, port))
        argp_error(state, "--service: '%s': expected HOST or HOST:PORT, with the port from 1 to 65535 and an IPv6 address in brackets", text);
    o->port = atoi(port);
}

static error_t parse_option(int key, char *text, struct argp_state *state);

typedef struct {
    struct argp_state *state;
    unsigned given;          /* bit set of the options given; bit 0 is OPTION_SERVICE */
} profile;

/* Sets an option from a profile. Error messages name the line in the profile. */
static trocar_status set_from_profile(void *context, const char *place, const char *name, const char *value, trocar_error *why) {
    profile *p = context;
    struct argp_state *state = p->state;
    const struct argp_option *o = option_list;
    while ((o->name || o->doc) && !(o->name && strcmp(o->name, name) == 0)) o++; /* skip headings, which have no name */
    if (!o->name || o->key == OPTION_PROFILE) return fail(why, TROCAR_BAD_INPUT, "%s: no option '%s'; see trocar-haply --help", place, name);
    if (!o->arg && strcmp(value, "true") != 0) return fail(why, TROCAR_BAD_INPUT, "%s: %s: expected true", place, name);
    unsigned bit = 1u << (o->key - OPTION_SERVICE);
    if (p->given & bit) return fail(why, TROCAR_BAD_INPUT, "%s: %s: given a second time; keep one of them", place, name);
    p->given |= bit;
    char *program = state->name, where[1100], text[1024];
    snprintf(text, sizeof text, "%s", value);
    snprintf(where, sizeof where, "%s: %s", program, place);
    state->name = where;
    parse_option(o->key, text, state);
    state->name = program;
    return TROCAR_OK;
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    haply_settings *o = state->input;
    mapping_settings *m = &o->mapping;
    switch (key) {
    case OPTION_PROFILE: break; /* already handled by parse_profile */
    case OPTION_SERVICE: parse_service(state, o, text); break;
    case OPTION_EVENTS: o->events_port = parse_whole(state, "events", text, 0, 65535); break;
    case OPTION_DEVICE: parse_text(state, "device", text, sizeof o->choice.device, o->choice.device); break;
    case OPTION_HANDLE: parse_text(state, "handle", text, sizeof o->choice.handle, o->choice.handle); break;
    case OPTION_URL: parse_text(state, "lcm-url", text, sizeof o->lcm_url, o->lcm_url); break;
    case OPTION_NEEDLE: o->needle = parse_index(state, "needle", text); break;
    case OPTION_RATE: o->rate = parse_number(state, "rate", text, 10, 4000); break;
    case OPTION_REALTIME: o->realtime = true; break;
    case OPTION_ROTATION: m->rotation = parse_rotation(state, "rotation", text); break;
    case OPTION_SCALE:
        m->scale = parse_number(state, "scale", text, 0.01, 10);
        o->scale_given = true;
        break;
    case OPTION_POINT: m->tip = parse_word(state, "point", text, "base", "tip"); break;
    case OPTION_LENGTH:
        m->length = parse_number(state, "length", text, 0.001, 1);
        o->length_given = true;
        break;
    case OPTION_SCENE:
        parse_text(state, "scene", text, sizeof o->scene, o->scene);
        break;
    case OPTION_PATIENT: o->patient = true; break;
    case OPTION_START:
        m->start = parse_vector(state, "start", text);
        o->start_given = true;
        break;
    case OPTION_OFFSET:
        m->offset = parse_vector(state, "offset", text);
        m->has_offset = true;
        break;
    case OPTION_ORIENTATION: m->fixed = parse_word(state, "orientation", text, "handle", "fixed"); break;
    case OPTION_DIRECTION:
        m->direction = parse_vector(state, "direction", text);
        o->direction_given = true;
        if (!(v3_norm(m->direction) > 1e-6)) argp_error(state, "--direction: %s: has no length", text);
        break;
    case OPTION_TOOL: m->tool = parse_rotation(state, "tool", text); break;
    case OPTION_CLUTCH: parse_text(state, "clutch", text, sizeof o->choice.clutch, o->choice.clutch); break;
    case OPTION_MAX_FORCE: o->max_force = parse_number(state, "max-force", text, 0, 20); break;
    case OPTION_MAX_RATE: o->max_force_rate = parse_number(state, "max-force-rate", text, 1, 1e5); break;
    case OPTION_FORCE_SCALE:
        o->force_scale = parse_number(state, "force-scale", text, 0, 10);
        o->force_scale_given = true;
        break;
    case OPTION_TOOL_MASS: o->tool_mass = parse_number(state, "tool-mass", text, 0, 1); break;
    case OPTION_FORCE_KEY: o->force_key = parse_word(state, "force-key", text, "vector", "values") ? "values" : "vector"; break;
    case OPTION_MEASURE_DELAY: o->measure_delay = true; break;
    case OPTION_REPORT: o->report = parse_number(state, "report", text, 0, 1e6); break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (o->start_given && m->has_offset) argp_error(state, "--start and --offset exclude each other");
        if (o->patient && !o->scene[0]) argp_error(state, "--patient needs --scene");
        if (!o->start_given && m->tip) m->start.z += STANDARD_LENGTH;
        break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

/* Reads the profile option and ignores all others. */
static error_t parse_profile(int key, char *text, struct argp_state *state) {
    profile p = {.state = state};
    trocar_error why;
    if (key == OPTION_PROFILE && profile_read(text, set_from_profile, &p, &why) != TROCAR_OK) argp_error(state, "%s", why.text);
    return 0;
}

static const char DESCRIPTION[] =
    "Connects a Haply Inverse3 and its handle to trocar-server, through the Haply Inverse Service. Tested with a simulated service, but not on hardware: begin with a "
    "small --max-force.";
static const struct argp profile_parser = {.options = option_list, .parser = parse_profile, .doc = DESCRIPTION};
static const struct argp parser = {.options = option_list, .parser = parse_option, .doc = DESCRIPTION};

void haply_parse(int count, char **arguments, haply_settings *settings) {
    *settings = (haply_settings){
        .host = "127.0.0.1", .port = atoi(STANDARD_PORT), .events_port = 10020, .choice.clutch = "a", .rate = 1000, .report = 10,
        .max_force = 3, .max_force_rate = 400, .force_scale = 1,
        .mapping = {.rotation = MAPPING_Y_TO_Z, .scale = 1, .start = {0.005, 0.003, -0.201}, .length = STANDARD_LENGTH, .direction = {0, 0, 1},
                    .tool = MAPPING_Y_TO_Z}};
    argp_parse(&profile_parser, count, arguments, 0, NULL, settings); /* read the profile first, so that the command line overrides it */
    argp_parse(&parser, count, arguments, 0, NULL, settings);
}

static trocar_status place_in(const trocar_scene *scene, haply_settings *o, trocar_error *why) {
    mapping_settings *m = &o->mapping;
    patient_frame patient;
    pose start = {m->start, {1, 0, 0, 0}};
    trocar_status status = o->patient ? patient_frame_read(scene, &patient, why) : TROCAR_OK;
    if (status == TROCAR_OK && !o->scale_given) status = trocar_scene_get_number(scene, "device.scale", &m->scale, why);
    if (status == TROCAR_OK && !o->force_scale_given) status = trocar_scene_get_number(scene, "device.force_scale", &o->force_scale, why);
    if (status == TROCAR_OK && !o->length_given) status = trocar_scene_get_number(scene, "needle.length", &m->length, why);
    if (status != TROCAR_OK) return status;
    bool known = find_start(scene, NULL, NULL, &start);
    if (!known && !o->start_given && !m->has_offset)
        return fail(why, TROCAR_BAD_INPUT, "%s: has no needle.start: add it, or give --start", trocar_scene_path(scene));
    if (known && !o->direction_given) m->direction = q_axis(start.orientation);
    if (known && !o->start_given) m->start = m->tip ? v3_axpy(m->length, q_axis(start.orientation), start.position) : start.position;
    if (o->patient && o->start_given) m->start = patient_to_mesh(&patient, m->start);
    if (o->patient && m->has_offset) m->offset = patient_to_mesh(&patient, m->offset);
    return TROCAR_OK;
}

trocar_status haply_place(haply_settings *settings, trocar_error *why) {
    trocar_scene *scene;
    if (!settings->scene[0]) return TROCAR_OK;
    trocar_status status = trocar_scene_load(settings->scene, &scene, why);
    if (status != TROCAR_OK) return status;
    status = place_in(scene, settings, why);
    trocar_scene_free(scene);
    return status;
}
