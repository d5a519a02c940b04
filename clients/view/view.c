/* trocar-view: shows a live scene or a recorded log in browsers, and saves pictures of a log. */
#define _GNU_SOURCE
#include <errno.h>
#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/progress.h"
#include "common/realtime.h"
#include "common/timing.h"
#include "common/eventfd_signal.h"
#include "lcm_filter.h"
#include "shared/events.h"
#include "shared/json.h"
#include "shared/options.h"
#include "shared/output.h"
#include "trocar_change_t.h"
#include "view/hand/parking_poses.h"
#include "view/hand/pilot.h"
#include "view/implant/implant.h"
#include "view/stream/playback.h"
#include "view/training/training.h"
#include "view/ultrasound/scanner.h"
#include "view/web/chromium.h"
#include "view_options.h"

static const int64_t PICTURE_PATIENCE = 60000000000; /* ns to wait for a picture */

typedef struct {
    const view_options *options;
    trocar_scene *scene;
    trocar_model *model;     /* used only for its mesh; nothing is simulated */
    double needle_length;    /* m */
    int needle_count;        /* needles of a live scene; a log shows one */
    pose parking_poses[TROCAR_MAX_NEEDLES]; /* where each needle waits outside the tissue */
    timeline timeline;
    byte_buffer encoded_scene;
    char page[4096];         /* folder with the page */
    web *web;
    int stop_wake;
    bool stop;

    lcm_t *lcm;              /* live only */
    subscriber feed;
    pilot pilot;
    implant implant;
    scanner *scanner;        /* live only */
    web_section ultrasound;  /* the newest images */
    training training;
    trocar_error cut;        /* where the log is truncated; empty if it is complete */

    output png;              /* --png only */
    bool png_taken;
} view;

/* ---- callbacks of the web server ---- */

/* Writes the status of a needle as members of a JSON object. */
static void write_needle(const view *v, int needle, json *j) {
    static const char *const states[] = {"held", "leaving", "resting", "taking"};
    const trocar_status_t *s = v->feed.needles[needle].status;
    int64_t owner = subscriber_owner(&v->feed, needle);
    unsigned bit;
    const char *word;
    json_text(j, "message", s->message);
    json_text(j, "state", (size_t)s->state < sizeof states / sizeof *states ? states[s->state] : "");
    json_text(j, "owned", owner == 0 ? "nobody" : owner == v->pilot.publisher.session ? "here" : "elsewhere");
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
        if (v->feed.needles[i].status) write_needle(v, i, j);
        json_close(j, '}');
    }
    json_close(j, ']');
}

/* Writes the probe's owner, force and contacts. The owner "elsewhere" means another client, which may be silent by now. */
static void write_probe(const view *v, json *j) {
    const trocar_probe *p = &v->feed.probe;
    json_open(j, "probe", '{');
    json_text(j, "owned", v->feed.probe_owner == 0 ? "nobody" : v->feed.probe_owner == v->pilot.publisher.session ? "here" : "elsewhere");
    json_numbers(j, "force", p->force, 3);
    json_integer(j, "contacts", p->contacts);
    json_close(j, '}');
}

/* Writes the values that can be changed while the server runs, and the reply to the last change. */
static void write_values(const view *v, json *j) {
    const trocar_values_t *values = v->feed.values;
    const trocar_command_reply_t *reply = v->feed.change_reply;
    if (values) {
        json_open(j, "values", '{');
        for (int i = 0; i < values->count; i++) json_exact(j, values->key[i], values->value[i]);
        json_close(j, '}');
    }
    if (!reply) return;
    json_open(j, "changed", '{');
    json_integer(j, "number", reply->seq);
    json_bool(j, "done", reply->status == TROCAR_COMMAND_REPLY_T_DONE);
    json_text(j, "message", reply->message);
    json_close(j, '}');
}

/* Writes how many servers have been followed so far, why a browser has lost the needle, and the hole that the driven needle was sent to. */
static void write_pilot(view *v, json *j) {
    pilot *p = &v->pilot;
    json_integer(j, "server", v->feed.servers);
    json_text(j, "lost", p->lost ? p->lost : "");
    if (!p->has_hole) return;
    json_open(j, "hole", '{');
    json_integer(j, "guide", p->guide);
    json_integer(j, "column", p->column);
    json_integer(j, "row", p->row);
    json_bool(j, "approaching", atomic_load(&p->publisher.approaching));
    json_close(j, '}');
}

