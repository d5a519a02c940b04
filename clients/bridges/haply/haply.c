/* trocar-haply: connects a Haply Inverse3 and its handle to trocar-server. In each period, it sends the newest force to the Haply Inverse Service and
   computes the needle's next pose from the device state in the reply. See docs/devices/haply.md and message.h. */
#include <argp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/messages.h"
#include "common/realtime.h"
#include "common/timing.h"
#include "device/playing.h"
#include "device_response.h"
#include "limiter.h"
#include "network.h"
#include "settings.h"
#include "shared/options.h"
#include "trocar_client.h"

const char *argp_program_version = "trocar-haply " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

static const double GRAVITY = 9.81;                   /* m/s^2 */
/* ns, set the force to zero after this long without a reply from the service, like trocar_client's watchdog */
static const int64_t REPLY_TIMEOUT = 20000000;
static const int64_t FROZEN = 500000000;              /* ns, the state counts as frozen if it stays exactly constant for this long under a force: a hand's
                                                         tremor moves the device by tenths of a millimetre at 8 to 12 Hz */
static const int64_t CONNECTION_TIMEOUT = 1000000000; /* ns, reconnect after this long without a reply */
static const int64_t REPORT_AFTER = 500000000;        /* ns, tell the user after this long without a wrench */
static const int64_t INQUIRY = 200000000;             /* ns, interval between requests for the list of devices */
static const int64_t SHUTDOWN_TIMEOUT = 200000000;    /* ns to wait for the last reply at shutdown */
static const int64_t REPORTED = INT64_MAX;
static const double MEASURING_FORCE = 0.5;            /* N, force applied by --measure-delay */
static const int64_t EVENT_GAP = 100000000;           /* ns, minimum time between reported events */

/* Counters, printed periodically and at the end. */
typedef struct {
    int64_t begin;           /* ns */
    int64_t messages, late, refused;
    double greatest_force;   /* N */
    histogram reply;
} statistics;

typedef struct {
    haply_settings set;
    trocar_client *server;
    network *net;
    websocket service, events;
    haply_choice choice;     /* IDs of the device and handle in use: the first ones found */
    mapping map;
    limiter limit;
    haply_state state;

    bool valid;              /* the newest message contains a usable state and was in time */
    haply_state seen;        /* the previous state */
    int64_t changed_at;      /* ns: when the state last changed under a force */
    bool frozen;             /* the state has been constant for too long; the force stays zero until it changes */
    bool lost;               /* the loss of the connection has been reported */
    bool absent;             /* the newest message does not contain a device */
    bool greeted;
    const char *key;         /* key under which a message gives the force; NULL before the first message */
    unsigned told;           /* bit set of the kinds of problem already reported on this connection */
    int waiting;             /* number of pending replies */
    bool overdue;            /* replies are taking too long; send nothing more until all pending ones have arrived */
    int64_t asked_at;        /* ns: when the oldest message still without a reply was sent */
    int64_t sent_at;         /* ns: when the newest message was sent */

    bool answered;           /* the user has been told that wrenches are arriving from the server */
    /* ns: when the wait for a wrench began; 0 while wrenches arrive or none are expected; REPORTED once the user has been told that none arrive */
    int64_t unanswered_since;
    int64_t event_at;        /* ns: when an event was last reported */

    bool measuring, measured; /* measuring: a measurement of `response` is under way; measured: it is finished, and the program ends */
    bool found;              /* the fit succeeded */
    device_response response; /* measurement of --measure-delay */

    bool shutting_down, last_sent; /* shutting_down: the program is ending; last_sent: its last message, with zero force, has been sent */
    int64_t shut_down_since; /* ns */
    bool ends;
    statistics part, whole;
} bridge;

__attribute__((format(printf, 1, 2)))
static void say(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    fputs("trocar-haply: ", stderr);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
}

/* ---- reports ------------------------------------------------------------------------------------------------------- */

static void print_statistics(const bridge *b, const statistics *s, const char *what) {
    double seconds = 1e-9 * (double)(monotonic_ns() - s->begin);
    printf("%-8s %5.0f messages/s, reply p50 %.3f ms, p99 %.3f ms, max %.1f ms, %lld late, %lld refused; force %.3f N, at most %.3f N\n", what,
           (double)s->messages / seconds, 1e3 * histogram_quantile(&s->reply, 0.5), 1e3 * histogram_quantile(&s->reply, 0.99),
           1e3 * histogram_max(&s->reply), (long long)s->late, (long long)s->refused, v3_norm(b->limit.force), s->greatest_force);
    fflush(stdout);
}

