#include "unicast/gate.h"

#include <string.h>

#include <nettle/memops.h>

#include "trocar_command_t.h"

static const int64_t SILENCE = 3000000000;      /* ns without a message after which a client is forgotten; clients send four times per second */
static const uint64_t COOKIE_LIFE = 5000000000; /* ns for which a cookie is valid */
enum { COOKIE_MAC = WIRE_TOKEN - 8 };

void gate_init(gate *g, const wire_key *secret, const wire_key *cookie_key) { *g = (gate){.secret = *secret, .cookie = *cookie_key}; }

static bool same_address(const struct sockaddr_in *a, const struct sockaddr_in *b) {
    return a->sin_addr.s_addr == b->sin_addr.s_addr && a->sin_port == b->sin_port;
}

static bool is_present(const gate_client *c, int64_t now) { return c->connected && now - c->heard < SILENCE; }

int gate_present(const gate *g, int64_t now) {
    int count = 0;
    for (int i = 0; i < GATE_CLIENTS; i++) count += is_present(&g->clients[i], now);
    return count;
}

/* Returns the client with this address, or NULL. */
static gate_client *client_at(gate *g, const struct sockaddr_in *from, int64_t now) {
    for (gate_client *c = g->clients; c < g->clients + GATE_CLIENTS; c++)
        if (is_present(c, now) && same_address(&c->address, from)) return c;
    return NULL;
}

static gate_client *free_client(gate *g, int64_t now) {
    for (gate_client *c = g->clients; c < g->clients + GATE_CLIENTS; c++)
        if (!is_present(c, now)) return c;
    return NULL;
}

/* ---- the handshake -------------------------------------------------------------------------------------------------------- */

/* Returns the time stored in a cookie. */
static uint64_t time_of(const unsigned char *token) { return wire_get_number(token, 8); }

static void make_cookie(const gate *g, const struct sockaddr_in *from, const unsigned char *nonce, uint64_t time, unsigned char token[WIRE_TOKEN]) {
    unsigned char text[8 + WIRE_NONCE + 4 + 2], tag[WIRE_TAG];
    wire_put_number(text, time);
    memcpy(text + 8, nonce, WIRE_NONCE);
    memcpy(text + 8 + WIRE_NONCE, &from->sin_addr.s_addr, 4);
    memcpy(text + 8 + WIRE_NONCE + 4, &from->sin_port, 2);
    wire_tag(&g->cookie, text, sizeof text, tag);
    memcpy(token, text, 8);
    memcpy(token + 8, tag, COOKIE_MAC);
}

static bool is_own_cookie(const gate *g, const struct sockaddr_in *from, const wire_handshake *h, int64_t now) {
    unsigned char own[WIRE_TOKEN];
    uint64_t made = time_of(h->token);
    make_cookie(g, from, h->nonce, made, own);
    return made <= (uint64_t)now && (uint64_t)now - made < COOKIE_LIFE && memeql_sec(own, h->token, WIRE_TOKEN);
}

static gate_verdict answer(gate_result *result, wire_kind kind, const wire_handshake *h, const wire_key *key) {
    result->answer_size = wire_put_handshake(result->answer, kind, h, key);
    return GATE_ANSWER;
}

/* Tells a client that its secret is wrong. The answer is not authenticated, and only a few are sent per second. */
static gate_verdict refuse_secret(gate *g, const struct sockaddr_in *from, wire_handshake *h, int64_t now, gate_result *result) {
    g->counts.forged++;
    g->wrong = *from;
    if (now - g->refused_since >= 1000000000) {
        g->refused_since = now;
        g->refusals = 0;
    }
    if (g->refusals++ >= GATE_REFUSALS) return GATE_DROP;
    memset(h->token, 0, WIRE_TOKEN);
    h->token[0] = WIRE_WRONG_SECRET;
    return answer(result, WIRE_REFUSED, h, NULL);
}

static void connect_client(gate *g, gate_client *c, const struct sockaddr_in *from, const wire_handshake *h, int64_t now, const unsigned char *fresh) {
    *c = (gate_client){.connected = true, .address = *from, .cookie_time = time_of(h->token), .heard = now, .credit = GATE_RATE / 4, .credited = now};
    memcpy(c->nonce, h->nonce, WIRE_NONCE);
    memcpy(c->token, fresh, WIRE_TOKEN);
    c->to_server = wire_direction_key(&g->secret, WIRE_TO_SERVER, c->nonce, c->token);
    c->to_client = wire_direction_key(&g->secret, WIRE_TO_CLIENT, c->nonce, c->token);
    g->counts.connected++;
}

