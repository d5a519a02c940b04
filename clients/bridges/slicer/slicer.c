/* trocar-slicer: an OpenIGTLink server that shows a running trocar-server in 3D Slicer and lets trackers move its needle and probe. */
#include <argp.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "common/progress.h"
#include "common/timing.h"
#include "device/playing.h"
#include "lcm_filter.h"
#include "outlets.h"
#include "peers.h"
#include "shared/options.h"
#include "tracked.h"

const char *argp_program_version = "trocar-slicer " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

enum { PORT = 18944, MESSAGES = 1000 /* maximum number of LCM messages handled per round, so that a flood of them cannot delay the clients */ };
static const int64_t SECOND = 1000000000;          /* ns */
static const int64_t OTHER_SENDER = 1000000000;    /* ns, another sender may move the needle or probe once the current one has been silent for this long */

typedef struct {
    const char *scene_path, *lcm_url, *needle_name, *probe_name;
    double rate;             /* Hz */
    int needle;              /* index of the needle that a tracker drives */
    slice_settings images;
    peer_settings peers;
} options;

/* The sender that may move the needle or probe: the first one that tries. */
typedef struct {
    char who[80];
    int64_t heard;           /* ns, monotonic: arrival time of the sender's last pose; 0 if there is no sender */
    bool other_said;
} mover;

typedef struct {
    const options *options;
    trocar_scene *scene;
    trocar_model *model;     /* used only for its mesh, not simulated */
    lcm_t *lcm;
    subscriber feed;
    outlets outlets;
    peers peers;
    tracked_needle needle;
    tracked_probe probe;
    bool tracking;           /* true while the thread that drives the needle is running */
    mover needle_mover, probe_mover;
    int64_t picture_made, forces_due, status_due; /* ns, monotonic */
    int64_t shown;           /* utime of the deformation last sent to the clients; -1 for the tissue at rest; -2 if nothing was sent yet */
    bool was_alive, probe_said;
    int64_t servers, refused; /* the subscriber's counters as of the last report */
} bridge;

/* ---- command line ---- */

enum { OPTION_URL = 256, OPTION_BIND, OPTION_IMAGES, OPTION_PIXEL, OPTION_GAIN, OPTION_RANGE, OPTION_DEPTH, OPTION_NEEDLE, OPTION_NEEDLE_FROM, OPTION_PROBE_FROM, OPTION_TRACKER };

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene of the server (required)", 0},
    {"lcm-url", OPTION_URL, "URL", 0, "LCM network (default $LCM_DEFAULT_URL)", 0},
    {0, 0, 0, 0, "Clients:", 1},
    {"port", 'p', "PORT", 0, "TCP port (default 18944; 0: any free one)", 1},
    {"bind", OPTION_BIND, "ADDRESS", 0, "Address to listen on; 0.0.0.0: all (default 127.0.0.1: this machine only)", 1},
    {"rate", 'r', "HZ", 0, "Values per second of each message, 1 to 60 (default 30); the server itself sends needles and organs 30 times", 1},
    {"images", OPTION_IMAGES, "STYLE", 0, "Images: echo, simulated ultrasound; regions, at each pixel the volume's number in the scene's list; or none (default echo)", 1},
    {"pixel", OPTION_PIXEL, "MM", 0, "Size of the images' pixels, 0.1 to 5 (default 0.5)", 1},
    {"gain", OPTION_GAIN, "DB", 0, "Gain of the ultrasound, -40 to 40 (default 0)", 1},
    {"dynamic-range", OPTION_RANGE, "DB", 0, "Dynamic range of the ultrasound, from black to white, 20 to 100 (default 60)", 1},
    {"depth", OPTION_DEPTH, "MM", 0, "Depth of the images from the probe's surface, 20 to 150 (default: as deep as the gland, and 14 mm more)", 1},
    {0, 0, 0, 0, "Trackers:", 2},
    {"needle", OPTION_NEEDLE, "INDEX", 0, "Needle that is driven (default 0)", 2},
    {"needle-from", OPTION_NEEDLE_FROM, "NAME", 0, "TRANSFORM whose poses the needle's base follows (default StylusToReference)", 2},
    {"probe-from", OPTION_PROBE_FROM, "NAME", 0, "TRANSFORM whose poses the probe's base follows (default ProbeToReference)", 2},
    {"tracker", OPTION_TRACKER, "HOST[:PORT]", 0, "Connect to this OpenIGTLink server, such as PlusServer, and read them from there; without PORT to 18944", 2},
    {0},
};

static slice_style parse_style(struct argp_state *state, const char *text) {
    static const char *const names[] = {"echo", "regions", "none"};
    for (int i = 0; i < 3; i++)
        if (strcmp(text, names[i]) == 0) return (slice_style)i;
    argp_error(state, "--images %s: expected echo, regions or none", text);
    return SLICES_NONE;
}

