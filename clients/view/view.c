/* trocar-view: shows a live scene or a recorded log in browsers, and makes pictures of a log. */
#define _GNU_SOURCE
#include <argp.h>
#include <errno.h>
#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "chromium.h"
#include "exchange.h"
#include "subscriber.h"
#include "events.h"
#include "hole_approach.h"
#include "implant.h"
#include "json.h"
#include "messages.h"
#include "options.h"
#include "output.h"
#include "patient.h"
#include "pose_publisher.h"
#include "playback.h"
#include "realtime.h"
#include "timing.h"
#include "web.h"

const char *argp_program_version = "trocar-view " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

static const int64_t PICTURE_PATIENCE = 60000000000; /* ns */
static const double FAR = 0.5;  /* m from its home: a needle that was removed */

/* Content and size of a picture. */
typedef struct {
    int width, height;       /* pixels */
    int view;                /* 1 .. 4, as the keys of the page */
    const char *theme;
    char cut;                /* axis normal to the cut, 0: none */
    double place;            /* m, position of the cut on its axis; NAN: at the tip */
} picture;

typedef struct {
    const char *scene_path, *lcm_url, *log_path, *png_path;
    double at;               /* s; INFINITY: the end of the log */
    picture picture;
    const char *picture_option;   /* last option that needs --png, NULL: none */
    const char *live_option; /* last option that needs a live server, NULL: none */
    implant_settings implant;
    web_settings web;
} options;

/* A resting needle changes hands: until the server has answered, the browser keeps it although it rests. */
typedef enum { HANDING_NOTHING, HANDING_LEFT, HANDING_TAKEN } handover;

typedef struct {
    const options *options;
    trocar_scene *scene;
    trocar_model *model;     /* its mesh alone */
    double needle_length;    /* m */
    vec3 low, high;          /* m, corners of the box around the mesh */
    int needle_count;        /* live; a log shows one */
    pose homes[TROCAR_MAX_NEEDLES]; /* where each waits outside */
    timeline timeline;
    byte_buffer encoded_scene;
    char page[4096];         /* folder of the page */
    web *web;
    int stop_wake;
    bool stop;

    lcm_t *lcm;              /* live only */
    subscriber feed;
    pose_publisher pilot;
    implant implant;
    int driven;              /* needle that a browser drives, or drove last */
    bool driving;            /* a browser drives it */
    handover handing;        /* whether that needle is being left or taken, */
    int64_t handing_since;   /* ns, monotonic */
    int64_t replies_heeded;  /* value of subscriber.replies_heard */
    pthread_t pilot_thread;
    bool piloting;           /* the publisher's thread runs */
    int64_t servers;         /* value of subscriber.servers for the server that browsers drive */
    report cut;              /* where the log is truncated, empty if it is complete */

    output png;              /* --png only */
    bool png_taken;
} view;

/* ---- command line ---- */

enum { OPTION_URL = 256, OPTION_BIND, OPTION_SOCKET, OPTION_HOST, OPTION_PAGE, OPTION_LOG, OPTION_PNG, OPTION_AT,
       OPTION_SIZE, OPTION_VIEW, OPTION_CUT, OPTION_THEME, OPTION_SOURCE, OPTION_STRENGTH, OPTION_PRESCRIPTION, OPTION_SWELLING, OPTION_PLAN };