/* Returns the state of the browser and of the server as JSON, for the handler `status` in page/src/main.js. */
static char *describe(void *context, const web_page *page) {
    view *v = context;
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
    json_bool(&j, "drives", page->driver == page->number);
    json_bool(&j, "driven", page->driver != 0);
    json_integer(&j, "page", page->number);
    json_integer(&j, "pages", page->count);
    json_integer(&j, "driver", page->driver);
    json_integer(&j, "steered", page->steered);
    json_integer(&j, "needle", v->pilot.needle); /* written even if the server is silent, because the page may still be driving the needle */
    write_pilot(v, &j);
    if (alive) {
        json_number(&j, "rate", v->feed.timing.rate_hz);
        json_bool(&j, "shown", subscriber_shows(&v->feed));
        if (v->feed.probe.placed) write_probe(v, &j);
        write_values(v, &j);
        write_needles(v, &j);
    }
    training_write(&v->training, &v->feed, &j);
    if (*v->cut.text) json_text(&j, "message", v->cut.text);
    json_close(&j, '}');
    fclose(out);
    return text;
}

/* Starts on the next ultrasound images once the last ones have been computed and sent to a browser. Images that nobody sees would only slow down the
   browser. */
static void scan(view *v) {
    if (v->scanner && !scanner_busy(v->scanner) && web_delivered(v->web, &v->ultrasound)) scanner_tell(v->scanner, &v->feed);
}

static void look(view *v, const web_action *action) {
    if (!v->scanner) return;
    scanner_look(v->scanner, action);
    scan(v);
}

static void act(void *context, const web_action *action) {
    view *v = context;
    if (action->kind == ACTION_START) training_start(&v->training, &v->feed);
    else if (action->kind == ACTION_FINISH) training_finish(&v->training, &v->feed, action->needle);
    else if (action->kind == ACTION_LOOK) look(v, action);
    else if (v->lcm) pilot_act(&v->pilot, action);
}

/* Passes a browser's change on to the server, which checks it. */
static void change(void *context, const web_action *action, const char *values) {
    const view *v = context;
    if (!v->lcm) return;
    trocar_change_t m = {.utime = wall_us(), .session = v->pilot.publisher.session, .seq = action->needle, .time = action->steer[0], .values = (char *)(uintptr_t)values};
    trocar_change_t_publish(v->lcm, "TROCAR_CHANGE", &m);
}

static void receive(view *v) {
    while (lcm_handle_timeout(v->lcm, 0) > 0) continue;
    pilot_hear(&v->pilot);
    implant_hear(&v->implant, &v->feed);
    training_watch(&v->training, &v->feed);
    scan(v);
}

/* True if a browser may drive this needle. First handles the messages that have arrived. */
static bool may_drive(void *context, uint32_t needle) {
    view *v = context;
    if (!v->lcm || needle >= (uint32_t)v->needle_count) return false;
    receive(v);
    const char *trouble = v->pilot.driving ? pilot_trouble(&v->pilot, v->pilot.needle) : NULL;
    if (trouble) pilot_let_go(&v->pilot, trouble);
    return pilot_may_take(&v->pilot, (int)needle);
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
    const char *trouble = pilot_trouble(&v->pilot, v->pilot.needle);
    if (trouble) pilot_let_go(&v->pilot, trouble);
    publisher_hear(&v->pilot.publisher, v->feed.heard);
    web_news(v->web);
}

static void on_dose(void *context) {
    view *v = context;
    implant_note_dose(&v->implant);
    web_news(v->web);
}

static void on_ultrasound(void *context) {
    view *v = context;
    if (scanner_take(v->scanner, &v->ultrasound.bytes)) v->ultrasound.version++;
    web_news(v->web);
}

static int stop_wake = -1;

static void on_signal(int signal) {
    (void)signal;
    int error = errno;
    eventfd_signal(stop_wake);
    errno = error;
}

static void on_stop(void *context) {
    view *v = context;
    v->stop = true;
}

static trocar_status watch_signals(view *v, trocar_error *why) {
    stop_wake = v->stop_wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGHUP, &action, NULL);
    return web_watch(v->web, v->stop_wake, on_stop, why);
}

