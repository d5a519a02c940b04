#define _GNU_SOURCE
#include "peers.h"

#include <errno.h>
#include <inttypes.h>
#include <linux/sockios.h>
#include <linux/tcp.h>
#include <netdb.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/host_port.h"
#include "common/timing.h"

enum { LARGEST_TRANSFORM = 65536, TRACKER = PEERS, PACES = 16 };
static const int64_t SECOND = 1000000000;   /* ns */
static const int64_t PACE_INTERVAL = 30000000; /* ns between records of how much a client has read; PACES records cover half a second */
static const uint64_t LEAST_UNREAD = 65536; /* a client may always have this many unread bytes */
static const double LONGEST_UNREAD = 0.2;   /* s: it may have more if it can read them within this time */
static const char STANDARD_PORT[] = "18944";

/* A record of how many bytes a client had read at some time. */
typedef struct {
    int64_t at;              /* ns, monotonic */
    uint64_t read;           /* bytes */
} pace;

struct peer {
    int socket;
    bool connecting;         /* still connecting to the tracker's server */
    char who[80];            /* address and port */
    int version;             /* highest header version received from the peer, and used for messages to it */
    igtl_packet *sending;    /* the message being sent; NULL if there is none */
    size_t sent;             /* number of bytes of that message already sent */
    uint64_t whole;          /* number of bytes sent since the peer connected */
    int64_t sent_at;         /* ns: when the last byte was sent */
    uint64_t widest;         /* bytes, largest receive window offered by the peer so far */
    pace paces[PACES];       /* ring buffer; newest_pace is the index of the newest record */
    int newest_pace;
    int turn;                /* index, among the heavy messages, of the one whose turn it is */
    int64_t *given;          /* for each message, the number of the last value sent to the peer */
    igtl_head head;          /* header of the incoming message */
    bool in_body;            /* the next bytes belong to the body of the incoming message */
    uint64_t skip;           /* number of bytes still to come of a body that is being skipped */
    size_t filled;
    unsigned char bytes[LARGEST_TRANSFORM]; /* holds a header, or a transform's body, until it is complete */
    int64_t complained;      /* ns, monotonic: when a fault was last reported; 0 if never */
    int unsaid;              /* number of unreported faults since then */
};

/* ---- coming and going ---- */

static void close_peer(peers *p, int i, const char *why) {
    peer *c = p->all[i];
    p->all[i] = NULL;
    if (why) fprintf(stderr, "trocar-slicer: %s %s\n", c->who, why);
    close(c->socket);
    igtl_drop(c->sending);
    free(c->given);
    free(c);
    if (i == TRACKER) p->tracker_retry = monotonic_ns() + SECOND;
}

static void close_broken(peers *p, int i) {
    char why[128];
    snprintf(why, sizeof why, "has disconnected: %s", strerror(errno));
    close_peer(p, i, why);
}

static void name_peer(peer *c, const struct sockaddr *address, socklen_t size) {
    char host[64] = "?", port[8] = "?";
    getnameinfo(address, size, host, sizeof host, port, sizeof port, NI_NUMERICHOST | NI_NUMERICSERV);
    snprintf(c->who, sizeof c->who, "%s:%s", host, port);
}

static peer *add_peer(peers *p, int i, int socket, const struct sockaddr *address, socklen_t size) {
    const int on = 1, unsent = 65536; /* unsent: the socket does not count as writable while the kernel holds more unsent bytes than this, because queued
                                         values go out of date */
    peer *c = calloc(1, sizeof *c);
    int64_t *given = calloc((size_t)p->settings.message_count, sizeof *given);
    if (!c || !given) {
        close(socket);
        free(c);
        free(given);
        return NULL;
    }
    setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    setsockopt(socket, IPPROTO_TCP, TCP_NOTSENT_LOWAT, &unsent, sizeof unsent);
    setsockopt(socket, SOL_SOCKET, SO_KEEPALIVE, &on, sizeof on);
    c->socket = socket;
    c->version = 1;
    c->given = given;
    name_peer(c, address, size);
    return p->all[i] = c;
}

