#define _GNU_SOURCE
#include "trocar_client.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdalign.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/random.h>
#include <time.h>
#include <unistd.h>

#include <lcm/lcm.h>

#include "lcm_filter.h"
#include "printable.h"
#include "server_choice.h"
#include "trocar_command_reply_t.h"
#include "trocar_command_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"

static const double WATCHDOG = 0.02; /* s */
static const double RAMP = 0.1;      /* s, after an outage */
static const double PATIENCE = 0.1;  /* s of silence after which another server is followed */
static const double LONGEST_PERIOD = 0.01; /* s of the device's loop, for which the wrench may change */
static const double MAX_FORCE = 20.0, MAX_TORQUE = 1.0, MAX_FORCE_RATE = 2000.0, MAX_TORQUE_RATE = 100.0; /* N, N m, per s: as a scene's without `device` */
static const double LONGEST_REPLY = 3.0; /* s; a server with 25 resting needles takes 0.1 s to leave one more */

typedef struct {
    double position[3], orientation[4];
    int64_t wrench_tick;     /* of the wrench that the hand feels */
} sent_pose;

typedef struct {
    double arrival;          /* s, monotonic; 0: none yet */
    trocar_client_wrench wrench;
} received_wrench;

typedef struct {
    int64_t number;          /* from 1, returned in the reply */
    int32_t what, seeds;
    double spacing;          /* m */
} sent_command;

typedef struct {
    int64_t number;          /* of the command; 0: none yet */
    bool done;
    char why[256];
} received_reply;

/* What may be rendered, and what has been last. */
typedef struct {
    double most, rate;       /* N or N m; per s */
    double last[3];
} limiter;

/* Passes the newest value from one thread to another: three slots. The writer fills its own and swaps it with the middle one; the
   reader swaps its own with the middle one if that is fresh. */
enum { FRESH = 4u, INDEX = 3u };
typedef struct {
    alignas(64) atomic_uint middle;  /* index, | FRESH until it is read */
    alignas(64) unsigned back;       /* writer's */
    alignas(64) unsigned front;      /* reader's */
} slots;

struct trocar_client {
    /* device's loop -> client's thread */
    slots pose_slots;
    sent_pose poses[3];
    slots command_slots;
    sent_command commands[3];
    /* client's thread -> device's loop */
    slots wrench_slots;
    received_wrench wrenches[3];
    slots reply_slots;
    received_reply replies[3];
    atomic_bool ends;
    int wake;                /* eventfd: a pose, a command or the end is pending */

    /* device's loop */
    double watchdog;         /* s */
    double alive_since;      /* s, 0: no wrenches arrive */
    limiter force, torque;
    double rendered_at;      /* s, time of the last wrench that was rendered */
    int64_t felt_tick;
    bool without_force;
    int64_t asked;           /* number of the last command, 0: none yet */
    double asked_at;         /* s */

    /* client's thread */
    pthread_t thread;
    sem_t opened;            /* posted when the thread is connected or has failed */
    lcm_t *lcm;
    char *url;               /* NULL: LCM's choice */
    int64_t session, seq;
    int needle;
    server_choice servers;
};

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int64_t wall_clock(void) { /* us */
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    return t.tv_sec * INT64_C(1000000) + t.tv_nsec / 1000;
}

static void slots_init(slots *s) {
    atomic_init(&s->middle, 0);
    s->back = 1;
    s->front = 2;
}

/* Publishes the writer's slot. */
static void slots_publish(slots *s) {
    s->back = atomic_exchange_explicit(&s->middle, s->back | FRESH, memory_order_acq_rel) & INDEX;
}

/* Moves the reader's slot to the newest value; false if there is no new one. */
static bool slots_renew(slots *s) {
    if (!(atomic_load_explicit(&s->middle, memory_order_relaxed) & FRESH)) return false;
    s->front = atomic_exchange_explicit(&s->middle, s->front, memory_order_acq_rel) & INDEX;
    return true;
}

static bool all_finite(const double *numbers, int count) {
    for (int i = 0; i < count; i++)
        if (!isfinite(numbers[i])) return false;
    return true;
}

/* ---- the device's loop ---------------------------------------------------------------------------------------------- */

/* Neither blocks nor fails: an eventfd would block only at 2^64 - 1. */
static void wake(trocar_client *c) {
    uint64_t one = 1;
    if (write(c->wake, &one, sizeof one) < 0) return;
}