/* ---- set-up ---- */

/* Finds the folder with the page: in the build folder or, if the program is installed, in share/trocar. */
static const char *page_folder(const view_options *o, char *place, size_t size) {
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

static trocar_status open_web(view *v, trocar_error *why) {
    web_settings settings = v->options->web;
    settings.page = page_folder(v->options, v->page, sizeof v->page);
    settings.timeline = &v->timeline;
    settings.scene = &v->encoded_scene;
    settings.task_folder = v->training.task ? v->training.prepared : NULL;
    settings.runs_folder = v->training.task ? v->training.runs : NULL;
    for (int i = 0; i < IMPLANT_SECTIONS; i++) settings.sections[settings.section_count++] = &v->implant.sections[i];
    settings.sections[settings.section_count++] = &v->ultrasound;
    settings.context = v;
    settings.describe = describe;
    settings.act = act;
    settings.change = change;
    settings.may_drive = may_drive;
    settings.take_png = v->options->png_path ? take_png : NULL;
    encode_scene(&v->encoded_scene, v->scene, v->model, v->parking_poses, v->needle_count, v->options->log_path == NULL);
    if (v->encoded_scene.failed) return fail(why, TROCAR_NO_MEMORY, "no memory for the scene's picture");
    trocar_status status = web_create(&settings, &v->web, why);
    return status == TROCAR_OK ? watch_signals(v, why) : status;
}

static trocar_status open_live(view *v, trocar_error *why) {
    const char *url = v->options->lcm_url;
    v->lcm = lcm_filter_create_wide(url);
    if (!v->lcm)
        return fail(why, TROCAR_SYSTEM, "cannot open LCM at %s: is there a multicast route (docs/troubleshooting.md)?", url ? url : "its default URL");
    trocar_status status = subscriber_open(&v->feed, v->lcm, v->model, &v->timeline, why);
    if (status == TROCAR_OK) status = training_open(&v->training, v->lcm, &v->pilot, why);
    if (status == TROCAR_OK) status = web_watch(v->web, lcm_get_fileno(v->lcm), on_lcm, why);
    if (status == TROCAR_OK && v->implant.dose) status = web_watch(v->web, dose_thread_descriptor(v->implant.dose), on_dose, why);
    if (status == TROCAR_OK) status = scanner_create(v->scene, v->model, &v->scanner, why);
    if (status == TROCAR_OK) status = web_watch(v->web, scanner_descriptor(v->scanner), on_ultrasound, why);
    if (status != TROCAR_OK) return status;
    v->pilot = (pilot){.model = v->model, .parking_poses = v->parking_poses, .needle_length = v->needle_length, .feed = &v->feed, .web = v->web};
    return pilot_open(&v->pilot, v->lcm, why);
}

static trocar_status open_log(view *v, trocar_error *why) {
    const view_options *o = v->options;
    trocar_status status = TROCAR_OK;
    if (o->png_path) status = output_open(&v->png, o->png_path, why);
    if (status != TROCAR_OK) return status;
    status = o->png_path ? playback_moment(v->scene, o->log_path, o->at, &v->timeline, &v->cut, why)
                         : playback_run(v->scene, o->log_path, &v->timeline, &v->cut, why);
    if (*v->cut.text) fprintf(stderr, "trocar-view: %s; showing it up to there\n", v->cut.text);
    return status;
}

static trocar_status check_cut(const view *v, trocar_error *why) {
    const picture *p = &v->options->picture;
    if (!p->cut || isnan(p->place)) return TROCAR_OK;
    vec3 low, high;
    find_mesh_box(v->model, &low, &high);
    double from = p->cut == 'x' ? low.x : p->cut == 'y' ? low.y : low.z, to = p->cut == 'x' ? high.x : p->cut == 'y' ? high.y : high.z;
    if (p->place > from && p->place < to) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "--cut: %c = %g mm does not cross the body, which extends from %.1f to %.1f mm", p->cut, 1e3 * p->place,
                1e3 * from, 1e3 * to);
}

