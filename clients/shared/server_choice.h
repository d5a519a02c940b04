/* Chooses the server that a client follows if it hears several on the same LCM URL: the first one, until that falls silent. */
#ifndef TROCAR_SERVER_CHOICE_H
#define TROCAR_SERVER_CHOICE_H

#include <stdbool.h>
#include <stdint.h>

/* State of the choice; start with all zero except `patience`. Times are in s by a single clock, and greater than 0. */
typedef struct {
    double patience;         /* s of silence before the client switches to another server */
    int64_t followed;        /* ID of the server being followed */
    double heard;            /* s, when its last message arrived; 0 before the first */
    int64_t other;           /* ID of the other server that was heard last */
    double other_heard;      /* s, when that server's last message arrived; 0 before the first */
} server_choice;

/* True if a message from `server` that arrived at `now` should be used. */
bool server_choice_follows(server_choice *c, int64_t server, double now);

/* True if another server was heard within the last second. */
bool server_choice_has_other(const server_choice *c, double now);

#endif