enum { LEAST_SIDE = 320, GREATEST_SIDE = 4096 /* pixels; rendered at twice the resolution for anti-aliasing */ };

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene of the server or of the log (required)", 0},
    {"lcm-url", OPTION_URL, "URL", 0, "LCM network (default $LCM_DEFAULT_URL)", 0},
    {0, 0, 0, 0, "Web server:", 1},
    {"port", 'p', "PORT", 0, "TCP port (default 8686; 0: any free one)", 1},
    {"bind", OPTION_BIND, "ADDRESS", 0, "Address to listen on (default 127.0.0.1: this machine only)", 1},
    {"socket", OPTION_SOCKET, "PATH", 0, "Listen on a Unix socket instead, for a proxy", 1},
    {"host", OPTION_HOST, "NAME", 0, "Host name under which the page may be opened, besides localhost and ADDRESS", 1},
    {"page", OPTION_PAGE, "FOLDER", 0, "The built page (default: the one built with this program)", 1},
    {0, 0, 0, 0, "Recorded logs:", 2},
    {"log", OPTION_LOG, "FILE", 0, "Show this LCM event log by simulating its poses in lockstep; needs no network", 2},
    {"png", OPTION_PNG, "FILE", 0, "Write one picture of the log and exit; uses headless Chromium", 2},
    {"at", OPTION_AT, "SECONDS", 0, "Time of the picture after the first pose of the log (default: the end)", 2},
    {"size", OPTION_SIZE, "WIDTHxHEIGHT", 0, "Size of the picture in pixels, 320 to 4096 each (default 1600x1000)", 2},
    {"view", OPTION_VIEW, "NAME", 0, "View: oblique (default), side, above, or along the needle", 2},
    {"cut", OPTION_CUT, "PLANE[:MM]", 0, "Cut the tissue in a sagittal, coronal or axial plane, at MM along x, y or z (default: at the tip)", 2},
    {"theme", OPTION_THEME, "NAME", 0, "Theme: light (default) or dark", 2},
    {0, 0, 0, 0, "Implants, in a scene with a template:", 3},
    {"source", OPTION_SOURCE, "NAME", 0, "Seed model: \"I-125 6711\" (default), \"Pd-103 200\", or the path of a table that ends in .yaml", 3},
    {"strength", OPTION_STRENGTH, "U", 0, "Air-kerma strength of each seed (default 0.5)", 3},
    {"prescription", OPTION_PRESCRIPTION, "GY", 0, "Prescribed dose (default 145)", 3},
    {"swelling", OPTION_SWELLING, "RATIO", 0, "Volume of the gland on the day of the implant over that when its swelling has gone (default 1.18)", 3},
    {"plan", OPTION_PLAN, "FILE", 0, "Show these planned seeds: the table that python3 -m trocar.plan show --out writes", 3},
    {0},
};

/* Index of `text` in `names`; otherwise exits through argp_error. */
static int parse_name(struct argp_state *state, const char *option, const char *text, const char *const *names, int count) {
    int place = 0;
    while (place < count && strcmp(text, names[place]) != 0) place++;
    if (place == count) argp_error(state, "--%s %s: not one of the names in --help", option, text);
    return place;
}

static void parse_size(struct argp_state *state, const char *text, picture *p) {
    int end = 0;
    bool read = sscanf(text, "%5dx%5d%n", &p->width, &p->height, &end) == 2 && text[end] == '\0';
    if (!read || p->width < LEAST_SIDE || p->height < LEAST_SIDE || p->width > GREATEST_SIDE || p->height > GREATEST_SIDE)
        argp_error(state, "--size %s: not WIDTHxHEIGHT with %d to %d pixels each, such as 1600x1000", text, LEAST_SIDE, GREATEST_SIDE);
}

static void parse_cut(struct argp_state *state, const char *text, picture *p) {
    static const char *const planes[] = {"sagittal", "coronal", "axial"};
    char plane[16];
    const char *colon = strchrnul(text, ':');
    snprintf(plane, sizeof plane, "%.*s", (int)(colon - text), text);
    p->cut = "xyz"[parse_name(state, "cut", plane, planes, 3)];
    p->place = *colon ? 1e-3 * parse_number(state, "cut", colon + 1, -1e4, 1e4) : NAN;
}