static void end_part(bridge *b) {
    statistics *w = &b->whole, *p = &b->part;
    histogram_merge(&w->reply, &p->reply);
    w->messages += p->messages;
    w->late += p->late;
    w->refused += p->refused;
    w->greatest_force = fmax(w->greatest_force, p->greatest_force);
    *p = (statistics){.begin = monotonic_ns()};
}

static void report_now_and_then(bridge *b, int64_t now) {
    if (b->set.report == 0 || 1e-9 * (double)(now - b->part.begin) < b->set.report) return;
    print_statistics(b, &b->part, "");
    end_part(b);
}

/* Reports a problem once per connection. */
static void report_problem(bridge *b, haply_problem problem) {
    bool told = b->told & 1u << problem;
    b->told |= 1u << problem;
    const char *id = problem == HAPLY_NO_HANDLE ? b->choice.handle : b->choice.device;
    if (!told) say("%s%s%s%s", haply_expected(problem), id[0] ? " (ID " : "", id, id[0] ? ")" : "");
}

/* ---- from the service to the server --------------------------------------------------------------------------------- */

static void no_state(bridge *b) {
    b->valid = b->measuring = false; /* a measurement must start over */
    limiter_cut(&b->limit);
    if (b->unanswered_since != REPORTED) b->unanswered_since = 0;
}

/* Settles on the first device and handle found, so that the bridge keeps using them even if others are connected later. */
static void choose(bridge *b) {
    if (!b->choice.device[0]) say("device %s", b->state.device);
    memcpy(b->choice.device, b->state.device, HAPLY_ID);
    if (!b->choice.handle[0] && b->state.handle[0]) {
        say("handle %s", b->state.handle);
        memcpy(b->choice.handle, b->state.handle, HAPLY_ID);
    }
}

static void heed_handle(bridge *b, bool had_handle) {
    bool has_handle = b->state.handle[0] != '\0';
    if (has_handle != had_handle) limiter_cut(&b->limit); /* the needle's orientation may jump */
    if (!has_handle && !b->set.mapping.fixed) report_problem(b, HAPLY_NO_HANDLE);
}

static void publish(bridge *b) {
    const haply_state *s = &b->state;
    trocar_pose base = library_pose(mapping_pose(&b->map, s->position, s->handle[0] ? &s->orientation : NULL, s->clutch));
    trocar_client_publish(b->server, base.position, base.orientation);
}

static bool is_same(const haply_state *a, const haply_state *b) {
    return memcmp(&a->position, &b->position, sizeof a->position) == 0 && memcmp(&a->orientation, &b->orientation, sizeof a->orientation) == 0
        && a->clutch == b->clutch;
}

/* Detects a frozen state. A service that has lost its device may repeat the last state forever, and the server would keep sending the force for it. */
static bool is_frozen(bridge *b) {
    int64_t now = monotonic_ns();
    bool same = is_same(&b->state, &b->seen), felt = v3_norm(b->limit.force) > 0;
    b->seen = b->state;
    if (!same || (!felt && !b->frozen)) b->changed_at = now;
    bool frozen = now - b->changed_at > FROZEN;
    if (b->frozen && !frozen) say("the device's state changes again");
    return b->frozen = frozen;
}

/* Feeds the device's position along its y axis to the --measure-delay measurement. */
static void note_response(bridge *b) {
    double now = 1e-9 * (double)monotonic_ns();
    if (!b->measuring && !b->measured) {
        say("measuring the device's delay: hold the handle lightly, away from the ends of its workspace, for 5 s");
        response_begin(&b->response, fmin(MEASURING_FORCE, b->set.max_force), now);
    }
    b->measuring = true;
    response_add(&b->response, now, b->state.position.y);
}

static void on_state(void *context, const char *text, size_t length) {
    bridge *b = context;
    bool had_handle = b->valid && b->state.handle[0] != '\0';
    if (b->waiting > 0 && --b->waiting == 0) {
        histogram_add(&b->part.reply, monotonic_ns() - b->asked_at);
        b->overdue = false;
    }
    haply_problem problem = haply_read(text, length, &b->choice, &b->state);
    b->absent = problem == HAPLY_NO_DEVICE || problem == HAPLY_OTHER_FORMAT;
    if (!b->key) b->key = b->set.force_key ? b->set.force_key : b->state.has_session_id ? "vector" : "values";
    if (problem != HAPLY_GOOD) {
        b->part.refused++;
        report_problem(b, problem);
        no_state(b);
        return;
    }
    if (b->waiting > 0) return; /* a late reply; newer ones are still on their way */
    if (is_frozen(b)) {
        report_problem(b, HAPLY_FROZEN);
        no_state(b);
        return;
    }
    choose(b);
    heed_handle(b, had_handle);
    b->valid = true;
    if (b->set.measure_delay) note_response(b);
    else publish(b);
}