int trocar_client_publish(trocar_client *c, const double position[3], const double orientation[4]) {
    if (!all_finite(position, 3) || !all_finite(orientation, 4)) return 0;
    sent_pose *p = &c->poses[c->pose_slots.back];
    memcpy(p->position, position, sizeof p->position);
    memcpy(p->orientation, orientation, sizeof p->orientation);
    p->wrench_tick = c->without_force ? -1 - c->felt_tick : c->felt_tick;
    slots_publish(&c->pose_slots);
    wake(c);
    return 1;
}

static double length_of(const double a[3]) { return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }

/* Limits the length of `wanted`, then its distance from the last one, to what may change in `period` (s). True if it had to. */
static bool limit(limiter *l, double period, double wanted[3]) {
    double length = length_of(wanted), scale = length > l->most ? l->most / length : 1.0, change[3];
    for (int i = 0; i < 3; i++) change[i] = scale * wanted[i] - l->last[i];
    double step = l->rate * period, size = length_of(change), part = size > step ? step / size : 1.0;
    for (int i = 0; i < 3; i++) wanted[i] = l->last[i] += part * change[i];
    return scale < 1.0 || part < 1.0;
}

static void limit_wrench(trocar_client *c, double time, trocar_client_wrench *wrench) {
    double period = fmin(time - c->rendered_at, LONGEST_PERIOD);
    c->rendered_at = time;
    bool force = limit(&c->force, period, wrench->force), torque = limit(&c->torque, period, wrench->torque);
    if (force || torque) wrench->flags |= TROCAR_NEEDLE_WRENCH_T_SATURATED;
}

static void render_nothing(trocar_client *c) {
    memset(c->force.last, 0, sizeof c->force.last);
    memset(c->torque.last, 0, sizeof c->torque.last);
    c->alive_since = 0;
    c->felt_tick = 0;
}

int trocar_client_newest(trocar_client *c, trocar_client_wrench *wrench) {
    slots_renew(&c->wrench_slots);
    const received_wrench *r = &c->wrenches[c->wrench_slots.front];
    double time = now();
    if (r->arrival == 0 || time - r->arrival >= c->watchdog) {
        *wrench = (trocar_client_wrench){.membrane = -1};
        render_nothing(c);
        return 0;
    }
    *wrench = r->wrench;
    c->felt_tick = r->wrench.tick;
    if (c->alive_since == 0) c->alive_since = c->rendered_at = time;
    double gain = fmin(1.0, (time - c->alive_since) / RAMP);
    for (int i = 0; i < 3; i++) {
        wrench->force[i] *= gain;
        wrench->torque[i] *= gain;
    }
    limit_wrench(c, time, wrench);
    return 1;
}

trocar_client_answer trocar_client_reply(trocar_client *c, char *why, size_t size) {
    slots_renew(&c->reply_slots);
    const received_reply *r = &c->replies[c->reply_slots.front];
    bool answered = r->number == c->asked;
    if (why != NULL && size > 0)
        snprintf(why, size, "%s", answered ? r->why : "no reply from the server: check that it runs with the same LCM URL");
    if (c->asked == 0) return TROCAR_CLIENT_NONE;
    if (answered) return r->done ? TROCAR_CLIENT_DONE : TROCAR_CLIENT_REFUSED;
    return now() - c->asked_at < LONGEST_REPLY ? TROCAR_CLIENT_WAITING : TROCAR_CLIENT_UNANSWERED;
}

static int ask(trocar_client *c, sent_command command) {
    if (trocar_client_reply(c, NULL, 0) == TROCAR_CLIENT_WAITING) return 0;
    command.number = ++c->asked;
    c->asked_at = now();
    c->commands[c->command_slots.back] = command;
    slots_publish(&c->command_slots);
    wake(c);
    return 1;
}

int trocar_client_reset(trocar_client *c) { return ask(c, (sent_command){.what = TROCAR_COMMAND_T_RESET}); }
int trocar_client_leave(trocar_client *c) { return ask(c, (sent_command){.what = TROCAR_COMMAND_T_LEAVE}); }
int trocar_client_take(trocar_client *c) { return ask(c, (sent_command){.what = TROCAR_COMMAND_T_TAKE}); }
int trocar_client_undo(trocar_client *c) { return ask(c, (sent_command){.what = TROCAR_COMMAND_T_UNDO}); }
int trocar_client_drop_seeds(trocar_client *c, int count, double spacing) {
    return ask(c, (sent_command){.what = TROCAR_COMMAND_T_DROP_SEED, .seeds = count, .spacing = spacing});
}

/* ---- the client's thread ------------------------------------------------------------------------------------------------ */