static error_t parse_implant_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    implant_settings *i = &o->implant;
    switch (key) {
    case OPTION_SOURCE: i->dose.source = text, o->live_option = "--source"; break;
    case OPTION_STRENGTH: i->dose.strength = parse_number(state, "strength", text, 1e-3, 1000), o->live_option = "--strength"; break;
    case OPTION_PRESCRIPTION: i->dose.prescription = parse_number(state, "prescription", text, 1, 1e4), o->live_option = "--prescription"; break;
    case OPTION_SWELLING: i->dose.swelling = parse_number(state, "swelling", text, 1, 2), o->live_option = "--swelling"; break;
    case OPTION_PLAN: i->plan = text, o->live_option = "--plan"; break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static error_t parse_picture_option(int key, char *text, struct argp_state *state) {
    static const char *const views[] = {"oblique", "side", "above", "along"}, *const themes[] = {"light", "dark"};
    options *o = state->input;
    switch (key) {
    case OPTION_AT: o->at = parse_number(state, "at", text, 0, 1e6), o->picture_option = "--at"; break;
    case OPTION_SIZE: parse_size(state, text, &o->picture), o->picture_option = "--size"; break;
    case OPTION_VIEW: o->picture.view = 1 + parse_name(state, "view", text, views, 4), o->picture_option = "--view"; break;
    case OPTION_CUT: parse_cut(state, text, &o->picture), o->picture_option = "--cut"; break;
    case OPTION_THEME: o->picture.theme = themes[parse_name(state, "theme", text, themes, 2)], o->picture_option = "--theme"; break;
    default: return parse_implant_option(key, text, state);
    }
    return 0;
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 's': o->scene_path = text; break;
    case 'p': o->web.port = (int)parse_number(state, "port", text, 0, 65535); break;
    case OPTION_URL: o->lcm_url = text; break;
    case OPTION_BIND: o->web.address = text; break;
    case OPTION_SOCKET: o->web.socket = text; break;
    case OPTION_HOST: o->web.host = text; break;
    case OPTION_PAGE: o->web.page = text; break;
    case OPTION_LOG: o->log_path = text; break;
    case OPTION_PNG: o->png_path = text; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (!o->scene_path) argp_error(state, "--scene is missing");
        if (o->png_path && !o->log_path) argp_error(state, "--png needs --log");
        if (o->picture_option && !o->png_path) argp_error(state, "%s needs --png", o->picture_option);
        if (o->live_option && o->log_path) argp_error(state, "%s needs a live server, not --log", o->live_option);
        if (o->png_path) o->web.port = 0, o->web.address = o->web.socket = NULL;
        break;
    default: return parse_picture_option(key, text, state);
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Shows a running trocar-server, or a recorded log, in any number of browsers, and lets one of them drive a needle.",
    NULL, NULL, NULL};

/* ---- callbacks of the web server ---- */

/* Members of an object. */
static void write_needle(const view *v, const trocar_status_t *s, json *j) {
    static const char *const states[] = {"held", "leaving", "resting", "taking"};
    unsigned bit;
    const char *word;
    json_text(j, "message", s->message);
    json_text(j, "state", (size_t)s->state < sizeof states / sizeof *states ? states[s->state] : "");
    json_text(j, "owned", s->owner == 0 ? "nobody" : s->owner == v->pilot.session ? "here" : "elsewhere");
    json_open(j, "flags", '[');
    for (int i = 0; flag_at(i, &bit, &word); i++)
        if ((unsigned)s->flags & bit) json_text(j, NULL, word);
    json_close(j, ']');
}

static void write_needles(const view *v, json *j) {
    if (v->feed.needles[0].status) json_text(j, "scene", v->feed.needles[0].status->scene);
    json_open(j, "needles", '[');
    for (int i = 0; i < v->needle_count; i++) {
        json_open(j, NULL, '{');
        if (v->feed.needles[i].status) write_needle(v, v->feed.needles[i].status, j);
        json_close(j, '}');
    }
    json_close(j, ']');
}

/* "elsewhere": another client has moved it; it may be silent now. */
static void write_probe(const view *v, json *j) {
    const trocar_probe *p = &v->feed.probe;
    json_open(j, "probe", '{');
    json_text(j, "owned", v->feed.probe_owner == 0 ? "nobody" : v->feed.probe_owner == v->pilot.session ? "here" : "elsewhere");
    json_numbers(j, "force", p->force, 3);
    json_integer(j, "contacts", p->contacts);
    json_close(j, '}');
}

/* State of the browser and of the server, as JSON: see page/src/link.js. */
static char *describe(void *context, bool drives, bool driven) {
    const view *v = context;
    char *text = NULL;
    size_t length = 0;
    FILE *out = open_memstream(&text, &length);
    if (!out) return NULL;
    bool alive = v->lcm && subscriber_alive(&v->feed);
    double now = v->lcm ? subscriber_time(&v->feed) : v->timeline.now;
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_number(&j, "now", now);
    json_bool(&j, "alive", alive);
    json_bool(&j, "drives", drives);
    json_bool(&j, "driven", driven);
    json_integer(&j, "needle", v->driven); /* also while the server is silent: the page may still drive it */
    if (alive) {
        json_number(&j, "rate", v->feed.timing.rate_hz);
        json_bool(&j, "shown", subscriber_shows(&v->feed));
        if (v->feed.probe.placed) write_probe(v, &j);
        write_needles(v, &j);
    }
    if (*v->cut.text) json_text(&j, "message", v->cut.text);
    json_close(&j, '}');
    fclose(out);
    return text;
}

/* The order to go to a hole that a browser has chosen. False: there is no such hole, or the needle is not known to be outside of the tissue: of one that
   has just been taken the last wrench may be from before it rested. */
static bool order_hole(const view *v, const float *asked, publisher_order *order) {
    trocar_guide guide = trocar_model_guide(v->model, (int)fmaxf(-1, fminf(asked[0], 1000)));
    double column = asked[1], row = asked[2];
    if (!(column >= 0 && column <= guide.columns - 1 && row >= 0 && row <= guide.rows - 1)) return false;
    *order = (publisher_order){.kind = ORDER_HOLE, .home = hole_home(&guide, column, row, v->needle_length)};
    const trocar_needle_wrench_t *wrench = &v->feed.needles[v->driven].wrench;
    return wrench->session == v->pilot.session && wrench->depth == 0.0;
}

static bool rests(const view *v, int needle) {
    const trocar_status_t *status = v->feed.needles[needle].status;
    return status && status->state == TROCAR_STATUS_T_RESTING;
}

/* In front of the template's hole that is closest to a base; `otherwise` without a template. */
static pose home_of_base(const view *v, pose base, pose otherwise) {
    int template = find_template(v->model);
    if (template < 0) return otherwise;
    trocar_guide guide = trocar_model_guide(v->model, template);
    return hole_home_beside(&guide, base, v->needle_length);
}

static void begin_handover(view *v, handover what) {
    v->handing = what;
    v->handing_since = monotonic_ns();
}

static publisher_order order_take(view *v, int needle) {
    publisher_order order = {.kind = ORDER_TAKE, .needle = needle, .rests = rests(v, needle), .home = v->homes[needle], .base = v->homes[needle]};
    pose base;
    if (subscriber_base(&v->feed, needle, &base) && v3_norm(v3_sub(base.position, order.home.position)) < FAR) order.base = base;
    if (order.rests) order.home = home_of_base(v, order.base, order.home);
    v->driven = needle;
    v->driving = true;
    begin_handover(v, order.rests ? HANDING_TAKEN : HANDING_NOTHING);
    return order;
}

static void act(void *context, const web_action *action) {
    view *v = context;
    if (!v->lcm) return;
    const float *c = action->steer;
    publisher_order order = {.command = {c[0], c[1], c[2], c[3], c[4], c[5]}};
    switch (action->kind) {
    case ACTION_TAKE: order = order_take(v, (int)action->needle); break;
    case ACTION_STEER: order.kind = ORDER_STEER; break;
    case ACTION_RESET: order.kind = ORDER_RESET; break;
    case ACTION_DROP:
        order.kind = ORDER_DROP;
        order.seeds = (int)fminf(16, fmaxf(1, c[0])); /* one if it is no number */
        break;
    case ACTION_UNDO: order.kind = ORDER_UNDO; break;
    case ACTION_PROBE:
        if (!v->feed.probe.placed) return;
        order.kind = ORDER_PROBE;
        order.base = load_pose(v->feed.probe.base.position, v->feed.probe.base.orientation);
        break;
    case ACTION_HOLE:
        if (v->handing != HANDING_NOTHING || !order_hole(v, c, &order)) return;
        break;
    case ACTION_LEAVE:
        if (v->handing != HANDING_NOTHING) return;
        order.kind = ORDER_LEAVE;
        begin_handover(v, HANDING_LEFT);
        break;
    case ACTION_REMOVE:
        if (action->needle >= (uint32_t)v->needle_count || !rests(v, (int)action->needle)) return;
        order.kind = ORDER_REMOVE;
        order.needle = (int)action->needle;
        break;
    default:
        order.kind = ORDER_RELEASE;
        v->driving = false;
        v->handing = HANDING_NOTHING;
        break;
    }
    publisher_tell(&v->pilot, &order);
}

/* The server's answer to the hand-over of the driven needle. Its next status may come a while later: until then, a needle that has been left would look as
   if it could be driven without being taken. */
static void heed_reply(view *v) {
    const trocar_command_reply_t *reply = v->feed.reply;
    bool is_new = v->feed.replies_heard != v->replies_heeded;
    v->replies_heeded = v->feed.replies_heard;
    if (!is_new || !reply || reply->needle != v->driven || v->handing == HANDING_NOTHING) return;
    bool left = reply->command == TROCAR_COMMAND_T_LEAVE, taken = reply->command == TROCAR_COMMAND_T_TAKE, done = reply->status == TROCAR_COMMAND_REPLY_T_DONE;
    if (!left && !taken) return;
    trocar_status_t *status = v->feed.needles[v->driven].status;
    if (left && done && status) status->state = TROCAR_STATUS_T_RESTING;
    if (left == done) web_let_go(v->web); /* it rests */
    else publisher_tell(&v->pilot, &(publisher_order){.kind = ORDER_GO_ON});
    if (left) v->handing = HANDING_NOTHING; /* that it has been taken is seen in its status a little later */
}

/* Ends a hand-over of which no more is to be expected. */
static void watch_handover(view *v) {
    const trocar_status_t *status = v->feed.needles[v->driven].status;
    bool taken = v->handing == HANDING_TAKEN && status && status->state == TROCAR_STATUS_T_HELD;
    if (taken || monotonic_ns() - v->handing_since > HANDOVER_PATIENCE) v->handing = HANDING_NOTHING;
}

/* Receives messages. After a change of server the driving browser loses the needle, because the new server starts without an
   insertion. */
static void receive(view *v) {
    while (lcm_handle_timeout(v->lcm, 0) > 0) continue;
    if (v->feed.servers != v->servers) web_let_go(v->web);
    v->servers = v->feed.servers;
    heed_reply(v);
    watch_handover(v);
    implant_hear(&v->implant, &v->feed);
}

/* Whether a server is running and this needle neither rests, unless it is being handed over, nor is owned by another client. */
static bool is_free(const view *v, int needle) {
    int64_t owner = subscriber_owner(&v->feed, needle);
    const trocar_status_t *status = v->feed.needles[needle].status;
    bool held = status == NULL || status->state == TROCAR_STATUS_T_HELD || (needle == v->driven && v->handing != HANDING_NOTHING);
    return subscriber_alive(&v->feed) && held && (owner == 0 || owner == v->pilot.session);
}

/* Receives pending messages first. A browser that drives none may take a needle that rests. */
static bool may_drive(void *context, uint32_t needle) {
    view *v = context;
    if (!v->lcm || needle >= (uint32_t)v->needle_count) return false;
    receive(v);
    return is_free(v, (int)needle) || (!v->driving && subscriber_alive(&v->feed) && rests(v, (int)needle));
}

static void take_png(void *context, const void *png, size_t size) {
    view *v = context;
    v->png_taken = fwrite(png, 1, size, v->png.file) == size;
    v->stop = true;
}

/* ---- descriptors ---- */

static void on_lcm(void *context) {
    view *v = context;
    receive(v);
    if (!is_free(v, v->driven)) web_let_go(v->web);
    publisher_hear(&v->pilot, v->feed.heard);
    web_news(v->web);
}

static void on_dose(void *context) {
    view *v = context;
    implant_note_dose(&v->implant);
    web_news(v->web);
}

static int stop_wake = -1;

static void on_signal(int signal) {
    (void)signal;
    int error = errno;
    wake(stop_wake);
    errno = error;
}

static void on_stop(void *context) {
    view *v = context;
    v->stop = true;
}

static trocar_status watch_signals(view *v, report *why) {
    stop_wake = v->stop_wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    return web_watch(v->web, v->stop_wake, on_stop, why);
}

/* ---- set-up ---- */

static void find_box(view *v) {
    const double *nodes = trocar_model_nodes(v->model);
    v->low = v3(INFINITY, INFINITY, INFINITY);
    v->high = v3_scale(-1, v->low);
    for (int n = 0; n < trocar_model_node_count(v->model); n++) {
        const double *x = nodes + 3 * n;
        v->low = v3(fmin(v->low.x, x[0]), fmin(v->low.y, x[1]), fmin(v->low.z, x[2]));
        v->high = v3(fmax(v->high.x, x[0]), fmax(v->high.y, x[1]), fmax(v->high.z, x[2]));
    }
}

/* The scene's start; in front of the middle of its template; or along z with the tip 2 mm in front of the surface at the middle of the body; further needles beside it. */
static pose find_home(const view *v, int needle) {
    double aside = (needle % 2 ? 0.01 : -0.01) * ((needle + 1) / 2 % 3); /* m, to both sides in turn */
    pose start;
    if (find_start(v->scene, NULL, NULL, &start)) {
        start.position = v3_add(start.position, q_rotate(start.orientation, v3(aside, 0, 0)));
        return start;
    }
    int template = find_template(v->model);
    if (template >= 0) {
        trocar_guide guide = trocar_model_guide(v->model, template);
        return hole_home(&guide, 0.5 * (guide.columns - 1) + aside / guide.spacing, 0.5 * (guide.rows - 1), v->needle_length);
    }
    double x = 0.5 * (v->low.x + v->high.x) + aside, y = 0.5 * (v->low.y + v->high.y), margin = 0.002;
    const double from[3] = {x, y, v->low.z - margin}, to[3] = {x, y, v->high.z + margin};
    double skin[3] = {x, y, v->low.z};
    trocar_model_entry(v->model, from, to, skin);
    return (pose){v3(x, y, skin[2] - margin - v->needle_length), {1, 0, 0, 0}};
}

/* The page is in the build folder of the program, or in share/trocar if it is installed. */
static const char *page_folder(const options *o, char *place, size_t size) {
    static const char beside[] = "/page", installed[] = "/../share/trocar/page";
    if (o->web.page) return o->web.page;
    ssize_t length = readlink("/proc/self/exe", place, size - sizeof installed);
    if (length < 0) return beside + 1;
    place[length] = '\0';
    char *end = strrchr(place, '/');
    strcpy(end, beside);
    if (access(place, F_OK) != 0) strcpy(end, installed);
    return place;
}

static trocar_status open_web(view *v, report *why) {
    web_settings settings = v->options->web;
    settings.page = page_folder(v->options, v->page, sizeof v->page);
    settings.timeline = &v->timeline;
    settings.scene = &v->encoded_scene;
    settings.sections = v->implant.sections;
    settings.section_count = IMPLANT_SECTIONS;
    settings.context = v;
    settings.describe = describe;
    settings.act = act;
    settings.may_drive = may_drive;
    settings.take_png = v->options->png_path ? take_png : NULL;
    encode_scene(&v->encoded_scene, v->scene, v->model, v->homes, v->needle_count, v->options->log_path == NULL);
    if (v->encoded_scene.failed) return fail(why, TROCAR_NO_MEMORY, "no memory for the scene's picture");
    trocar_status status = web_create(&settings, &v->web, why);
    return status == TROCAR_OK ? watch_signals(v, why) : status;
}

static trocar_status open_live(view *v, report *why) {
    const char *url = v->options->lcm_url;
    v->lcm = lcm_create(url);
    if (!v->lcm)
        return fail(why, TROCAR_SYSTEM, "cannot open LCM at %s: is there a multicast route (docs/troubleshooting.md)?", url ? url : "its default URL");
    trocar_status status = subscriber_open(&v->feed, v->lcm, v->model, &v->timeline, why);
    if (status == TROCAR_OK) status = web_watch(v->web, lcm_get_fileno(v->lcm), on_lcm, why);
    if (status == TROCAR_OK) status = publisher_create(&v->pilot, v->lcm, v->needle_length, why);
    if (status == TROCAR_OK && v->implant.dose) status = web_watch(v->web, dose_thread_descriptor(v->implant.dose), on_dose, why);
    if (status != TROCAR_OK) return status;
    v->feed.session = v->pilot.session;
    v->piloting = pthread_create(&v->pilot_thread, NULL, publisher_run, &v->pilot) == 0;
    if (v->piloting) return TROCAR_OK;
    publisher_free(&v->pilot);
    return fail(why, TROCAR_SYSTEM, "cannot create a thread: %s", strerror(errno));
}

static trocar_status open_log(view *v, report *why) {
    const options *o = v->options;
    trocar_status status = TROCAR_OK;
    if (o->png_path) status = output_open(&v->png, o->png_path, why);
    if (status != TROCAR_OK) return status;
    status = o->png_path ? playback_moment(v->scene, o->log_path, o->at, &v->timeline, &v->cut, why)
                         : playback_run(v->scene, o->log_path, &v->timeline, &v->cut, why);
    if (*v->cut.text) fprintf(stderr, "trocar-view: %s; showing it up to there\n", v->cut.text);
    return status;
}

static trocar_status check_cut(const view *v, report *why) {
    const picture *p = &v->options->picture;
    if (!p->cut || isnan(p->place)) return TROCAR_OK;
    vec3 low = v->low, high = v->high;
    double from = p->cut == 'x' ? low.x : p->cut == 'y' ? low.y : low.z, to = p->cut == 'x' ? high.x : p->cut == 'y' ? high.y : high.z;
    if (p->place > from && p->place < to) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "--cut: %c = %g mm does not cross the body, which extends from %.1f to %.1f mm", p->cut, 1e3 * p->place,
                1e3 * from, 1e3 * to);
}

