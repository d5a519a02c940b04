/* Serves up to PEERS OpenIGTLink clients. A client never delays other clients or the caller: at most one message waits for a client that does not accept data,
   and the next one carries the newest value, so that a slow client skips values instead of falling behind. Can also connect to a tracker's server, such as
   PLUS, to read transforms. */
#ifndef TROCAR_PEERS_H
#define TROCAR_PEERS_H

#include <poll.h>

#include "igtl.h"

enum { PEERS = 64 };

typedef struct peer peer;

typedef struct {
    const char *address;     /* address on which to listen */
    int port;                /* port number; 0 selects any free port */
    const char *tracker;     /* HOST[:PORT] of a tracker's server to connect to, or NULL */
    igtl_message *messages;  /* messages to send to every client */
    int message_count, light_count; /* number of messages, and how many of the first ones are small and sent first */
    /* Called for each well-formed TRANSFORM. who: the sender, for messages to the user. */
    void (*transform)(void *context, const char *who, const char *name, const ras_matrix *matrix);
    void *context;
} peer_settings;

typedef struct {
    peer_settings settings;
    int listener;
    int port;                /* port on which the program listens */
    peer *all[PEERS + 1];    /* NULL marks a free slot; the last element is the tracker's server */
    struct addrinfo *tracker_addresses, *tracker; /* addresses of the tracker's host, and the next one to try; NULL without a tracker */
    int64_t tracker_retry;   /* ns, monotonic: when to try the tracker again */
    bool tracker_said;       /* the user has been told that the tracker cannot be reached */
} peers;

/* Starts listening. BAD_INPUT if the address or the port cannot be used, or if the tracker's host is unknown. */
trocar_status peers_open(peers *p, const peer_settings *settings, trocar_error *why);
void peers_close(peers *p);

int peers_count(const peers *p); /* number of connected clients */

/* For use with poll(): fills in at most PEERS + 2 descriptors and returns their number. After poll(), call peers_handle to handle those that are ready. */
int peers_watch(peers *p, struct pollfd *events);
void peers_handle(peers *p, const struct pollfd *events, int count);

#endif