static void on_wrench(const lcm_recv_buf_t *buffer, const char *channel, void *user) {
    (void)channel;
    trocar_client *c = user;
    trocar_needle_wrench_t w;
    if (trocar_needle_wrench_t_decode(buffer->data, 0, (int)buffer->data_size, &w) != (int)buffer->data_size) return;
    if (w.session != c->session || w.needle != c->needle || !all_finite(w.force, 3) || !all_finite(w.torque, 3)) return;
    double time = now();
    if (!server_choice_follows(&c->servers, w.server, time)) return;
    received_wrench *r = &c->wrenches[c->wrench_slots.back];
    *r = (received_wrench){time, {.depth = w.depth, .tick = w.tick, .contacts = w.contacts, .events = w.events,
                                  .membrane = w.membrane, .flags = w.flags}};
    memcpy(r->wrench.force, w.force, sizeof w.force);
    memcpy(r->wrench.torque, w.torque, sizeof w.torque);
    slots_publish(&c->wrench_slots);
}

/* Whether these bytes are one reply. LCM's decoder trusts the length of the string, which is the last field. */
static bool reply_is_whole(const lcm_recv_buf_t *buffer) {
    const unsigned char *bytes = buffer->data;
    const trocar_command_reply_t empty = {.message = (char[]){""}};
    size_t text = (size_t)trocar_command_reply_t_encoded_size(&empty) - 1, size = buffer->data_size;
    if (size <= text || bytes[size - 1] != 0) return false;
    const unsigned char *n = bytes + text - 4;
    return ((uint32_t)n[0] << 24 | (uint32_t)n[1] << 16 | (uint32_t)n[2] << 8 | n[3]) == size - text;
}

static void on_reply(const lcm_recv_buf_t *buffer, const char *channel, void *user) {
    (void)channel;
    trocar_client *c = user;
    trocar_command_reply_t m = {0};
    if (!reply_is_whole(buffer) || trocar_command_reply_t_decode(buffer->data, 0, (int)buffer->data_size, &m) < 0) return;
    if (m.session == c->session && m.needle == c->needle && server_choice_follows(&c->servers, m.server, now())) {
        received_reply *r = &c->replies[c->reply_slots.back];
        r->number = m.seq;
        r->done = m.status == TROCAR_COMMAND_REPLY_T_DONE;
        snprintf(r->why, sizeof r->why, "%s", m.message);
        make_printable(r->why);
        slots_publish(&c->reply_slots);
    }
    trocar_command_reply_t_decode_cleanup(&m);
}

/* A pose that the network refuses is lost (and counted by the server); the next one follows soon. */
static void send_pose(trocar_client *c) {
    const sent_pose *p = &c->poses[c->pose_slots.front];
    trocar_needle_pose_t m = {.utime = wall_clock(), .session = c->session, .seq = c->seq++, .wrench_tick = p->wrench_tick, .needle = c->needle};
    memcpy(m.position, p->position, sizeof m.position);
    memcpy(m.orientation, p->orientation, sizeof m.orientation);
    trocar_needle_pose_t_publish(c->lcm, "TROCAR_POSE", &m);
}

static void send_command(trocar_client *c, const sent_command *command) {
    trocar_command_t m = {.utime = wall_clock(), .session = c->session, .command = command->what, .needle = c->needle, .seq = command->number,
                          .seeds = command->seeds, .spacing = command->spacing};
    trocar_command_t_publish(c->lcm, "TROCAR_COMMAND", &m);
}

static bool connect_lcm(trocar_client *c) {
    lcm_t *lcm = lcm_filter_create(c->url);
    if (lcm == NULL) return false;
    if (lcm_subscribe(lcm, "TROCAR_WRENCH", on_wrench, c) == NULL || lcm_subscribe(lcm, "TROCAR_REPLY", on_reply, c) == NULL ||
        lcm_get_fileno(lcm) < 0) {
        lcm_destroy(lcm);
        return false;
    }
    c->lcm = lcm;
    return true;
}

static void exchange_until_end(trocar_client *c) {
    struct pollfd events[2] = {{.fd = c->wake, .events = POLLIN}, {.fd = lcm_get_fileno(c->lcm), .events = POLLIN}};
    while (!atomic_load(&c->ends)) {
        if (poll(events, 2, -1) < 0) continue;
        uint64_t count;
        if (events[0].revents && read(c->wake, &count, sizeof count) > 0) {
            if (slots_renew(&c->command_slots)) send_command(c, &c->commands[c->command_slots.front]);
            if (slots_renew(&c->pose_slots)) send_pose(c);
        }
        if (events[1].revents && lcm_handle(c->lcm) < 0) nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
    }
}