static trocar_status prepare(view *v, report *why) {
    const options *o = v->options;
    const trocar_model_options mesh_only = {.mesh_only = 1};
    trocar_status status = trocar_scene_load(o->scene_path, &v->scene, why);
    if (status == TROCAR_OK) status = trocar_model_create(v->scene, &mesh_only, &v->model, why);
    if (status == TROCAR_OK) status = trocar_scene_get_number(v->scene, "needle.length", &v->needle_length, why);
    if (status != TROCAR_OK) return status;
    find_box(v);
    status = check_cut(v, why);
    if (status != TROCAR_OK) return status;
    const char *remarks = trocar_model_remarks(v->model);
    if (remarks[0]) fprintf(stderr, "trocar-view: warning: %s\n", remarks);
    v->needle_count = o->log_path ? 1 : trocar_model_needles(v->model);
    for (int i = 0; i < v->needle_count; i++) v->homes[i] = find_home(v, i);
    status = timeline_create(&v->timeline, o->log_path == NULL, v->needle_count, why);
    if (status == TROCAR_OK) status = o->log_path ? open_log(v, why) : implant_open(&v->implant, v->model, &o->implant, why);
    if (status == TROCAR_OK) status = open_web(v, why);
    return status == TROCAR_OK && !o->log_path ? open_live(v, why) : status;
}