static const char *parse_transform(struct argp_state *state, const char *option, const char *text) {
    if (!*text || strlen(text) > IGTL_HEADER_NAME_SIZE) argp_error(state, "--%s %s: OpenIGTLink's names have 1 to 20 letters", option, text);
    return text;
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 's': o->scene_path = text; break;
    case 'p': o->peers.port = parse_whole(state, "port", text, 0, 65535); break;
    case 'r': o->rate = parse_number(state, "rate", text, 1, 60); break;
    case OPTION_URL: o->lcm_url = text; break;
    case OPTION_BIND: o->peers.address = text; break;
    case OPTION_IMAGES: o->images.style = parse_style(state, text); break;
    case OPTION_GAIN: o->images.gain = parse_number(state, "gain", text, -40, 40); break;
    case OPTION_RANGE: o->images.range = parse_number(state, "dynamic-range", text, 20, 100); break;
    case OPTION_DEPTH: o->images.depth = 1e-3 * parse_number(state, "depth", text, 20, 150); break;
    case OPTION_PIXEL: o->images.pixel = 1e-3 * parse_number(state, "pixel", text, 0.1, 5); break;
    case OPTION_NEEDLE: o->needle = parse_index(state, "needle", text); break;
    case OPTION_NEEDLE_FROM: o->needle_name = parse_transform(state, "needle-from", text); break;
    case OPTION_PROBE_FROM: o->probe_name = parse_transform(state, "probe-from", text); break;
    case OPTION_TRACKER: o->peers.tracker = text; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (!o->scene_path) argp_error(state, "--scene is missing");
        if (strcmp(o->needle_name, o->probe_name) == 0) argp_error(state, "--needle-from and --probe-from: one transform cannot drive both");
        break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Shows a running trocar-server in 3D Slicer, PLUS and other programs over OpenIGTLink, and lets trackers move its needle and probe."
    "\vCoordinates are RAS in mm: the patient's, if the scene has patient_to_mesh, else the mesh's axes.", NULL, NULL, NULL};

/* ---- trackers ---- */

/* Decides whether this sender may move the needle or probe. No other sender may until the current one falls silent. */
static bool may_move(mover *m, const char *who, const char *name) {
    int64_t now = monotonic_ns();
    bool same = strcmp(who, m->who) == 0, silent = m->heard == 0 || now - m->heard > OTHER_SENDER;
    if (!same && !silent) {
        if (!m->other_said) fprintf(stderr, "trocar-slicer: %s: \"%s\" ignored: it already comes from %s\n", who, name, m->who);
        m->other_said = true;
        return false;
    }
    if (!same) m->other_said = false;
    snprintf(m->who, sizeof m->who, "%s", who);
    m->heard = now;
    return true;
}

static void on_transform(void *context, const char *who, const char *name, const ras_matrix *matrix) {
    bridge *b = context;
    pose base = ras_to_pose(&b->outlets.frame, matrix);
    if (strcmp(name, b->options->needle_name) == 0) {
        if (may_move(&b->needle_mover, who, name)) tracked_needle_move(&b->needle, base);
    } else if (strcmp(name, b->options->probe_name) == 0) {
        if (b->outlets.probe >= 0 && may_move(&b->probe_mover, who, name)) tracked_probe_move(&b->probe, base);
        if (b->outlets.probe < 0 && !b->probe_said) fprintf(stderr, "trocar-slicer: %s: \"%s\" ignored: the scene has no probe\n", who, name);
        b->probe_said = true;
    }
}

/* ---- the server ---- */

static void say_server(bridge *b) {
    bool alive = subscriber_alive(&b->feed);
    if (b->feed.servers != b->servers) {
        fprintf(stderr, "trocar-slicer: %s server\n", b->servers ? "another" : "connected to the");
        b->refused = b->feed.refused;
        b->was_alive = true;
    } else if (alive != b->was_alive) {
        fprintf(stderr, alive ? "trocar-slicer: the server is back\n" : "trocar-slicer: the server is silent: clients keep the last picture; waiting for it\n");
        b->was_alive = alive;
    }
    b->servers = b->feed.servers;
    if (b->feed.refused <= b->refused) return;
    fprintf(stderr, "trocar-slicer: messages of the server do not fit: is --scene %s its scene, and is it of the same release?\n", b->options->scene_path);
    b->refused = INT64_MAX; /* report each server only once */
}

/* ---- the loop ---- */

/* Returns true once per `period` on average. */
static bool is_due(int64_t *due, int64_t now, int64_t period) {
    if (now < *due) return false;
    *due = now - *due < period ? *due + period : now + period;
    return true;
}

static int64_t newest_picture(const bridge *b) { return b->feed.deformation ? b->feed.deformation->utime : -1; }

