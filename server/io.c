#include "io.h"

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>

#include "common/network.h"
#include "common/realtime.h"
#include "common/timing.h"
#include "common/eventfd_signal.h"
#include "trocar_command_reply_t.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_probe_wrench_t.h"
#include "trocar_status_t.h"
#include "trocar_values_t.h"

enum { QUEUE = 256, MESSAGES_A_ROUND = 2 * QUEUE, WRENCH_BYTES = 512, REPLY_BYTES = 1024 };
_Static_assert(REPLY_BYTES <= sizeof((outgoing_message *)0)->bytes, "every message fits");

trocar_status io_create(io *o, const char *url, int needle_count, const trocar_device_limits *limits, bool realtime, int shutdown_wake,
                        exchange *x, trocar_error *why) {
    *o = (io){.exchange = x, .url = url, .realtime = realtime, .shutdown_wake = shutdown_wake, .changes.wake = x->io_wake};
    arbiter_init(&o->arbiter, needle_count, limits);
    probe_arbiter_init(&o->probe);
    atomic_init(&o->stop, false);
    /* LCM's generated code computes a type's hash on first use, without a lock. Two threads use this type, so compute its hash before they start. */
    __trocar_status_t_get_hash();
    if (sem_init(&o->ready, 0, 0) == 0) return TROCAR_OK;
    return fail(why, TROCAR_SYSTEM, "cannot create a semaphore: %s", strerror(errno));
}

void io_free(io *o) {
    needle_command left;
    while (o->exchange && spsc_ring_pop(&o->exchange->commands, &left)) changes_settle(&o->changes, &left);
    while (o->exchange && spsc_ring_pop(&o->exchange->replies, &left)) changes_settle(&o->changes, &left);
    changes_free(&o->changes);
    sem_destroy(&o->ready);
}

/* Publishes a message, and passes it to the relay thread if there is one. If the ring is full, the relay's client misses it. */
static int publish(io *o, const char *channel, int64_t session, const unsigned char *bytes, int size) {
    if (size <= 0) return -1;
    if (o->exchange->relay_wake >= 0) {
        outgoing_message m = {.session = session, .channel = channel, .size = (size_t)size};
        memcpy(m.bytes, bytes, m.size);
        if (spsc_ring_push(&o->exchange->outgoing, &m)) eventfd_signal(o->exchange->relay_wake);
    }
    return lcm_publish(o->lcm, channel, bytes, (unsigned)size);
}

/* Replies to a command. The datagram may get lost, which is acceptable. */
static void reply_with(io *o, const needle_command *c, int status, const char *message) {
    trocar_command_reply_t m = {.utime = wall_us(), .server = o->server, .session = c->asked.session, .seq = c->asked.seq, .command = c->asked.command,
                                .needle = c->asked.needle, .status = status, .message = (char *)(uintptr_t)message};
    unsigned char bytes[REPLY_BYTES];
    int size = trocar_command_reply_t_encode(bytes, 0, sizeof bytes, &m);
    publish(o, "TROCAR_REPLY", m.session, bytes, size);
}

static void reply(io *o, const needle_command *c) {
    if (c->refused) reply_with(o, c, TROCAR_COMMAND_REPLY_T_REFUSED, c->why);
    else reply_with(o, c, TROCAR_COMMAND_REPLY_T_DONE, "");
}

static void settle(io *o, const needle_command *done) {
    changes_settle(&o->changes, done);
    if (done->change) o->values_shown = 0;
    arbiter_settle(&o->arbiter, done);
    reply(o, done);
}

static void publish_replies(io *o) {
    needle_command done;
    while (spsc_ring_pop(&o->exchange->replies, &done)) settle(o, &done);
}

static void on_pose(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    io *o = context;
    arbiter_pose(&o->arbiter, received->data, received->data_size, monotonic_ns());
}

static void on_probe(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    io *o = context;
    char *message = o->arbiter.record.message;
    probe_arbiter_pose(&o->probe, received->data, received->data_size, monotonic_ns(), message, sizeof o->arbiter.record.message);
}

static void on_command(const lcm_recv_buf_t *received, const char *channel, void *context) {
    io *o = context;
    needle_command command;
    bool distant = strcmp(channel, IO_PACKETS.origin.distant) == 0;
    switch (arbiter_command(&o->arbiter, received->data, received->data_size, distant, monotonic_ns(), &command)) {
    case COMMAND_MALFORMED: return;
    case COMMAND_SETTLED: reply(o, &command); return;
    case COMMAND_SHUTDOWN:
        reply(o, &command);
        eventfd_signal(o->shutdown_wake);
        return;
    case COMMAND_PASS_ON:
        if (spsc_ring_push(&o->exchange->commands, &command)) return;
        command.refused = true;
        snprintf(command.why, sizeof command.why, "too many commands at once: wait for the reply");
        settle(o, &command);
    }
}