static trocar_status prepare(view *v, trocar_error *why) {
    const view_options *o = v->options;
    const trocar_model_options mesh_only = {.mesh_only = 1, .log = {progress_warn, "trocar-view"}};
    trocar_status status = trocar_scene_load(o->scene_path, &v->scene, why);
    if (status == TROCAR_OK) status = trocar_model_create(v->scene, &mesh_only, &v->model, why);
    if (status == TROCAR_OK) status = trocar_scene_get_number(v->scene, "needle.length", &v->needle_length, why);
    if (status != TROCAR_OK) return status;
    status = check_cut(v, why);
    if (status != TROCAR_OK) return status;
    v->needle_count = o->log_path ? 1 : trocar_model_needles(v->model);
    find_parking_poses(v->scene, v->model, v->needle_length, v->needle_count, v->parking_poses);
    status = timeline_create(&v->timeline, o->log_path == NULL, v->needle_count, why);
    if (status == TROCAR_OK) status = o->log_path ? open_log(v, why) : implant_open(&v->implant, v->model, &o->implant, why);
    if (status == TROCAR_OK) status = open_web(v, why);
    return status == TROCAR_OK && !o->log_path ? open_live(v, why) : status;
}

static void clean_up(view *v) {
    if (v->web) web_free(v->web); /* freed first, because closing a driving browser's connection releases the needle */
    pilot_close(&v->pilot);
    if (v->scanner) scanner_free(v->scanner);
    bytes_free(&v->ultrasound.bytes);
    training_close(&v->training);
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

/* Writes the page's URL with the parameters of the picture: see pose in page/src/main.js. */
static void picture_url(const view *v, size_t size, char *url) {
    const picture *p = &v->options->picture;
    int length = snprintf(url, size, "http://127.0.0.1:%d/?picture&width=%d&height=%d&view=%d&theme=%s", web_port(v->web), p->width, p->height,
                          p->view, p->theme);
    if (p->cut) length += snprintf(url + length, size - (size_t)length, "&cut=%c", p->cut);
    if (p->cut && !isnan(p->place)) snprintf(url + length, size - (size_t)length, "&place=%.9g", p->place);
}

/* Takes a picture, which the page renders and sends back. */
static trocar_status take_picture(view *v, trocar_error *why) {
    char url[256];
    picture_url(v, sizeof url, url);
    chromium browser;
    trocar_status status = chromium_start(&browser, url, why);
    int64_t deadline = monotonic_ns() + PICTURE_PATIENCE;
    while (status == TROCAR_OK && !v->stop) {
        web_round(v->web); /* its timer makes it return at least every 0.1 s */
        if (chromium_ended(&browser))
            status = fail(why, TROCAR_SYSTEM, "chromium exited without a picture: is Debian's package chromium installed?");
        else if (monotonic_ns() > deadline) status = fail(why, TROCAR_SYSTEM, "no picture from chromium in %d s", (int)(PICTURE_PATIENCE / 1000000000));
    }
    chromium_stop(&browser);
    if (status == TROCAR_OK && !v->png_taken) status = fail(why, TROCAR_SYSTEM, "%s: not written: interrupted", v->options->png_path);
    return status == TROCAR_OK ? output_commit(&v->png, why) : status;
}

/* Takes the scene, the plan and the dose settings from the task. */
static trocar_status read_task(view *v, view_options *o, trocar_error *why) {
    training *t = &v->training;
    if (!o->task) return TROCAR_OK;
    trocar_status status = training_prepare(t, o->task, o->runs, why);
    if (status != TROCAR_OK) return status;
    o->scene_path = t->scene;
    if (*t->plan) o->implant.plan = t->plan;
    if (*t->source) o->implant.dose.source = t->source;
    if (t->strength > 0.0) o->implant.dose.strength = t->strength;
    if (t->prescription > 0.0) o->implant.dose.prescription = t->prescription;
    return TROCAR_OK;
}

int main(int count, char **arguments) {
    view_options o = read_view_options(count, arguments);
    realtime_flush_denormals();   /* as in the server's threads: denormals are slow on some processors */

    static view v;
    v.options = &o;
    trocar_error why;
    trocar_status status = read_task(&v, &o, &why);
    if (status == TROCAR_OK) status = prepare(&v, &why);
    if (status == TROCAR_OK && o.png_path) status = take_picture(&v, &why);
    else if (status == TROCAR_OK) serve(&v);
    clean_up(&v);
    if (status == TROCAR_OK) return EXIT_SUCCESS;
    fprintf(stderr, "trocar-view: %s\n", why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
