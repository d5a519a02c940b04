#define _GNU_SOURCE
#include "relay.h"

#include <arpa/inet.h>
#include <errno.h>
#include <poll.h>
#include <string.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/eventfd_signal.h"
#include "common/network.h"
#include "common/realtime.h"
#include "common/timing.h"

_Static_assert(sizeof((outgoing_message *)0)->bytes <= WIRE_MESSAGE_MOST, "every message of the server fits into a datagram");

/* The thread receives at most WORK_RATE datagrams per second, averaged over 0.1 s, and at most RUN_MOST in a row before it sends messages from the server. */
enum { WORK_RATE = 40000, RUN_MOST = 64, PAUSE = 5, RECEIVE_BUFFER = 1 << 20 }; /* PAUSE: ms */

static bool randomise(void *to, size_t size) { return getrandom(to, size, 0) == (ssize_t)size; }

static trocar_status open_socket(relay *r, const struct sockaddr_in *address, trocar_error *why) {
    char text[INET_ADDRSTRLEN];
    int buffer = RECEIVE_BUFFER;
    r->socket = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (r->socket >= 0) setsockopt(r->socket, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer);
    if (r->socket >= 0 && bind(r->socket, (const struct sockaddr *)address, sizeof *address) == 0) return TROCAR_OK;
    return fail(why, TROCAR_SYSTEM, "cannot listen on %s:%d: %s", inet_ntop(AF_INET, &address->sin_addr, text, sizeof text), ntohs(address->sin_port),
                strerror(errno));
}

trocar_status relay_create(relay *r, const struct sockaddr_in *address, const wire_key *secret, const char *lcm_url, bool realtime, exchange *x,
                           trocar_error *why) {
    wire_key cookie_key;
    *r = (relay){.exchange = x, .socket = -1, .realtime = realtime};
    atomic_init(&r->stop, false);
    if (!randomise(&cookie_key, sizeof cookie_key) || !randomise(r->fresh, sizeof r->fresh))
        return fail(why, TROCAR_SYSTEM, "cannot get random numbers: %s", strerror(errno));
    gate_init(&r->gate, secret, &cookie_key);
    trocar_status status = open_socket(r, address, why);
    if (status == TROCAR_OK) status = network_open(lcm_url, &r->lcm, why);
    return status == TROCAR_OK ? exchange_add_relay(x, why) : status;
}

void relay_free(relay *r) {
    if (r->lcm != NULL) lcm_destroy(r->lcm);
    if (r->socket >= 0) close(r->socket);
    r->lcm = NULL;
    r->socket = -1;
}

static void send_to(relay *r, const unsigned char *datagram, size_t size, const struct sockaddr_in *to) {
    if (sendto(r->socket, datagram, size, MSG_DONTWAIT, (const struct sockaddr *)to, sizeof *to) != (ssize_t)size) r->unsent++;
}

static void tell(const char *what, const struct sockaddr_in *from) {
    char text[INET_ADDRSTRLEN];
    fprintf(stderr, "trocar-server: client at %s:%d %s\n", inet_ntop(AF_INET, &from->sin_addr, text, sizeof text), ntohs(from->sin_port), what);
}

static void take_datagram(relay *r, const unsigned char *datagram, size_t size, const struct sockaddr_in *from) {
    gate_result result;
    gate_verdict verdict = gate_take(&r->gate, datagram, size, from, monotonic_ns(), r->fresh, &result);
    if (verdict == GATE_ANSWER) send_to(r, result.answer, result.answer_size, from);
    if (verdict == GATE_RELAY && lcm_publish(r->lcm, result.channel, result.bytes, (unsigned)result.size) != 0) r->unpublished++;
    if (result.is_new) {
        randomise(r->fresh, sizeof r->fresh); /* cannot fail after the first call */
        tell("connected", from);
    }
    if (r->gate.wrong.sin_port != 0 && !r->wrong_told) {
        r->wrong_told = true;
        tell("has another secret and is refused", &r->gate.wrong);
    }
}

static void receive(relay *r) {
    static _Thread_local unsigned char datagram[WIRE_MOST + 1]; /* a longer datagram gets truncated to a size that no valid one has */
    for (int i = 0; i < RUN_MOST && r->credit >= 1.0; i++, r->credit -= 1.0) {
        struct sockaddr_in from = {0};
        socklen_t length = sizeof from;
        ssize_t size = recvfrom(r->socket, datagram, sizeof datagram, 0, (struct sockaddr *)&from, &length);
        if (size < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
        if (size >= 0 && from.sin_family == AF_INET) take_datagram(r, datagram, (size_t)size, &from);
    }
}

static void send_outgoing(relay *r) {
    outgoing_message m;
    unsigned char datagram[WIRE_MOST];
    while (spsc_ring_pop(&r->exchange->outgoing, &m)) {
        int64_t now = monotonic_ns();
        for (int i = 0; i < GATE_CLIENTS; i++) {
            size_t size = gate_put(&r->gate, i, m.session, m.channel, m.bytes, m.size, now, datagram);
            if (size > 0) send_to(r, datagram, size, &r->gate.clients[i].address);
        }
    }
}

/* Waits for datagrams and for the IO thread. If datagrams have been arriving too fast, leaves them in the kernel's bounded buffer for a while. */
static void wait_for_work(relay *r) {
    int64_t now = monotonic_ns();
    double credit = r->credit + WORK_RATE * 1e-9 * (double)(now - r->credited);
    r->credit = credit < WORK_RATE / 10 ? credit : WORK_RATE / 10;
    r->credited = now;
    bool may_receive = r->credit >= 1.0;
    struct pollfd work[] = {{.fd = r->exchange->relay_wake, .events = POLLIN}, {.fd = may_receive ? r->socket : -1, .events = POLLIN}};
    if (poll(work, 2, may_receive ? -1 : PAUSE) > 0 && work[0].revents != 0) eventfd_wait(r->exchange->relay_wake);
}

void *relay_run(void *context) {
    relay *r = context;
    if (r->realtime) realtime_use_fifo(PRIORITY_RELAY); /* if this fails, stay at normal priority */
    while (!atomic_load_explicit(&r->stop, memory_order_acquire)) {
        wait_for_work(r);
        receive(r);
        send_outgoing(r);
    }
    send_outgoing(r);
    return NULL;
}

void relay_stop(relay *r) {
    atomic_store_explicit(&r->stop, true, memory_order_release);
    eventfd_signal(r->exchange->relay_wake);
}

void relay_summarise(const relay *r, FILE *out) {
    const gate_counts *c = &r->gate.counts;
    fprintf(out, "unicast    %lld connections, %lld messages relayed; dropped: %lld forged, %lld replayed, %lld malformed, %lld over the limit; "
            "%lld not published, %lld not sent\n", (long long)c->connected, (long long)c->relayed, (long long)c->forged, (long long)c->replayed,
            (long long)c->malformed, (long long)c->excessive, (long long)r->unpublished, (long long)r->unsent);
}
