#define _GNU_SOURCE
#include "server.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include "common/progress.h"
#include "common/realtime.h"
#include "common/session.h"
#include "haptic.h"
#include "io.h"
#include "lcm_filter.h"
#include "relay.h"
#include "telemetry.h"
#include "trocar_needle_wrench_t.h"
#include "unicast/settings.h"

typedef struct {
    pthread_t thread;
    bool running;
} task;

struct server {
    server_options options;
    trocar_scene *scene;
    double rate_hz;
    bool phase_lock;
    int64_t id;                  /* ID of this server, sent with all its messages */
    bool realtime;
    trocar_error refused;        /* why real-time operation was refused */
    int awake;                   /* descriptor that keeps the processors out of deep sleep states, or -1 */
    trocar_error asleep;         /* why the processors cannot be kept out of deep sleep states */
    int shutdown_wake;           /* eventfd */
    trocar_model *model;
    trocar_sim *sim;
    exchange exchange;
    haptic haptic;
    loop loop;
    worker worker;
    io io;
    telemetry telemetry;
    struct sockaddr_in listen;   /* address for unicast clients, and the secret they must know */
    wire_key secret;
    relay relay;
    task haptic_task, worker_task, io_task, telemetry_task, relay_task, prepare_task;
};

/* --- tasks ------------------------------------------------------------------------------------------------------ */

static trocar_status start(task *t, const char *name, size_t stack, void *(*body)(void *), void *context, trocar_error *why) {
    pthread_attr_t attributes;
    pthread_attr_init(&attributes);
    if (stack > 0) pthread_attr_setstacksize(&attributes, stack);
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before); /* new threads inherit this mask, so only the main thread handles signals */
    int error = pthread_create(&t->thread, &attributes, body, context);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    pthread_attr_destroy(&attributes);
    if (error != 0) return fail(why, TROCAR_SYSTEM, "cannot start the %s thread: %s", name, strerror(error));
    t->running = true;
    pthread_setname_np(t->thread, name);
    return TROCAR_OK;
}

static void join(task *t) {
    if (t->running) pthread_join(t->thread, NULL);
    t->running = false;
}

/* --- creation --------------------------------------------------------------------------------------------------- */

static trocar_status read_scene(server *s, trocar_error *why) {
    trocar_status status = trocar_scene_load(s->options.scene_path, &s->scene, why);
    if (status == TROCAR_OK) status = trocar_scene_get_number(s->scene, "rate_hz", &s->rate_hz, why);
    char locked[8] = "";
    if (status == TROCAR_OK) status = trocar_scene_get(s->scene, "phase_lock", locked, sizeof locked, why);
    s->phase_lock = strcmp(locked, "true") == 0;
    if (status != TROCAR_OK || s->options.rate_hz == 0.0) return status;
    s->rate_hz = s->options.rate_hz;
    if (s->rate_hz >= TROCAR_MIN_RATE && s->rate_hz <= TROCAR_MAX_RATE) return trocar_scene_set_number(s->scene, "rate_hz", s->rate_hz, why);
    return fail(why, TROCAR_BAD_INPUT, "rate %g Hz: choose one from %g to %g Hz", s->rate_hz, TROCAR_MIN_RATE, TROCAR_MAX_RATE);
}

static void show_long_start(const char *what, double fraction, void *context) {
    realtime_take_time();
    progress_show(what, fraction, context);
}

static trocar_status read_listen(server *s, trocar_error *why) {
    if (s->options.listen == NULL) return TROCAR_OK;
    trocar_status status = settings_address(s->options.listen, &s->listen, why);
    return status == TROCAR_OK ? settings_secret(s->options.secret_file, &s->listen, &s->secret, why) : status;
}

/* Creates the model and the simulation. A late tick runs no more steps than one on time; if it tried to catch up, the next tick would be late too. */
static trocar_status create_simulation(server *s, trocar_error *why) {
    static const double STEP = 1e-3; /* s, longest step of the simulation */
    trocar_model_options options = trocar_default_model_options();
    options.watch.progress = show_long_start;
    options.log = (trocar_log){progress_warn, "trocar-server"};
    options.max_substeps = (int)ceil(1.0 / (s->rate_hz * STEP) - 1e-6);
    trocar_status status = trocar_model_create(s->scene, &options, &s->model, why);
    if (status != TROCAR_OK) return status;
    return trocar_sim_create(s->model, &s->sim, why);
}