static void clean_up(view *v) {
    if (v->web) web_free(v->web); /* first, because a driving browser releases the needle when its connection closes */
    if (v->piloting) {
        publisher_tell(&v->pilot, &(publisher_order){.kind = ORDER_END});
        pthread_join(v->pilot_thread, NULL);
        publisher_free(&v->pilot);
    }
    subscriber_close(&v->feed);
    implant_close(&v->implant);
    if (v->lcm) lcm_destroy(v->lcm);
    output_abandon(&v->png);
    timeline_free(&v->timeline);
    bytes_free(&v->encoded_scene);
    trocar_model_free(v->model);
    trocar_scene_free(v->scene);
}

/* ---- running ---- */

static void say_ready(const view *v) {
    const web_settings *w = &v->options->web;
    const char *address = w->address ? w->address : "127.0.0.1";
    if (w->socket) printf("unix:%s\n", w->socket);
    else printf(strchr(address, ':') ? "http://[%s]:%d/\n" : "http://%s:%d/\n", address, web_port(v->web));
    puts("ready");
    fflush(stdout);
}

static void serve(view *v) {
    say_ready(v);
    while (!v->stop) web_round(v->web);
}

/* URL of the page with the parameters of the picture: see pose in page/src/main.js. */
static void picture_url(const view *v, size_t size, char *url) {
    const picture *p = &v->options->picture;
    int length = snprintf(url, size, "http://127.0.0.1:%d/?picture&width=%d&height=%d&view=%d&theme=%s", web_port(v->web), p->width, p->height,
                          p->view, p->theme);
    if (p->cut) length += snprintf(url + length, size - (size_t)length, "&cut=%c", p->cut);
    if (p->cut && !isnan(p->place)) snprintf(url + length, size - (size_t)length, "&place=%.9g", p->place);
}