static void follow_verdict(io *o, change_verdict verdict, needle_command *command) {
    switch (verdict) {
    case CHANGE_LATER: return;
    case CHANGE_MALFORMED:
        arbiter_refuse(&o->arbiter, "a change refused: not a trocar.change_t of this version");
        return;
    case CHANGE_REFUSED:
        arbiter_refuse(&o->arbiter, command->why);
        reply(o, command);
        return;
    case CHANGE_PASS_ON:
        if (spsc_ring_push(&o->exchange->commands, command)) return;
        command->refused = true;
        snprintf(command->why, sizeof command->why, "too many commands at once: wait for the reply");
        settle(o, command);
    }
}

/* Continues with a change of moduli once its model is built. */
static void go_on_with_change(io *o) {
    needle_command command;
    change_verdict verdict = changes_ready(&o->changes, &command);
    if (verdict == CHANGE_PASS_ON) o->arbiter.record.message[0] = '\0';
    follow_verdict(o, verdict, &command);
}

static void on_change(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    io *o = context;
    needle_command command;
    change_verdict verdict = changes_take(&o->changes, received->data, received->data_size, &command);
    if (verdict == CHANGE_LATER || verdict == CHANGE_PASS_ON) o->wait_shown = monotonic_ns();
    if (verdict == CHANGE_LATER)
        snprintf(o->arbiter.record.message, sizeof o->arbiter.record.message, "the tissue's stiffness with the new moduli is being computed; the change follows");
    follow_verdict(o, verdict, &command);
}

static void on_status(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    io *o = context;
    other_server_hear(&o->arbiter.record.other, o->server, received->data, received->data_size, monotonic_ns());
}

static const char *const CHANNELS[] = {"TROCAR_POSE", "TROCAR_PROBE", "TROCAR_COMMAND", "REMOTE_COMMAND", "TROCAR_CHANGE", "TROCAR_STATUS", NULL};
static const lcm_msg_handler_t HANDLERS[] = {on_pose, on_probe, on_command, on_command, on_change, on_status};
_Static_assert(sizeof CHANNELS / sizeof *CHANNELS == sizeof HANDLERS / sizeof *HANDLERS + 1, "one handler for each channel");
/* all messages to the server fit into one packet */
const packet_wishes IO_PACKETS = {.channels = CHANNELS, .whole_only = true, .origin = {"TROCAR_COMMAND", "REMOTE_COMMAND"}};

/* Subscribes to raw messages, because LCM's generated subscriptions silently drop malformed ones. */
static bool subscribe(io *o, const char *channel, lcm_msg_handler_t handler) {
    lcm_subscription_t *subscription = lcm_subscribe(o->lcm, channel, handler, o);
    return subscription != NULL && lcm_subscription_set_queue_capacity(subscription, QUEUE) == 0;
}

trocar_status io_open(io *o) {
    trocar_status status = network_open(o->url, &o->lcm, &o->why);
    if (status != TROCAR_OK) return status;
    bool subscribed = true;
    for (int i = 0; CHANNELS[i]; i++) subscribed = subscribed && subscribe(o, CHANNELS[i], HANDLERS[i]);
    if (subscribed) return TROCAR_OK;
    return fail(&o->why, TROCAR_SYSTEM, "LCM cannot receive its own test message: check the multicast route, the firewall and, as a service, IPAddressAllow: it must have "
                "this machine's address");
}

void io_close(io *o) {
    if (o->lcm != NULL) lcm_destroy(o->lcm);
    o->lcm = NULL;
}

/* Empties LCM's queues, because they drop new messages when full. Handles a limited number of messages per round, so that a flood of them cannot delay the
   wrenches. */
static trocar_status receive(io *o) {
    int handled = 1;
    for (int i = 0; i < MESSAGES_A_ROUND && handled > 0; i++) handled = lcm_handle_timeout(o->lcm, 0);
    if (handled < 0) return fail(&o->why, TROCAR_SYSTEM, "LCM cannot receive messages any more: %s", strerror(errno));
    return TROCAR_OK;
}