/* Handles a CONNECT. If the same one arrives twice, it gets the same answer twice. One made before the client's current connection is a replay. */
static gate_verdict take_connect(gate *g, wire_handshake *h, const struct sockaddr_in *from, int64_t now, const unsigned char *fresh, gate_result *result) {
    if (!is_own_cookie(g, from, h, now)) {
        g->counts.forged++;
        return GATE_DROP;
    }
    gate_client *c = client_at(g, from, now);
    bool again = c != NULL && memcmp(c->nonce, h->nonce, WIRE_NONCE) == 0;
    if (c != NULL && !again && time_of(h->token) <= c->cookie_time) {
        g->counts.replayed++;
        return GATE_DROP;
    }
    if (c == NULL && (c = free_client(g, now)) == NULL) {
        g->counts.full++;
        memset(h->token, 0, WIRE_TOKEN);
        h->token[0] = WIRE_FULL;
        return answer(result, WIRE_REFUSED, h, &g->secret);
    }
    if (!again) {
        connect_client(g, c, from, h, now, fresh);
        result->is_new = true;
    }
    memcpy(h->token, c->token, WIRE_TOKEN);
    return answer(result, WIRE_WELCOME, h, &g->secret);
}

/* ---- messages ------------------------------------------------------------------------------------------------------------- */

/* Offsets in a message. It begins with fingerprint, utime and session; in a command_t, the command's number comes next. */
enum { SESSION = 16, COMMAND = SESSION + 8 };

static bool is_shutdown(const wire_message *m) {
    return m->size >= COMMAND + 4 && wire_get_number(m->bytes + COMMAND, 4) == TROCAR_COMMAND_T_SHUTDOWN;
}

/* Returns the channel to publish a message on, or NULL if clients may not send it. SHUTDOWN goes to a channel of its own, so that the server treats it as
   coming from another machine. Everything else is checked by the server's arbiters. */
static const char *published(const wire_message *m) {
    static const char *const relayed[] = {"TROCAR_POSE", "TROCAR_COMMAND", "TROCAR_PROBE", "TROCAR_CHANGE"};
    if (m->size < SESSION + 8 || m->size > WIRE_MESSAGE_MOST) return NULL;
    if (strcmp(m->channel, "TROCAR_COMMAND") == 0 && is_shutdown(m)) return "REMOTE_COMMAND";
    for (size_t i = 0; i < sizeof relayed / sizeof *relayed; i++)
        if (strcmp(m->channel, relayed[i]) == 0) return relayed[i];
    return NULL;
}

static bool has_credit(gate_client *c, int64_t now) {
    double most = GATE_RATE / 4, credit = c->credit + GATE_RATE * 1e-9 * (double)(now - c->credited);
    c->credited = now;
    c->credit = credit < most ? credit : most;
    if (c->credit < 1.0) return false;
    c->credit -= 1.0;
    return true;
}

static gate_verdict take_message(gate *g, gate_client *c, const unsigned char *datagram, size_t size, int64_t now, gate_result *result) {
    wire_message m;
    if (!wire_is_authentic(&c->to_server, datagram, size)) return g->counts.forged++, GATE_DROP;
    if (!wire_get_message(datagram, size, &m)) return g->counts.malformed++, GATE_DROP;
    if (!wire_window_accepts(&c->received, m.counter)) return g->counts.replayed++, GATE_DROP;
    c->heard = now;
    if (!has_credit(c, now)) return g->counts.excessive++, GATE_DROP;
    if (*m.channel == '\0' && m.size == 0) {
        result->answer_size = wire_put_message(result->answer, WIRE_TO_CLIENT, ++c->sent, "", NULL, 0, &c->to_client);
        return GATE_ANSWER;
    }
    if ((result->channel = published(&m)) == NULL) return g->counts.malformed++, GATE_DROP;
    c->session = (int64_t)wire_get_number(m.bytes + SESSION, 8);
    result->bytes = m.bytes;
    result->size = m.size;
    g->counts.relayed++;
    return GATE_RELAY;
}

gate_verdict gate_take(gate *g, const unsigned char *datagram, size_t size, const struct sockaddr_in *from, int64_t now,
                       const unsigned char fresh[WIRE_TOKEN], gate_result *result) {
    int kind = wire_kind_of(datagram, size);
    result->answer_size = 0;
    result->is_new = false;
    if (kind == WIRE_TO_SERVER) {
        gate_client *c = client_at(g, from, now);
        if (c != NULL) return take_message(g, c, datagram, size, now, result);
        g->counts.forged++;
        return GATE_DROP;
    }
    if (kind != WIRE_HELLO && kind != WIRE_CONNECT) {
        g->counts.malformed++;
        return GATE_DROP;
    }
    wire_handshake h = wire_get_handshake(datagram);
    bool authentic = wire_is_authentic(&g->secret, datagram, size);
    if (!authentic && kind == WIRE_HELLO) return refuse_secret(g, from, &h, now, result);
    if (!authentic) return g->counts.forged++, GATE_DROP;
    if (kind == WIRE_CONNECT) return take_connect(g, &h, from, now, fresh, result);
    make_cookie(g, from, h.nonce, (uint64_t)now, h.token);
    return answer(result, WIRE_COOKIE, &h, &g->secret);
}

size_t gate_put(gate *g, int index, int64_t session, const char *channel, const void *bytes, size_t size, int64_t now, unsigned char to[WIRE_MOST]) {
    gate_client *c = &g->clients[index];
    if (session == 0 || c->session != session || size > WIRE_MESSAGE_MOST || !is_present(c, now)) return 0;
    return wire_put_message(to, WIRE_TO_CLIENT, ++c->sent, channel, bytes, size, &c->to_client);
}