/* Records whether real-time operation is permitted. If it is not, keeps the reason, and fails unless --allow-non-rt was given. */
static trocar_status note_realtime(server *s, trocar_status status, trocar_error *why) {
    s->realtime = status == TROCAR_OK;
    if (s->realtime || s->options.allow_non_rt) return TROCAR_OK;
    *why = s->refused;
    return status;
}

/* Checks the permission for real-time operation before the expensive part of startup, because a supervisor may keep restarting a server that lacks it. */
static trocar_status check_realtime(server *s, trocar_error *why) {
    return note_realtime(s, realtime_check_permission(PRIORITY_HAPTIC, &s->refused), why);
}

/* Switches to real-time operation. Called once most memory has been allocated, but before any thread is started. */
static trocar_status enter_realtime(server *s, trocar_error *why) {
    if (!s->realtime) return TROCAR_OK;
    trocar_status status = note_realtime(s, realtime_lock_memory(&s->refused), why);
    if (s->realtime) s->awake = realtime_stay_awake(&s->asleep);
    return status;
}

static trocar_status create_parts(server *s, trocar_error *why) {
    exchange *x = &s->exchange;
    int flags = s->realtime ? 0 : TROCAR_NEEDLE_WRENCH_T_NOT_REALTIME;
    trocar_device_limits limits = trocar_scene_device(s->scene);
    int needles = trocar_model_needles(s->model);
    haptic_init(&s->haptic, s->sim, needles, &limits, s->rate_hz, flags, x);
    trocar_status status = io_create(&s->io, s->options.lcm_url, needles, &limits, s->realtime, s->shutdown_wake, x, why);
    if (status == TROCAR_OK) status = changes_create(&s->io.changes, s->sim, why);
    if (status != TROCAR_OK) return status;
    s->haptic.server = s->io.server = s->id;
    s->loop = (loop){.rate_hz = s->rate_hz, .tick = haptic_tick, .context = &s->haptic, .stages = s->haptic.stages,
                     .received = s->phase_lock ? &s->haptic.received : NULL, .records = &x->loops};
    s->worker = (worker){.exchange = x, .sim = s->sim};
    telemetry_options telemetry = {.lcm_url = s->options.lcm_url, .scene_path = trocar_scene_path(s->scene), .rate_hz = s->rate_hz, .flags = flags,
                                   .server = s->id, .verbose = s->options.verbose};
    status = telemetry_create(&s->telemetry, &telemetry, s->model, x, why);
    if (status != TROCAR_OK || s->options.listen == NULL) return status;
    return relay_create(&s->relay, &s->listen, &s->secret, s->options.lcm_url, s->realtime, x, why);
}

static trocar_status create_all(server *s, trocar_error *why) {
    trocar_status status;
    realtime_flush_denormals();
    s->shutdown_wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (s->shutdown_wake < 0) return fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    if ((status = create_simulation(s, why)) != TROCAR_OK) return status;
    if ((status = exchange_create(&s->exchange, s->model, why)) != TROCAR_OK) return status;
    if ((status = enter_realtime(s, why)) != TROCAR_OK) return status;
    return create_parts(s, why);
}

typedef struct {
    server *server;
    trocar_status status;
    trocar_error *why;
} creation;

static void *create_run(void *context) {
    creation *c = context;
    realtime_hurry();
    c->status = create_all(c->server, c->why);
    return NULL;
}

/* Creates the server in a separate thread with raised priority. If the calling thread raised its own, its SCHED_RESET_ON_FORK flag would stay set and reset a
   negative nice value in every thread started later. */
static trocar_status create_in_a_hurry(server *s, trocar_error *why) {
    creation c = {.server = s, .why = why};
    task creating = {0};
    trocar_status status = start(&creating, "trocar-create", 0, create_run, &c, why);
    join(&creating);
    return status == TROCAR_OK ? c.status : status;
}

trocar_status server_create(const server_options *options, server **created, trocar_error *why) {
    server *s = allocate_on_cache_lines(sizeof *s);
    if (s == NULL) return fail(why, TROCAR_NO_MEMORY, "cannot allocate the server");
    s->options = *options;
    s->id = session_new();
    s->awake = s->shutdown_wake = s->exchange.io_wake = s->exchange.worker_wake = s->exchange.relay_wake = s->relay.socket = -1;
    trocar_status status = read_scene(s, why);
    if (status == TROCAR_OK) status = read_listen(s, why);
    if (status == TROCAR_OK) status = check_realtime(s, why);
    if (status == TROCAR_OK) status = create_in_a_hurry(s, why);
    if (status == TROCAR_OK) *created = s;
    else server_free(s);
    return status;
}

