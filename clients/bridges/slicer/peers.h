/* The OpenIGTLink clients: up to PEERS of them, none of which ever delays another or the caller. At most one message is under way to a client that
   accepts no data; the message after it carries the newest value, so that a slow client skips values instead of falling behind. There may also be
   a connection to a tracker's own server, such as PLUS, from which transforms are read. */
#ifndef TROCAR_PEERS_H
#define TROCAR_PEERS_H

#include <poll.h>

#include "igtl.h"

enum { PEERS = 64 };

typedef struct peer peer;

typedef struct {
    const char *address;     /* address to listen on */
    int port;                /* 0: any free port */
    const char *tracker;     /* HOST[:PORT] of a server from which transforms are read; NULL if there is none */
    igtl_message *messages;  /* the messages that every client receives */
    int message_count, light_count; /* number of messages; the first light_count are sent before the others */
    /* Called for each well-formed TRANSFORM; `who` names its sender in messages to the user. */
    void (*transform)(void *context, const char *who, const char *name, const ras_matrix *matrix);
    void *context;
} peer_settings;

typedef struct {
    peer_settings settings;
    int listener;
    int port;                /* listened on */
    peer *all[PEERS + 1];    /* NULL: free; the last element is the tracker's server */
    struct addrinfo *tracker_addresses, *tracker; /* addresses of the tracker's host, and the next one to try; NULL: no tracker */
    int64_t tracker_retry;   /* ns, monotonic: time of the next attempt to connect to the tracker */
    bool tracker_said;       /* the missing tracker has been reported */
} peers;

/* Starts to listen. BAD_INPUT for an address or a port that cannot be used, and for an unknown host of the tracker. */
trocar_status peers_open(peers *p, const peer_settings *settings, report *why);
void peers_close(peers *p);

int peers_count(const peers *p); /* clients now */

/* For poll(): fills in at most PEERS + 2 descriptors and returns their number. After poll(), peers_handle handles those that are ready. */
int peers_watch(peers *p, struct pollfd *events);
void peers_handle(peers *p, const struct pollfd *events, int count);

#endif
