/* trocar-view: the live scene, or a recorded log, in a browser; and pictures of a log. */
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
#include "json.h"
#include "options.h"
#include "output.h"
#include "pose_publisher.h"
#include "playback.h"
#include "realtime.h"
#include "timing.h"
#include "web.h"

const char *argp_program_version = "trocar-view " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

static const int64_t PICTURE_PATIENCE = 60000000000; /* ns */

/* What a picture shows and how large it is. */
typedef struct {
    int width, height;       /* pixels */
    int view;                /* 1 .. 4, as the page's keys have it */
    const char *theme;
    char cut;                /* axis normal to the cut, 0: none */
    double place;            /* m, where the cut crosses its axis; NAN: where the needle's tip is */
} picture;

typedef struct {
    const char *scene_path, *lcm_url, *log_path, *png_path;
    double at;               /* s; INFINITY: the end of the log */
    picture picture;
    const char *picture_option;   /* the last one given, NULL: none */
    web_settings web;
} options;

typedef struct {
    const options *options;
    scene scene;
    mesh mesh;
    pose home;
    timeline timeline;
    byte_buffer encoded_scene;
    char page[4096];         /* folder of the page */
    web *web;
    int stop_wake;
    bool stop;

    lcm_t *lcm;              /* live only */
    subscriber feed;
    pose_publisher pilot;
    pthread_t pilot_thread;
    bool piloting;           /* that thread runs */
    int64_t servers;         /* as the feed counts them: the one that browsers have been driving on */
    report cut;              /* where the log ends within an event, empty if it is whole */

    output png;              /* --png only */
    bool png_taken;
} view;

/* ---- command line ---- */

enum { OPTION_URL = 256, OPTION_BIND, OPTION_SOCKET, OPTION_HOST, OPTION_PAGE, OPTION_LOG, OPTION_PNG, OPTION_AT,
       OPTION_SIZE, OPTION_VIEW, OPTION_CUT, OPTION_THEME };

enum { LEAST_SIDE = 320, GREATEST_SIDE = 4096 /* pixels: twice as many are drawn for smooth edges */ };

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene of the server or of the log (required)", 0},
    {"lcm-url", OPTION_URL, "URL", 0, "LCM network (default $LCM_DEFAULT_URL)", 0},
    {0, 0, 0, 0, "Where browsers find it:", 1},
    {"port", 'p', "PORT", 0, "TCP port (default 8686; 0: any free one)", 1},
    {"bind", OPTION_BIND, "ADDRESS", 0, "Address to listen on (default 127.0.0.1: this machine only)", 1},
    {"socket", OPTION_SOCKET, "PATH", 0, "Listen on a Unix socket instead, for a proxy", 1},
    {"host", OPTION_HOST, "NAME", 0, "Name of this machine under which its page may be opened, besides localhost and ADDRESS", 1},
    {"page", OPTION_PAGE, "FOLDER", 0, "The built page (default: the one built with this program)", 1},
    {0, 0, 0, 0, "Recorded logs:", 2},
    {"log", OPTION_LOG, "FILE", 0, "Show this LCM event log, its poses run again in lockstep; needs no network", 2},
    {"png", OPTION_PNG, "FILE", 0, "Write one picture of the log and end; uses headless Chromium", 2},
    {"at", OPTION_AT, "SECONDS", 0, "Time of the picture, from the log's first pose (default: the end)", 2},
    {"size", OPTION_SIZE, "WIDTHxHEIGHT", 0, "Size of the picture in pixels, 320 to 4096 each (default 1600x1000)", 2},
    {"view", OPTION_VIEW, "NAME", 0, "Seen from: oblique (default), side, above, or along the needle", 2},
    {"cut", OPTION_CUT, "PLANE[:MM]", 0, "Cut the tissue open in a sagittal, coronal or axial plane, at MM along x, y or z (default: through the tip)", 2},
    {"theme", OPTION_THEME, "NAME", 0, "light (default) or dark", 2},
    {0},
};

/* Place of `text` among `count` names; otherwise ends the program through argp_error. */
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

