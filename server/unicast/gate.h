/* Decides what to do with each unicast datagram. Handles the handshake, keeps the table of authenticated clients, and protects against replays.

   A client sends HELLO and receives a COOKIE: the time, and an HMAC of that time, the client's address and its nonce under a key that only this gate
   knows. The client returns the cookie with CONNECT, which proves that it knows the secret and receives at its address. Only then does the gate store
   anything about the client. The gate answers with WELCOME and a new nonce of its own, so that messages from earlier connections are not authentic in this one.

   Work and memory are bounded: an answer is never larger than the datagram it answers, there are at most GATE_CLIENTS clients, and each may send GATE_RATE
   messages per second. */
#ifndef TROCAR_GATE_H
#define TROCAR_GATE_H

#include <netinet/in.h>

#include "unicast/wire.h"

enum {
    GATE_CLIENTS = 32,
    GATE_RATE = 4000,            /* messages per second from each client, averaged over 0.25 s */
    GATE_REFUSALS = 10           /* answers per second to clients with a wrong secret */
};

typedef struct {
    bool connected;
    struct sockaddr_in address;
    unsigned char nonce[WIRE_NONCE], token[WIRE_TOKEN]; /* nonces of the client and of the gate */
    wire_key to_server, to_client;
    wire_window received;
    uint64_t sent;               /* counter of the last message to the client */
    uint64_t cookie_time;        /* ns, time in the cookie that the client connected with */
    int64_t heard;               /* ns, monotonic: when its last authentic message or its CONNECT arrived */
    int64_t session;             /* session in its last message; 0 before the first */
    double credit;               /* how many messages it may send now */
    int64_t credited;            /* ns, when `credit` last changed */
} gate_client;

typedef struct {
    int64_t connected;           /* handshakes completed since the start; what follows are datagrams dropped since the start */
    int64_t relayed;             /* messages */
    int64_t malformed;           /* not of this protocol, or a message that clients may not send */
    int64_t forged;              /* wrong tag, cookie or sender */
    int64_t replayed;            /* its counter was received before, or is too old */
    int64_t excessive;           /* more than GATE_RATE per second */
    int64_t full;                /* handshakes refused because there were GATE_CLIENTS clients already */
} gate_counts;

typedef struct {
    wire_key secret, cookie;     /* cookie: known only to this gate */
    gate_client clients[GATE_CLIENTS];
    gate_counts counts;
    int64_t refused_since;       /* ns, start of the second in which `refusals` are counted */
    int refusals;
    struct sockaddr_in wrong;    /* sender of the last HELLO with a wrong tag; its port is 0 before the first */
} gate;

typedef enum {
    GATE_DROP,                   /* nothing to do */
    GATE_ANSWER,                 /* send `answer` to the sender of the datagram */
    GATE_RELAY                   /* an authentic message from a client to the server */
} gate_verdict;

typedef struct {
    unsigned char answer[WIRE_MOST];
    size_t answer_size;
    const char *channel;         /* the channel to publish on: TROCAR_POSE, TROCAR_PROBE, TROCAR_COMMAND, TROCAR_CHANGE or, for SHUTDOWN, REMOTE_COMMAND */
    const unsigned char *bytes;  /* the message, inside the datagram */
    size_t size;
    bool is_new;                 /* a client has connected */
} gate_result;

/* Starts a gate with no clients. `cookie_key` must be random. */
void gate_init(gate *g, const wire_key *secret, const wire_key *cookie_key);

/* Decides what to do with a datagram that arrived at time `now` (ns, monotonic, above 0). `fresh`: a random number, which becomes the gate's nonce if the
   datagram completes a handshake. */
gate_verdict gate_take(gate *g, const unsigned char *datagram, size_t size, const struct sockaddr_in *from, int64_t now,
                       const unsigned char fresh[WIRE_TOKEN], gate_result *result);

/* Writes the datagram that carries a message from the server to client `index`. `session`: whom the message is for. Returns the datagram's size, or 0 if this
   client is not to get it. */
size_t gate_put(gate *g, int index, int64_t session, const char *channel, const void *bytes, size_t size, int64_t now, unsigned char to[WIRE_MOST]);

/* Returns how many clients are connected and not silent. */
int gate_present(const gate *g, int64_t now);

#endif