static void on_event(void *context, const char *text, size_t length) {
    bridge *b = context;
    char told[256];
    int64_t now = monotonic_ns();
    if (!haply_read_event(text, length, told, sizeof told) || now - b->event_at < EVENT_GAP) return;
    b->event_at = now;
    say("the service reports %s", told);
}

/* ---- from the server to the service --------------------------------------------------------------------------------- */

static void heed_server(bridge *b, bool answered, int64_t now) {
    if (answered && !b->answered) say("trocar-server answers");
    if (answered) {
        b->answered = true;
        b->unanswered_since = 0;
        return;
    }
    if (b->unanswered_since == 0) b->unanswered_since = now;
    if (b->unanswered_since == REPORTED || now - b->unanswered_since < REPORT_AFTER) return;
    b->unanswered_since = REPORTED;
    b->answered = false;
    say("no wrench from trocar-server, so no force: start the server, or look in trocar-top why needle %d gets none; waiting", b->set.needle);
}

/* Prints the measured values as `device` keys for the scene file, converted to the needle's scale. */
static void tell_response(bridge *b) {
    response_model found;
    b->measured = true;
    b->found = response_fit(&b->response, &found);
    if (!b->found) {
        say("the device did not move like a mass held lightly by a hand: try again");
        return;
    }
    printf("device: {delay: %.4f, mass: %.2g}    # s, kg: for the server's scene; misfit %.0f %%\n", found.delay,
           found.mass / (b->set.mapping.scale * b->set.force_scale), 100.0 * found.misfit);
    fflush(stdout);
}

static vec3 measuring_force(bridge *b, int64_t now) {
    double seconds = 1e-9 * (double)now;
    if (!b->measuring || b->measured || b->shutting_down) return v3(0, 0, 0);
    double force = response_force(&b->response, seconds);
    if (response_is_over(&b->response, seconds)) tell_response(b);
    return v3(0, force, 0);
}

static vec3 next_force(bridge *b, int64_t now) {
    if (b->set.measure_delay) return measuring_force(b, now);
    trocar_client_wrench wrench;
    double period = 1e-9 * (double)(now - b->sent_at);
    bool answered = b->valid && trocar_client_newest(b->server, &wrench);
    if (b->valid) heed_server(b, answered, now);
    if (!answered || b->shutting_down) {
        limiter_cut(&b->limit);
        return b->limit.force;
    }
    if (b->map.clutched) limiter_let_go(&b->limit);
    vec3 felt = mapping_force(&b->map, load_vec3(wrench.force));
    vec3 weight = v3(0, 0, GRAVITY * b->set.tool_mass);
    return limiter_next(&b->limit, v3_scale(b->map.clutched ? 0 : b->set.force_scale, felt), weight, period);
}

static size_t write_message(void *context, char *text, size_t size) {
    bridge *b = context;
    int64_t now = monotonic_ns();
    vec3 force = next_force(b, now);
    const char *device = b->choice.device;
    bool inquires = !device[0] || !b->key || b->absent;
    size_t length = inquires ? haply_write_inquiry(text, size) : haply_write_force(text, size, device, b->key, force, !b->greeted);
    b->greeted = b->greeted || !inquires;
    b->last_sent = b->shutting_down;
    if (b->waiting++ == 0) b->asked_at = now;
    b->sent_at = now;
    b->part.messages++;
    b->part.greatest_force = fmax(b->part.greatest_force, v3_norm(force));
    return length;
}

/* ---- connection and time -------------------------------------------------------------------------------------------- */

static void on_opened(void *context) {
    bridge *b = context;
    say("connected to the service at %s:%d", b->set.host, b->set.port);
    b->lost = b->greeted = b->absent = false;
    b->key = NULL;
    b->told = 0;
    b->waiting = 0;
    b->overdue = false;
    b->sent_at = monotonic_ns(); /* the service sends the first message; start waiting for it now */
}

