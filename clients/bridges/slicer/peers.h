/* The OpenIGTLink clients: up to PEERS of them, none of which ever delays another or the caller. A client that accepts no data now has at most one
   message under way; the next one carries the newest value, so that a slow client skips values instead of falling behind. Optionally also a
   connection to a tracker's own server, such as PLUS, from which transforms are read. */
#ifndef TROCAR_PEERS_H
#define TROCAR_PEERS_H

#include <poll.h>

#include "igtl.h"

enum { PEERS = 64 };

typedef struct peer peer;

typedef struct {
    const char *address;     /* to listen on */
    int port;                /* 0: any free one */
    const char *tracker;     /* HOST[:PORT] of a server to read from, NULL: none */
    igtl_message *messages;  /* what every client receives */
    int message_count, light_count; /* the first light_count of them are sent before the others */
    /* Called for each well-formed TRANSFORM. `who`: its sender, for messages to people. */
    void (*transform)(void *context, const char *who, const char *name, const ras_matrix *matrix);
    void *context;
} peer_settings;

typedef struct {
    peer_settings settings;
    int listener;
    int port;                /* listened on */
    peer *all[PEERS + 1];    /* NULL: free; the last one is the tracker's server */
    struct addrinfo *tracker_addresses, *tracker; /* addresses of the tracker's host, and the next one to try; NULL: no tracker */
    int64_t tracker_retry;   /* ns, monotonic: not before */
    bool tracker_said;       /* it has been reported that it does not answer */
} peers;

/* Listens. BAD_INPUT for an address or a port that cannot be used, and for a tracker's host that is not known. */
trocar_status peers_open(peers *p, const peer_settings *settings, report *why);
void peers_close(peers *p);

int peers_count(const peers *p); /* clients now */

/* For poll(): fills in at most PEERS + 2 descriptors and returns their number; peers_handle then handles the ready ones. */
int peers_watch(peers *p, struct pollfd *events);
void peers_handle(peers *p, const struct pollfd *events, int count);

#endif