static error_t parse_picture_option(int key, char *text, struct argp_state *state) {
    static const char *const views[] = {"oblique", "side", "above", "along"}, *const themes[] = {"light", "dark"};
    options *o = state->input;
    switch (key) {
    case OPTION_AT: o->at = parse_number(state, "at", text, 0, 1e6), o->picture_option = "--at"; break;
    case OPTION_SIZE: parse_size(state, text, &o->picture), o->picture_option = "--size"; break;
    case OPTION_VIEW: o->picture.view = 1 + parse_name(state, "view", text, views, 4), o->picture_option = "--view"; break;
    case OPTION_CUT: parse_cut(state, text, &o->picture), o->picture_option = "--cut"; break;
    case OPTION_THEME: o->picture.theme = themes[parse_name(state, "theme", text, themes, 2)], o->picture_option = "--theme"; break;
    default: return ARGP_ERR_UNKNOWN;
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
        if (o->png_path) o->web.port = 0, o->web.address = o->web.socket = NULL;
        break;
    default: return parse_picture_option(key, text, state);
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Shows a running trocar-server, or a recorded log, in any number of browsers, and lets one of them drive the needle.",
    NULL, NULL, NULL};

/* ---- what the web asks ---- */

static void write_status(const view *v, FILE *out) {
    const trocar_status_t *s = v->feed.status;
    if (!s) return;
    fprintf(out, ",\"scene\":");
    json_string(s->scene, out);
    fprintf(out, ",\"message\":");
    json_string(s->message, out);
    fprintf(out, ",\"owned\":%s,\"flags\":%d", s->owner == 0 ? "\"nobody\"" : s->owner == v->pilot.session ? "\"here\"" : "\"elsewhere\"",
            s->flags);
}

/* The browser's part of the state and the server's: see page/src/link.js. */
static char *describe(void *context, bool drives, bool driven) {
    const view *v = context;
    char *text = NULL;
    size_t length = 0;
    FILE *out = open_memstream(&text, &length);
    if (!out) return NULL;
    bool alive = v->lcm && subscriber_alive(&v->feed);
    double now = v->lcm ? subscriber_time(&v->feed) : v->timeline.now;
    fprintf(out, "{\"now\":%.6f,\"alive\":%s,\"drives\":%s,\"driven\":%s", now, alive ? "true" : "false",
            drives ? "true" : "false", driven ? "true" : "false");
    if (alive) {
        fprintf(out, ",\"rate\":%g,\"shown\":%s", v->feed.timing.rate_hz, v->feed.contacts ? "true" : "false");
        write_status(v, out);
    }
    if (*v->cut.text) {
        fprintf(out, ",\"message\":");
        json_string(v->cut.text, out);
    }
    fprintf(out, "}");
    fclose(out);
    return text;
}

static void act(void *context, const web_action *action) {
    view *v = context;
    if (!v->lcm) return;
    const float *c = action->steer;
    publisher_order order = {.base = v->home, .command = {c[0], c[1], c[2], c[3], c[4], c[5]}};
    switch (action->kind) {
    case ACTION_TAKE:
        order.kind = ORDER_TAKE;
        subscriber_base(&v->feed, &order.base);
        break;
    case ACTION_STEER: order.kind = ORDER_STEER; break;
    case ACTION_RESET: order.kind = ORDER_RESET; break;
    default: order.kind = ORDER_RELEASE; break;
    }
    publisher_tell(&v->pilot, &order);
}

/* Takes what has come from the network. A server that was not there before knows nothing of an insertion: nobody drives on. */
static void receive(view *v) {
    while (lcm_handle_timeout(v->lcm, 0) > 0) continue;
    if (v->feed.servers != v->servers) web_let_go(v->web);
    v->servers = v->feed.servers;
}

/* A server feels the needle, and no other client holds it. */
static bool has_needle(const view *v) {
    int64_t owner = v->feed.wrench.session;
    return subscriber_alive(&v->feed) && (owner == 0 || owner == v->pilot.session);
}

/* What still waits to be received counts as heard. */
static bool may_drive(void *context) {
    view *v = context;
    if (!v->lcm) return false;
    receive(v);
    return has_needle(v);
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
    if (!has_needle(v)) web_let_go(v->web);
    publisher_hear(&v->pilot, v->feed.heard);
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

/* A needle along z, its tip 2 mm in front of where the middle of the body begins. */
static pose find_home(const mesh *m, double needle_length) {
    vec3 low = m->bvh[0].low, high = m->bvh[0].high;
    double x = 0.5 * (low.x + high.x), y = 0.5 * (low.y + high.y), margin = 0.002;
    surface_hit hit = mesh_enter(m, v3(x, y, low.z - margin), v3(x, y, high.z + margin));
    double skin = hit.hit ? hit.point.z : low.z;
    return (pose){v3(x, y, skin - margin - needle_length), {1, 0, 0, 0}};
}

/* The page is beside the program where that was built, in share/trocar where it is installed. */
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
    settings.context = v;
    settings.describe = describe;
    settings.act = act;
    settings.may_drive = may_drive;
    settings.take_png = v->options->png_path ? take_png : NULL;
    encode_scene(&v->encoded_scene, &v->scene, &v->mesh, v->home, v->options->log_path == NULL);
    if (v->encoded_scene.failed) return fail(why, TROCAR_NO_MEMORY, "no memory for the scene's picture");
    trocar_status status = web_create(&settings, &v->web, why);
    return status == TROCAR_OK ? watch_signals(v, why) : status;
}

static trocar_status open_live(view *v, report *why) {
    const char *url = v->options->lcm_url;
    v->lcm = lcm_create(url);
    if (!v->lcm)
        return fail(why, TROCAR_SYSTEM, "LCM cannot be opened at %s: is there a multicast route (README.md)?", url ? url : "its default URL");
    trocar_status status = subscriber_open(&v->feed, v->lcm, &v->mesh, v->scene.rate_hz, &v->timeline, why);
    if (status == TROCAR_OK) status = web_watch(v->web, lcm_get_fileno(v->lcm), on_lcm, why);
    if (status == TROCAR_OK) status = publisher_create(&v->pilot, v->lcm, v->home, v->scene.simulation.needle.length, why);
    if (status != TROCAR_OK) return status;
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
    status = o->png_path ? playback_moment(&v->scene, o->log_path, o->at, &v->timeline, &v->cut, why)
                         : playback_run(&v->scene, o->log_path, &v->timeline, &v->cut, why);
    if (*v->cut.text) fprintf(stderr, "trocar-view: %s; it is shown up to there\n", v->cut.text);
    return status;
}

static trocar_status check_cut(const view *v, report *why) {
    const picture *p = &v->options->picture;
    if (!p->cut || isnan(p->place)) return TROCAR_OK;
    vec3 low = v->mesh.bvh[0].low, high = v->mesh.bvh[0].high;
    double from = p->cut == 'x' ? low.x : p->cut == 'y' ? low.y : low.z, to = p->cut == 'x' ? high.x : p->cut == 'y' ? high.y : high.z;
    if (p->place > from && p->place < to) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "--cut: %c = %g mm does not cross the body, which lies from %.1f to %.1f mm", p->cut, 1e3 * p->place,
                1e3 * from, 1e3 * to);
}