/* Updates the values for the clients. Deformations take the most time, so they are shown only while clients are connected. */
static void show_news(bridge *b) {
    int64_t now = monotonic_ns(), period = (int64_t)(1e9 / b->options->rate);
    say_server(b);
    if (is_due(&b->status_due, now, SECOND / 10)) outlets_show_status(&b->outlets, &b->feed);
    if (peers_count(&b->peers) == 0) return;
    if (is_due(&b->forces_due, now, period)) outlets_show_forces(&b->outlets, &b->feed);
    if (newest_picture(b) != b->shown && now - b->picture_made > period / 4 * 3) { /* three quarters of a period, because deformations arrive with jitter, and at
                                                                                      the server's own rate none may be delayed or skipped */
        b->picture_made = now;
        b->shown = newest_picture(b);
        outlets_show_picture(&b->outlets, &b->feed);
    }
}

static void serve(bridge *b) {
    struct pollfd events[PEERS + 4];
    printf("port %d\nready\n", b->peers.port);
    fflush(stdout);
    while (!playing_interrupted()) {
        events[0] = (struct pollfd){.fd = lcm_get_fileno(b->lcm), .events = POLLIN};
        int count = peers_watch(&b->peers, events + 1);
        bool pending = newest_picture(b) != b->shown && peers_count(&b->peers) > 0;
        events[count + 1] = (struct pollfd){.fd = slices_descriptor(&b->outlets.slices), .events = POLLIN}; /* poll ignores a descriptor of -1 */
        if (poll(events, (nfds_t)count + 2, pending ? 1 : 50) < 0) continue;
        for (int i = 0; i < MESSAGES && lcm_handle_timeout(b->lcm, 0) > 0; i++) continue;
        peers_handle(&b->peers, events + 1, count);
        outlets_show_images(&b->outlets);
        show_news(b);
    }
}

/* ---- set-up ---- */

static trocar_status check_needle(const bridge *b, trocar_error *why) {
    int needles = trocar_model_needles(b->model);
    if (b->options->needle < needles) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "--needle %d: %s has needles 0 to %d", b->options->needle, b->options->scene_path, needles - 1);
}

static trocar_status open_network(bridge *b, trocar_error *why) {
    const char *url = b->options->lcm_url;
    peer_settings settings = b->options->peers;
    settings.messages = b->outlets.messages;
    settings.message_count = b->outlets.count;
    settings.light_count = b->outlets.light_count;
    settings.transform = on_transform;
    settings.context = b;
    trocar_status status = peers_open(&b->peers, &settings, why);
    if (status != TROCAR_OK) return status;
    b->lcm = lcm_filter_create_wide(url);
    if (!b->lcm)
        return fail(why, TROCAR_BAD_INPUT, "cannot open LCM at %s: is there a multicast route (docs/troubleshooting.md)?", url ? url : "its default URL");
    status = subscriber_open(&b->feed, b->lcm, b->model, NULL, why);
    if (status == TROCAR_OK) status = tracked_needle_open(&b->needle, url, b->options->needle, why);
    b->tracking = status == TROCAR_OK;
    tracked_probe_open(&b->probe, b->lcm);
    return status;
}

static trocar_status prepare(bridge *b, trocar_error *why) {
    const options *o = b->options;
    const trocar_model_options mesh_only = {.mesh_only = 1, .log = {progress_warn, "trocar-slicer"}};
    b->shown = -2;
    b->peers.listener = -1;
    trocar_status status = trocar_scene_load(o->scene_path, &b->scene, why);
    if (status == TROCAR_OK) status = trocar_model_create(b->scene, &mesh_only, &b->model, why);
    if (status == TROCAR_OK) status = check_needle(b, why);
    if (status == TROCAR_OK) status = outlets_create(&b->outlets, b->scene, b->model, &o->images, why);
    if (status != TROCAR_OK) return status;
    if (!b->outlets.registered)
        fprintf(stderr, "trocar-slicer: %s has no patient_to_mesh: the mesh's x, y and z are used as right, front and head\n", o->scene_path);
    return open_network(b, why);
}

static void clean_up(bridge *b) {
    if (b->tracking) tracked_needle_close(&b->needle);
    peers_close(&b->peers);
    subscriber_close(&b->feed);
    if (b->lcm) lcm_destroy(b->lcm);
    outlets_free(&b->outlets);
    trocar_model_free(b->model);
    trocar_scene_free(b->scene);
}

int main(int count, char **arguments) {
    options o = {.rate = 30, .images = {.pixel = 0.5e-3, .range = 60}, .needle_name = "StylusToReference", .probe_name = "ProbeToReference",
                 .peers = {.address = "127.0.0.1", .port = PORT}};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    playing_heed_signals();

    static bridge b;
    b.options = &o;
    trocar_error why;
    trocar_status status = prepare(&b, &why);
    if (status == TROCAR_OK) serve(&b);
    clean_up(&b);
    if (status == TROCAR_OK) return EXIT_SUCCESS;
    fprintf(stderr, "trocar-slicer: %s\n", why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
