/* Which server a client follows where two send on one LCM URL: the first one heard, until it falls silent. */
#ifndef TROCAR_SERVER_CHOICE_H
#define TROCAR_SERVER_CHOICE_H

#include <stdbool.h>
#include <stdint.h>

/* All zero at the start, but for `patience`. Times are s on one clock, above 0. */
typedef struct {
    double patience;         /* silence of the followed one after which another takes its place */
    int64_t followed;        /* its number */
    double heard;            /* when its last message came, 0: none yet */
    int64_t other;           /* number of the last other one */
    double other_heard;      /* 0: none yet */
} server_choice;

/* A message from `server` has come: should it be used? */
bool server_choice_follows(server_choice *c, int64_t server, double now);

/* Did another server send within the last second? */
bool server_choice_has_other(const server_choice *c, double now);

#endif