/* The page renders the picture and sends it back. */
static trocar_status take_picture(view *v, report *why) {
    char url[256];
    picture_url(v, sizeof url, url);
    chromium browser;
    trocar_status status = chromium_start(&browser, url, why);
    int64_t deadline = monotonic_ns() + PICTURE_PATIENCE;
    while (status == TROCAR_OK && !v->stop) {
        web_round(v->web); /* returns at least every 0.1 s because of its timer */
        if (chromium_ended(&browser))
            status = fail(why, TROCAR_SYSTEM, "chromium exited without a picture: is Debian's package chromium installed?");
        else if (monotonic_ns() > deadline) status = fail(why, TROCAR_SYSTEM, "no picture from chromium in %d s", (int)(PICTURE_PATIENCE / 1000000000));
    }
    chromium_stop(&browser);
    if (status == TROCAR_OK && !v->png_taken) status = fail(why, TROCAR_SYSTEM, "%s: not written because of an interrupt", v->options->png_path);
    return status == TROCAR_OK ? output_commit(&v->png, why) : status;
}

int main(int count, char **arguments) {
    options o = {.at = INFINITY, .implant.dose = {"I-125 6711", 0.5, 145.0, 1.18}, .web.port = WEB_PORT, .picture = {.width = 1600, .height = 1000, .view = 1, .theme = "light"}};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    realtime_flush_denormals();   /* as in trocar-replay, so that results are the same */

    static view v;
    v.options = &o;
    report why;
    trocar_status status = prepare(&v, &why);
    if (status == TROCAR_OK && o.png_path) status = take_picture(&v, &why);
    else if (status == TROCAR_OK) serve(&v);
    clean_up(&v);
    if (status == TROCAR_OK) return EXIT_SUCCESS;
    fprintf(stderr, "trocar-view: %s\n", why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