void server_free(server *s) {
    if (s == NULL || server_busy(s)) return;
    relay_free(&s->relay);
    telemetry_free(&s->telemetry);
    s->haptic.later.refused = true;
    changes_settle(&s->io.changes, &s->haptic.later);
    io_free(&s->io);
    exchange_free(&s->exchange);
    trocar_sim_free(s->sim);
    trocar_model_free(s->model);
    trocar_scene_free(s->scene);
    if (s->awake >= 0) close(s->awake);
    if (s->shutdown_wake >= 0) close(s->shutdown_wake);
    free(s);
}

/* --- threads ---------------------------------------------------------------------------------------------------- */

/* Joins the thread, or gives up at time `until`. Factorising a large matrix cannot be interrupted, so a thread that does this or waits for it is left running.
   */
static void join_or_leave(task *t, const struct timespec *until) {
    if (t->running && pthread_timedjoin_np(t->thread, NULL, until) == 0) t->running = false;
}

bool server_busy(const server *s) { return s->worker_task.running || s->telemetry_task.running || s->prepare_task.running; }

/* --prepare: computes in advance what is otherwise needed only once a needle leaves the region of interest. This also makes pictures of the deformed tissue
   faster. */
static void *prepare_run(void *context) {
    const server *s = context;
    trocar_error why;
    realtime_flush_denormals();
    if (trocar_model_prepare(s->model, &why) != TROCAR_OK)
        fprintf(stderr, "trocar-server: no contacts outside the region of interest: %s\n", why.text);
    return NULL;
}

static void *haptic_run(void *context) {
    server *s = context;
    trocar_error ignored;
    realtime_flush_denormals();
    realtime_touch_stack();
    if (s->realtime) realtime_set_priority(PRIORITY_HAPTIC, &ignored); /* the permission was checked at the start */
    loop_run(&s->loop);
    return NULL;
}

static trocar_status start_io(server *s, trocar_error *why) {
    trocar_status status = start(&s->io_task, "trocar-io", 0, io_run, &s->io, why);
    if (status != TROCAR_OK) return status;
    while (sem_wait(&s->io.ready) != 0) continue;
    if (s->io.started != TROCAR_OK) *why = s->io.why;
    return s->io.started;
}

static trocar_status start_all(server *s, trocar_error *why) {
    trocar_status status;
    if ((status = start_io(s, why)) != TROCAR_OK) return status;
    if ((status = start(&s->worker_task, "trocar-worker", 0, worker_run, &s->worker, why)) != TROCAR_OK) return status;
    if ((status = start(&s->telemetry_task, "trocar-telemetry", 0, telemetry_run, &s->telemetry, why)) != TROCAR_OK)
        return status;
    if (s->options.listen != NULL && (status = start(&s->relay_task, "trocar-relay", 0, relay_run, &s->relay, why)) != TROCAR_OK) return status;
    if (s->options.prepare && (status = start(&s->prepare_task, "trocar-prepare", 0, prepare_run, s, why)) != TROCAR_OK) return status;
    return start(&s->haptic_task, "trocar-haptic", REALTIME_STACK, haptic_run, s, why);
}

/* Stops the haptic thread first, so that the IO thread can still send the device the wrenches that ramp down. */
static void stop_all(server *s) {
    atomic_store(&s->haptic.wind_down, true);
    join(&s->haptic_task);
    worker_stop(&s->worker);
    telemetry_stop(&s->telemetry);
    io_stop(&s->io);
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec += 5;
    join_or_leave(&s->worker_task, &until);
    join_or_leave(&s->telemetry_task, &until);
    join_or_leave(&s->prepare_task, &until);
    join(&s->io_task);
    if (s->relay_task.running) relay_stop(&s->relay); /* now that the IO thread has handed over its last wrenches */
    join(&s->relay_task);
}

static void wait_for_end(const server *s, int stop_descriptor) {
    struct pollfd ends[] = {{.fd = stop_descriptor, .events = POLLIN}, {.fd = s->shutdown_wake, .events = POLLIN}};
    while (poll(ends, 2, -1) < 0 && errno == EINTR) continue;
}

