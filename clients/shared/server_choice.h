/* Chooses the server that a client follows if two servers send on the same LCM URL: the first one heard, until it falls silent. */
#ifndef TROCAR_SERVER_CHOICE_H
#define TROCAR_SERVER_CHOICE_H

#include <stdbool.h>
#include <stdint.h>

/* State of the choice. All zero at the start, except `patience`. Times are in s, on a single clock, and above 0. */
typedef struct {
    double patience;         /* s of silence from the followed server after which the client follows another one */
    int64_t followed;        /* ID of the followed server */
    double heard;            /* s, arrival time of the followed server's last message; 0 before the first */
    int64_t other;           /* ID of the other server that was heard most recently */
    double other_heard;      /* s, arrival time of the last message from that other server; 0 before the first */
} server_choice;

/* True if a message from `server` that arrived at `now` should be used. */
bool server_choice_follows(server_choice *c, int64_t server, double now);

/* True if another server sent a message within the last second. */
bool server_choice_has_other(const server_choice *c, double now);

#endif