static void on_closed(void *context, const char *why) {
    bridge *b = context;
    no_state(b);
    b->waiting = 0;
    if (!b->lost && !b->shutting_down) say("the service at %s:%d: %s; is it running? Trying again twice a second", b->set.host, b->set.port, why);
    b->lost = true;
}

static void ignore_opening(void *context) { (void)context; }
static void ignore_closing(void *context, const char *why) { (void)context, (void)why; }
static size_t write_nothing(void *context, char *text, size_t size) { return (void)context, (void)text, (void)size, 0; }

/* Ends the program: sends zero force and waits for the reply, so that the message is not lost when the connection closes. */
static void shut_down(bridge *b, int64_t now) {
    if (!b->shutting_down) b->shut_down_since = now;
    b->shutting_down = true;
    b->ends = !b->service.open || (b->last_sent && b->waiting == 0) || now - b->shut_down_since > SHUTDOWN_TIMEOUT;
    if (!b->last_sent) websocket_ask_to_write(&b->service);
}

/* Reconnects. Replies are not numbered, so a lost reply cannot be told from a late one; only on a new connection can the count of pending replies start
   again from zero. */
static void renew(bridge *b) {
    if (!b->lost) say("no reply from the service at %s:%d for 1 s: reconnecting, twice a second", b->set.host, b->set.port);
    b->lost = true;
    websocket_drop(&b->service);
}

/* Sends a single message with zero force to a service that does not reply in time, so that the force stops once the service gets round to reading it. More
   messages would make a service slower than the tick fall ever further behind. */
static void await_reply(bridge *b, int64_t now) {
    if (now - b->asked_at > CONNECTION_TIMEOUT) renew(b);
    if (now - b->asked_at < REPLY_TIMEOUT || b->overdue) return;
    b->overdue = true;
    b->part.late++;
    report_problem(b, HAPLY_LATE);
    no_state(b);
    websocket_ask_to_write(&b->service);
}

static void on_tick(void *context) {
    bridge *b = context;
    int64_t now = monotonic_ns();
    if (playing_interrupted() || b->measured) {
        shut_down(b, now);
        return;
    }
    websocket_keep(b->net, &b->service);
    websocket_keep(b->net, &b->events);
    report_now_and_then(b, now);
    if (!b->service.open) return;
    if (b->waiting > 0) await_reply(b, now);
    else if ((b->key && !b->absent) || now - b->sent_at > INQUIRY) websocket_ask_to_write(&b->service);
}

static trocar_status run(bridge *b, trocar_error *why) {
    int priority = 0;
    if (b->set.realtime && playing_use_realtime()) priority = PRIORITY_DEVICE - 1; /* the client's thread runs at one below this thread's priority */
    trocar_client_options server = {.url = b->set.lcm_url[0] ? b->set.lcm_url : NULL, .needle = b->set.needle, .priority = priority};
    b->server = trocar_client_open(&server, why->text, sizeof why->text);
    if (!b->server) return TROCAR_BAD_INPUT; /* the LCM URL is not valid */
    trocar_status status = network_create(b->set.rate, on_tick, b, &b->net, why);
    if (status == TROCAR_OK) {
        puts("ready");
        fflush(stdout);
        while (!b->ends) network_round(b->net);
        network_free(b->net);
        end_part(b);
        if (!b->set.measure_delay) print_statistics(b, &b->whole, "in all");
    }
    trocar_client_close(b->server);
    return status;
}

int main(int count, char **arguments) {
    static bridge b;
    trocar_error why;
    haply_parse(count, arguments, &b.set);
    playing_heed_signals();
    b.choice = b.set.choice;
    b.limit = (limiter){.max_force = b.set.max_force, .max_rate = b.set.max_force_rate};
    trocar_status status = haply_place(&b.set, &why);
    mapping_init(&b.map, &b.set.mapping);
    b.part.begin = b.whole.begin = monotonic_ns();
    b.service = (websocket){.address = b.set.host, .port = b.set.port, .retry = 0.5, .context = &b, .opened = on_opened, .closed = on_closed,
                            .received = on_state, .write = write_message};
    b.events = (websocket){.address = b.set.host, .port = b.set.events_port, .retry = 10, .context = &b, .opened = ignore_opening, .closed = ignore_closing,
                           .received = on_event, .write = write_nothing};
    if (status == TROCAR_OK) status = run(&b, &why);
    if (status == TROCAR_OK) return b.set.measure_delay && !b.found ? EXIT_FAILURE : EXIT_SUCCESS;
    fprintf(stderr, "trocar-haply: %s\n", why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