static void accept_peer(peers *p) {
    struct sockaddr_storage address;
    socklen_t size = sizeof address;
    int socket = accept4(p->listener, (struct sockaddr *)&address, &size, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (socket < 0) return;
    int i = 0;
    while (i < PEERS && p->all[i]) i++;
    if (i == PEERS) {
        fprintf(stderr, "trocar-slicer: refused a client: %d are connected already\n", PEERS);
        close(socket);
        return;
    }
    peer *c = add_peer(p, i, socket, (struct sockaddr *)&address, size);
    if (c) fprintf(stderr, "trocar-slicer: %s has connected, clients: %d\n", c->who, peers_count(p));
}

int peers_count(const peers *p) {
    int count = 0;
    for (int i = 0; i < PEERS; i++) count += p->all[i] != NULL;
    return count;
}

/* ---- the tracker's server ---- */

/* Moves on to the tracker's next address at once or, after the last one, back to the first in a second. */
static void try_next_address(peers *p, int error) {
    p->tracker = p->tracker->ai_next;
    p->tracker_retry = monotonic_ns() + (p->tracker ? 0 : SECOND);
    if (p->tracker) return;
    p->tracker = p->tracker_addresses;
    if (!p->tracker_said) fprintf(stderr, "trocar-slicer: no tracker at %s yet: %s; trying again every second\n", p->settings.tracker, strerror(error));
    p->tracker_said = true;
}

static void connect_tracker(peers *p) {
    const struct addrinfo *a = p->tracker;
    p->tracker_retry = monotonic_ns() + SECOND;
    int s = socket(a->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (s < 0 || (connect(s, a->ai_addr, a->ai_addrlen) != 0 && errno != EINPROGRESS)) {
        try_next_address(p, errno);
        if (s >= 0) close(s);
        return;
    }
    peer *c = add_peer(p, TRACKER, s, a->ai_addr, a->ai_addrlen);
    if (c) c->connecting = true;
}

static void end_connecting(peers *p) {
    peer *c = p->all[TRACKER];
    socklen_t size = sizeof errno;
    if (getsockopt(c->socket, SOL_SOCKET, SO_ERROR, &errno, &size) == 0 && errno == 0) {
        c->connecting = p->tracker_said = false;
        fprintf(stderr, "trocar-slicer: reading transforms from %s\n", c->who);
        return;
    }
    int error = errno;
    close_peer(p, TRACKER, NULL);
    try_next_address(p, error);
}

/* ---- receiving ---- */

/* Reports a peer's fault to the user, at most once per second. */
static void complain(peer *c, const char *what, const char *fault) {
    int64_t now = monotonic_ns();
    if (c->complained != 0 && now - c->complained < SECOND) {
        c->unsaid++;
        return;
    }
    fprintf(stderr, "trocar-slicer: %s: %s %s, ignored", c->who, what, fault);
    if (c->unsaid) fprintf(stderr, "; so were %d before", c->unsaid);
    fputc('\n', stderr);
    c->complained = now;
    c->unsaid = 0;
}

/* Answers a GET_ query by sending the current values of that message type again, either all of them or the one with the given name. Other queries need no
   answer, because all messages are sent anyway. */
static void answer_query(const peers *p, peer *c) {
    if (strncmp(c->head.type, "GET_", 4) != 0) return;
    const char *type = c->head.type + 4; /* with the prefix GET_, the type is truncated to 12 bytes: TRANSFORM becomes TRANSFOR */
    for (int i = 0; i < p->settings.message_count; i++) {
        const igtl_message *m = &p->settings.messages[i];
        if (*type && strncmp(type, m->type, strlen(type)) == 0 && (!c->head.name[0] || strcmp(c->head.name, m->name) == 0)) c->given[i] = 0;
    }
}

static const char *begin_message(const peers *p, peer *c) {
    const char *fault = igtl_read_head(c->bytes, &c->head);
    if (fault) return fault;
    if (c->head.version > c->version) c->version = c->head.version;
    c->in_body = strcmp(c->head.type, "TRANSFORM") == 0 && c->head.size > 0 && c->head.size <= LARGEST_TRANSFORM;
    if (!c->in_body) c->skip = c->head.size;
    if (!c->in_body && strcmp(c->head.type, "TRANSFORM") == 0) complain(c, "a TRANSFORM", "has a wrong size");
    answer_query(p, c);
    return NULL;
}

static void end_message(const peers *p, peer *c) {
    ras_matrix matrix;
    char what[64];
    const char *fault = igtl_read_transform(&c->head, c->bytes, &matrix);
    if (!fault) fault = ras_fault(&matrix);
    c->in_body = false;
    if (!fault) {
        p->settings.transform(p->settings.context, c->who, c->head.name, &matrix);
        return;
    }
    snprintf(what, sizeof what, "the TRANSFORM \"%s\"", c->head.name);
    complain(c, what, fault);
}

/* Handles received bytes. Returns NULL, or a message that says why the peer's data no longer makes sense. */
static const char *take_bytes(const peers *p, peer *c, const unsigned char *bytes, size_t count) {
    const char *fault = NULL;
    while (count > 0 && !fault) {
        uint64_t wanted = c->skip ? c->skip : (c->in_body ? c->head.size : IGTL_HEADER_SIZE) - c->filled;
        size_t part = count < wanted ? count : (size_t)wanted;
        if (c->skip) c->skip -= part;
        else {
            memcpy(c->bytes + c->filled, bytes, part);
            c->filled += part;
            if (part == wanted) {
                c->filled = 0;
                if (c->in_body) end_message(p, c);
                else fault = begin_message(p, c);
            }
        }
        bytes += part;
        count -= part;
    }
    return fault;
}

static void receive(peers *p, int i) {
    unsigned char bytes[65536];
    peer *c = p->all[i];
    ssize_t count = recv(c->socket, bytes, sizeof bytes, MSG_DONTWAIT);
    if (count < 0 && (errno == EAGAIN || errno == EINTR)) return;
    if (count < 0) close_broken(p, i);
    else if (count == 0) close_peer(p, i, "has disconnected");
    else {
        char why[128];
        const char *fault = take_bytes(p, c, bytes, (size_t)count);
        snprintf(why, sizeof why, "%s: disconnected", fault ? fault : "");
        if (fault) close_peer(p, i, why);
    }
}

/* ---- how far a client is behind ---- */

/* Estimates how many bytes the peer has not read yet: those in transit and those waiting on its machine. The latter are inferred from how far its receive
   window is below the largest one. Acknowledgements report the window, but the peer does not send one just because it has read data, so the estimate may be
   too high until something more is sent. */
static uint64_t unread(peer *c) {
    struct tcp_info info = {0};
    socklen_t size = sizeof info;
    int on_the_way = 0;
    if (ioctl(c->socket, SIOCOUTQ, &on_the_way) != 0) on_the_way = 0;
    bool known = getsockopt(c->socket, IPPROTO_TCP, TCP_INFO, &info, &size) == 0 && size >= offsetof(struct tcp_info, tcpi_snd_wnd) + sizeof info.tcpi_snd_wnd;
    if (!known) return 0;
    if (info.tcpi_snd_wnd > c->widest) c->widest = info.tcpi_snd_wnd;
    return c->widest - info.tcpi_snd_wnd + (uint64_t)on_the_way;
}

/* Returns how fast the peer has been reading over the last half second, in bytes per second. */
static double reading_rate(peer *c, uint64_t waiting, int64_t now) {
    pace *newest = &c->paces[c->newest_pace], at_present = {now, c->whole > waiting ? c->whole - waiting : 0};
    if (now - newest->at >= PACE_INTERVAL) {
        c->newest_pace = (c->newest_pace + 1) % PACES;
        c->paces[c->newest_pace] = at_present;
    }
    const pace *oldest = &c->paces[(c->newest_pace + 1) % PACES];
    return oldest->at < now && at_present.read > oldest->read ? 1e9 * (double)(at_present.read - oldest->read) / (double)(now - oldest->at) : 0.0;
}

/* Tells whether heavy messages must wait until the peer has read more of what it was sent, so that it does not show outdated values. Small messages are sent
   regardless, and their acknowledgements report the peer's window. If there are none, one heavy message is sent per second for the same purpose. */
static bool is_behind(peer *c) {
    int64_t now = monotonic_ns();
    uint64_t waiting = unread(c);
    double most = LONGEST_UNREAD * reading_rate(c, waiting, now);
    if ((double)waiting <= most || waiting <= LEAST_UNREAD) return false;
    if (now - c->sent_at < SECOND) return true;
    c->widest = 0;
    return false;
}

/* ---- sending ---- */

static bool is_new(const peers *p, const peer *c, int message) { return p->settings.messages[message].number != c->given[message]; }

/* Picks the next message to send: light messages come first, and heavy ones take turns. Returns its index, or -1. */
static int next_message(const peers *p, peer *c) {
    int light = p->settings.light_count, heavy = p->settings.message_count - light;
    for (int i = 0; i < light; i++)
        if (is_new(p, c, i)) return i;
    for (int i = 0; i < heavy; i++) {
        int message = light + (c->turn + i) % heavy;
        if (is_new(p, c, message)) return is_behind(c) ? -1 : message;
    }
    return -1;
}

static bool begin_sending(peers *p, peer *c) {
    int message = next_message(p, c);
    if (message < 0) return false;
    igtl_message *m = &p->settings.messages[message];
    c->given[message] = m->number;
    if (message >= p->settings.light_count) c->turn = message - p->settings.light_count + 1;
    c->sending = igtl_take(m, c->version);
    c->sent = 0;
    return true;
}

static void note_sent(peer *c, size_t count) {
    c->sent += count;
    c->whole += count;
    c->sent_at = monotonic_ns();
}

/* Sends messages until the socket accepts no more data. */
static void send_news(peers *p, int i) {
    peer *c = p->all[i];
    while (c->sending || begin_sending(p, c)) {
        if (!c->sending) continue; /* no memory for the message */
        ssize_t count = send(c->socket, c->sending->bytes + c->sent, c->sending->size - c->sent, MSG_DONTWAIT | MSG_NOSIGNAL);
        if (count < 0 && (errno == EAGAIN || errno == EINTR)) return;
        if (count < 0) close_broken(p, i);
        else note_sent(c, (size_t)count);
        if (count < 0 || c->sent < c->sending->size) return;
        igtl_drop(c->sending);
        c->sending = NULL;
    }
}

/* ---- poll ---- */

int peers_watch(peers *p, struct pollfd *events) {
    int count = 0;
    if (p->tracker && !p->all[TRACKER] && monotonic_ns() >= p->tracker_retry) connect_tracker(p);
    events[count++] = (struct pollfd){.fd = p->listener, .events = POLLIN};
    for (int i = 0; i <= TRACKER; i++) {
        peer *c = p->all[i];
        if (!c) continue;
        bool writes = c->connecting || (i != TRACKER && (c->sending || next_message(p, c) >= 0));
        events[count++] = (struct pollfd){.fd = c->socket, .events = (short)(POLLIN | (writes ? POLLOUT : 0))};
    }
    return count;
}

void peers_handle(peers *p, const struct pollfd *events, int count) {
    int next = 1; /* index of the next peer's event; events are in the order of the peers */
    for (int i = 0; i <= TRACKER && next < count; i++) {
        if (!p->all[i] || p->all[i]->socket != events[next].fd) continue;
        short ready = events[next++].revents;
        if (p->all[i]->connecting) {
            if (ready) end_connecting(p);
            continue;
        }
        if (ready & (POLLIN | POLLHUP | POLLERR)) receive(p, i);
        if (p->all[i] && (ready & POLLOUT)) send_news(p, i);
    }
    if (events[0].revents) accept_peer(p); /* last, because the events do not include the new peer */
}

/* ---- opening ---- */

static trocar_status find_tracker(peers *p, trocar_error *why) {
    char host[256], port[6];
    const struct addrinfo wanted = {.ai_socktype = SOCK_STREAM};
    if (!split_host_port(p->settings.tracker, STANDARD_PORT, host, port))
        return fail(why, TROCAR_BAD_INPUT, "--tracker %s: expected HOST or HOST:PORT, with the port from 1 to 65535 and an IPv6 address in brackets", p->settings.tracker);
    int error = getaddrinfo(host, port, &wanted, &p->tracker_addresses);
    p->tracker = p->tracker_addresses;
    return error == 0 ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "--tracker %s: %s", p->settings.tracker, gai_strerror(error));
}

static trocar_status start_listening(peers *p, trocar_error *why) {
    const peer_settings *s = &p->settings;
    char port[8];
    const int on = 1;
    struct addrinfo *found = NULL, wanted = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE | AI_NUMERICHOST};
    snprintf(port, sizeof port, "%d", s->port);
    int error = getaddrinfo(s->address, port, &wanted, &found);
    if (error != 0) return fail(why, TROCAR_BAD_INPUT, "--bind %s: %s", s->address, gai_strerror(error));
    p->listener = socket(found->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    setsockopt(p->listener, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    struct sockaddr_storage own = {0};
    socklen_t size = sizeof own;
    bool listens = p->listener >= 0 && bind(p->listener, found->ai_addr, found->ai_addrlen) == 0 && listen(p->listener, PEERS) == 0
                && getsockname(p->listener, (struct sockaddr *)&own, &size) == 0;
    error = errno;
    freeaddrinfo(found);
    if (!listens)
        return fail(why, TROCAR_BAD_INPUT, "cannot listen on %s, port %d: %s; another program may use it: choose another --port", s->address, s->port, strerror(error));
    if (getnameinfo((struct sockaddr *)&own, size, NULL, 0, port, sizeof port, NI_NUMERICSERV) == 0) p->port = atoi(port);
    return TROCAR_OK;
}

trocar_status peers_open(peers *p, const peer_settings *settings, trocar_error *why) {
    *p = (peers){.settings = *settings, .listener = -1};
    trocar_status status = settings->tracker ? find_tracker(p, why) : TROCAR_OK;
    return status == TROCAR_OK ? start_listening(p, why) : status;
}

void peers_close(peers *p) {
    for (int i = 0; i <= TRACKER; i++)
        if (p->all[i]) close_peer(p, i, NULL);
    if (p->listener >= 0) close(p->listener);
    if (p->tracker_addresses) freeaddrinfo(p->tracker_addresses);
}