static void *run(void *user) {
    trocar_client *c = user;
    bool connected = connect_lcm(c);
    sem_post(&c->opened);
    if (!connected) return NULL;
    exchange_until_end(c);
    send_command(c, &(sent_command){.what = TROCAR_COMMAND_T_RELEASE});
    lcm_destroy(c->lcm);
    return NULL;
}

/* ---- opening and closing --------------------------------------------------------------------------------------------------- */

static void free_client(trocar_client *c) {
    if (c->wake >= 0) close(c->wake);
    sem_destroy(&c->opened);
    free(c->url);
    free(c);
}

static double or_standard(double given, double standard) { return given == 0 ? standard : given; }

static bool limits_are_good(const trocar_client_options *o) { return o->max_force >= 0 && o->max_torque >= 0 && o->max_force_rate >= 0 && o->max_torque_rate >= 0; }

static trocar_client *create_client(const trocar_client_options *o) {
    trocar_client *c = aligned_alloc(alignof(trocar_client), sizeof *c);
    if (c == NULL) return NULL;
    memset(c, 0, sizeof *c); /* also touches the pages, so that the device's loop has no page fault */
    slots_init(&c->pose_slots);
    slots_init(&c->wrench_slots);
    slots_init(&c->command_slots);
    slots_init(&c->reply_slots);
    sem_init(&c->opened, 0, 0);
    c->watchdog = o->watchdog > 0 ? o->watchdog : WATCHDOG;
    c->servers.patience = PATIENCE;
    c->force = (limiter){.most = or_standard(o->max_force, MAX_FORCE), .rate = or_standard(o->max_force_rate, MAX_FORCE_RATE)};
    c->torque = (limiter){.most = or_standard(o->max_torque, MAX_TORQUE), .rate = or_standard(o->max_torque_rate, MAX_TORQUE_RATE)};
    c->needle = o->needle;
    c->without_force = o->without_force != 0;
    c->url = o->url != NULL ? strdup(o->url) : NULL;
    c->wake = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (getrandom(&c->session, sizeof c->session, 0) < 0) c->session = wall_clock();
    c->session = (c->session & INT64_MAX) | 1; /* 0 means nobody */
    if (c->wake >= 0 && (o->url == NULL || c->url != NULL)) return c;
    free_client(c);
    return NULL;
}

/* Returns 0 or an errno value. */
static int start_thread(trocar_client *c, int priority) {
    pthread_attr_t attributes;
    int error = pthread_attr_init(&attributes);
    if (error != 0) return error;
    if (priority != 0) {
        pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
        pthread_attr_setschedpolicy(&attributes, SCHED_FIFO);
        error = pthread_attr_setschedparam(&attributes, &(struct sched_param){.sched_priority = priority});
    }
    if (error == 0) error = pthread_create(&c->thread, &attributes, run, c);
    pthread_attr_destroy(&attributes);
    return error;
}

static trocar_client *open_or_say_why(const trocar_client_options *o, char *why, size_t size) {
    if (!limits_are_good(o)) {
        snprintf(why, size, "max_force, max_torque, max_force_rate and max_torque_rate must be above 0, or 0 for their defaults");
        return NULL;
    }
    trocar_client *c = create_client(o);
    if (c == NULL) {
        snprintf(why, size, "the client cannot be created: %s", strerror(errno));
        return NULL;
    }
    int error = start_thread(c, o->priority);
    if (error != 0) {
        snprintf(why, size, error == EPERM ? "SCHED_FIFO is not permitted (%s): raise the limit rtprio or leave `priority` at 0"
                                           : "the client's thread cannot start: %s", strerror(error));
        free_client(c);
        return NULL;
    }
    while (sem_wait(&c->opened) != 0) continue;
    if (c->lcm != NULL) return c;
    pthread_join(c->thread, NULL);
    snprintf(why, size, "LCM cannot connect to \"%s\": check the address and the multicast route. On a single machine without a network, "
             "as root: ip link set lo multicast on && ip route add 239.255.76.67/32 dev lo", o->url != NULL ? o->url : "$LCM_DEFAULT_URL");
    free_client(c);
    return NULL;
}

trocar_client *trocar_client_open(const trocar_client_options *options, char *why, size_t size) {
    static const trocar_client_options standard = {0};
    char text[512] = "";
    trocar_client *c = open_or_say_why(options != NULL ? options : &standard, text, sizeof text);
    if (c == NULL && why == NULL) fprintf(stderr, "trocar_client: %s\n", text);
    if (why != NULL) snprintf(why, size, "%s", text);
    return c;
}

void trocar_client_close(trocar_client *c) {
    if (c == NULL) return;
    atomic_store(&c->ends, true);
    wake(c);
    pthread_join(c->thread, NULL);
    free_client(c);
}