static trocar_status prepare(view *v, report *why) {
    const options *o = v->options;
    trocar_status status = scene_load(o->scene_path, &v->scene, why);
    if (status == TROCAR_OK) status = mesh_read_in(v->scene.simulation.mesh_path, v->scene.simulation.mesh_unit, &v->mesh, why);
    if (status == TROCAR_OK) status = check_cut(v, why);
    if (status != TROCAR_OK) return status;
    mesh_compare_with_needle(&v->mesh, v->scene.simulation.needle.length, v->scene.simulation.needle.outer_diameter);
    if (v->mesh.remarks.text[0]) fprintf(stderr, "trocar-view: warning: %s\n", v->mesh.remarks.text);
    v->home = find_home(&v->mesh, v->scene.simulation.needle.length);
    status = timeline_create(&v->timeline, o->log_path == NULL, why);
    if (status == TROCAR_OK && o->log_path) status = open_log(v, why);
    if (status == TROCAR_OK) status = open_web(v, why);
    return status == TROCAR_OK && !o->log_path ? open_live(v, why) : status;
}

static void clean_up(view *v) {
    if (v->web) web_free(v->web); /* first: a browser that drives releases the needle when its connection ends */
    if (v->piloting) {
        publisher_tell(&v->pilot, &(publisher_order){.kind = ORDER_END});
        pthread_join(v->pilot_thread, NULL);
        publisher_free(&v->pilot);
    }
    subscriber_close(&v->feed);
    if (v->lcm) lcm_destroy(v->lcm);
    output_abandon(&v->png);
    timeline_free(&v->timeline);
    bytes_free(&v->encoded_scene);
    mesh_free(&v->mesh);
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

/* The page with what it needs to draw the picture: see pose in page/src/main.js. */
static void picture_url(const view *v, size_t size, char *url) {
    const picture *p = &v->options->picture;
    int length = snprintf(url, size, "http://127.0.0.1:%d/?picture&width=%d&height=%d&view=%d&theme=%s", web_port(v->web), p->width, p->height,
                          p->view, p->theme);
    if (p->cut) length += snprintf(url + length, size - (size_t)length, "&cut=%c", p->cut);
    if (p->cut && !isnan(p->place)) snprintf(url + length, size - (size_t)length, "&place=%.9g", p->place);
}

/* The page draws the picture and sends it back. */
static trocar_status take_picture(view *v, report *why) {
    char url[256];
    picture_url(v, sizeof url, url);
    chromium browser;
    trocar_status status = chromium_start(&browser, url, why);
    int64_t deadline = monotonic_ns() + PICTURE_PATIENCE;
    while (status == TROCAR_OK && !v->stop) {
        web_round(v->web); /* at least every tenth of a second: the web's timer */
        if (chromium_ended(&browser))
            status = fail(why, TROCAR_SYSTEM, "chromium ended without a picture: is Debian's package chromium installed?");
        else if (monotonic_ns() > deadline) status = fail(why, TROCAR_SYSTEM, "no picture from chromium in %d s", (int)(PICTURE_PATIENCE / 1000000000));
    }
    chromium_stop(&browser);
    if (status == TROCAR_OK && !v->png_taken) status = fail(why, TROCAR_SYSTEM, "%s: interrupted before it was written", v->options->png_path);
    return status == TROCAR_OK ? output_commit(&v->png, why) : status;
}

int main(int count, char **arguments) {
    options o = {.at = INFINITY, .web.port = WEB_PORT, .picture = {.width = 1600, .height = 1000, .view = 1, .theme = "light"}};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    realtime_flush_denormals();   /* a log gives the same numbers as in trocar-replay */

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