trocar_status server_run(server *s, int stop_descriptor, void (*ready)(void), trocar_error *why) {
    trocar_status status = start_all(s, why);
    if (status == TROCAR_OK) {
        if (ready != NULL) ready();
        wait_for_end(s, stop_descriptor);
    }
    stop_all(s);
    if (status == TROCAR_OK && s->io.status != TROCAR_OK) {
        *why = s->io.why;
        status = s->io.status;
    }
    return status;
}

/* --- output ----------------------------------------------------------------------------------------------------- */

static double resident_mebibytes(void) {
    struct rusage u;
    getrusage(RUSAGE_SELF, &u);
    return (double)u.ru_maxrss / 1024.0;
}

void server_describe(const server *s, FILE *out) {
    const trocar_model *m = s->model;
    char mesh[1024];
    trocar_scene_get(s->scene, "mesh", mesh, sizeof mesh, NULL);
    fprintf(out, "server     %016llx\n", (unsigned long long)s->id);
    fprintf(out, "scene      %s\n", trocar_scene_path(s->scene));
    fprintf(out, "mesh       %s: %d nodes, %d tetrahedra, %d regions, %d membranes\n", mesh, trocar_model_node_count(m),
            trocar_model_tet_count(m), trocar_scene_count(s->scene, "regions"), trocar_scene_count(s->scene, "membranes"));
    fprintf(out, "inverse    %s\n", trocar_model_description(m));
    if (trocar_model_needles(m) > 1) fprintf(out, "needles    %d, one session each\n", trocar_model_needles(m));
    fprintf(out, "unknowns   %d\n", trocar_model_unknowns(m));
    fprintf(out, "rate       %g Hz\n", s->rate_hz);
    if (s->options.listen != NULL) fprintf(out, "unicast    udp://%s, %s\n", s->options.listen, s->options.secret_file != NULL ? "with a secret" : "without a secret");
    fprintf(out, "memory     %.0f MiB%s\n", resident_mebibytes(), s->realtime ? ", locked" : "");
    if (!s->realtime) {
        fprintf(out, "real time  NO: %s\n", s->refused.text);
        return;
    }
    fprintf(out, "real time  yes, SCHED_FIFO %d\n", PRIORITY_HAPTIC);
    if (s->awake >= 0) fputs("processors kept awake\n", out);
    else fprintf(out, "processors may sleep deeply: %s\n", s->asleep.text);
}

static void print_times(FILE *out, const char *name, const histogram *h) {
    fprintf(out, "%s  p50 %.1f us, p99 %.1f us, max %.1f us\n", name, 1e6 * histogram_quantile(h, 0.5),
            1e6 * histogram_quantile(h, 0.99), 1e6 * histogram_max(h));
}

void server_summarise(const server *s, FILE *out) {
    const loop *l = &s->loop;
    fprintf(out, "ticks      %lld, %lld periods missed\n", (long long)l->ticks, (long long)l->misses);
    print_times(out, "lateness ", &l->lateness);
    print_times(out, "compute  ", &l->compute);
    fputs("loop       ", out);
    if (allocations_are_counted()) fprintf(out, "%lld allocations, ", (long long)l->usage.allocations);
    fprintf(out, "%lld minor faults, %lld major faults, %lld involuntary context switches\n", (long long)l->usage.minor_faults,
            (long long)l->usage.major_faults, (long long)l->usage.context_switches);
    fprintf(out, "worker     %lld requests served", (long long)s->worker.served);
    if (s->worker.failed > 0) fprintf(out, "; %lld failures, the first: %s", (long long)s->worker.failed, s->worker.first.text);
    fputc('\n', out);
    fprintf(out, "wrenches   %lld dropped, %lld not sent\n", (long long)s->haptic.wrench_dropped, (long long)s->io.wrenches_unsent);
    for (int i = 0; i < s->haptic.needle_count; i++) {
        const needle_record *record = &s->io.arbiter.record.needles[i];
        fprintf(out, "poses      %lld accepted, %lld lost", (long long)record->counts[POSE_ACCEPTED], (long long)record->poses_lost);
        if (s->haptic.needle_count > 1) fprintf(out, ", needle %d", i);
        fputc('\n', out);
    }
    fprintf(out, "packets    %lld malformed ones and %lld of other machines dropped\n", (long long)lcm_filter_dropped(),
            (long long)lcm_filter_distant(NULL, 0));
    if (s->options.listen != NULL) relay_summarise(&s->relay, out);
}