static void hand_over(io *o) {
    newest_poses *poses = triple_buffer_slot(&o->exchange->poses);
    for (int i = 0; i < o->arbiter.needle_count; i++) poses->needles[i] = o->arbiter.needles[i].newest;
    triple_buffer_publish(&o->exchange->poses);
    *(probe_sample *)triple_buffer_slot(&o->exchange->probe_poses) = o->probe.newest;
    triple_buffer_publish(&o->exchange->probe_poses);
    *(arbiter_record *)triple_buffer_slot(&o->exchange->intakes) = o->arbiter.record;
    triple_buffer_publish(&o->exchange->intakes);
}

/* Sends the queued wrenches. If a send fails (no route, full buffer), counts the wrench as unsent and carries on. */
static void publish_wrenches(io *o) {
    trocar_needle_wrench_t wrench;
    unsigned char bytes[WRENCH_BYTES];
    while (spsc_ring_pop(&o->exchange->wrenches, &wrench)) {
        int size = trocar_needle_wrench_t_encode(bytes, 0, sizeof bytes, &wrench);
        if (publish(o, "TROCAR_WRENCH", wrench.session, bytes, size) != 0) o->wrenches_unsent++;
    }
}

static void say_if_probe_stopped(io *o) {
    bool stopped = atomic_load_explicit(&o->exchange->probe_stopped, memory_order_relaxed);
    if (stopped && !o->probe_stopped)
        snprintf(o->arbiter.record.message, sizeof o->arbiter.record.message,
                 "the tissue stopped the probe before it reached its pose: draw it back, or see probe.max_force of the scene");
    o->probe_stopped = stopped;
}

static void publish_probe(io *o) {
    trocar_probe_wrench_t wrench;
    unsigned char bytes[WRENCH_BYTES];
    while (spsc_ring_pop(&o->exchange->probe_wrenches, &wrench)) {
        int size = trocar_probe_wrench_t_encode(bytes, 0, sizeof bytes, &wrench);
        if (publish(o, "TROCAR_PROBE_WRENCH", wrench.session, bytes, size) != 0) o->wrenches_unsent++;
    }
}

static const int64_t PERIOD = 1000000000; /* ns, period of repeated messages */

/* Tells the sender of a pending change, once a second, that it is still pending. */
static void publish_wait(io *o) {
    int64_t now = monotonic_ns();
    if (!o->changes.pending || now - o->wait_shown < PERIOD) return;
    o->wait_shown = now;
    reply_with(o, &o->changes.last, TROCAR_COMMAND_REPLY_T_PENDING,
               o->changes.building ? "the tissue's stiffness with the new moduli is being computed" : "the last change of moduli is not yet complete");
}

/* Publishes the changeable values once a second and after each change. */
static void publish_values(io *o) {
    int64_t now = monotonic_ns();
    trocar_values_t *m = &o->changes.shown;
    if (m->count == 0 || (o->values_shown != 0 && now - o->values_shown < PERIOD)) return;
    o->values_shown = now;
    m->utime = wall_us();
    m->server = o->server;
    trocar_values_t_publish(o->lcm, "TROCAR_VALUES", m);
}

trocar_status io_round(io *o) {
    o->changes.busy = false;
    trocar_status status = receive(o);
    go_on_with_change(o);
    publish_replies(o);
    say_if_probe_stopped(o);
    hand_over(o);
    publish_wrenches(o);
    publish_probe(o);
    publish_values(o);
    publish_wait(o);
    return status;
}

static void wait_for_work(io *o) {
    struct pollfd work[] = {{.fd = lcm_get_fileno(o->lcm), .events = POLLIN},
                            {.fd = o->exchange->io_wake, .events = POLLIN}};
    if (poll(work, 2, -1) > 0 && work[1].revents != 0) eventfd_wait(o->exchange->io_wake);
}

void *io_run(void *context) {
    io *o = context;
    realtime_flush_denormals();
    if (o->realtime) o->status = realtime_set_priority(PRIORITY_IO, &o->why);
    if (o->status == TROCAR_OK) o->status = io_open(o);
    o->started = o->status;
    bool listening = o->started == TROCAR_OK;
    sem_post(&o->ready);

    while (listening && o->status == TROCAR_OK && !atomic_load_explicit(&o->stop, memory_order_acquire)) {
        wait_for_work(o);
        o->status = io_round(o);
    }
    if (listening && o->status == TROCAR_OK) publish_wrenches(o);
    else eventfd_signal(o->shutdown_wake);
    io_close(o);
    return NULL;
}

void io_stop(io *o) {
    atomic_store_explicit(&o->stop, true, memory_order_release);
    eventfd_signal(o->exchange->io_wake);
}
