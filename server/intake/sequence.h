/* Order of one session's messages by their sequence numbers, after RFC 3550, A.1: a number that repeats, goes back or jumps is refused, but never
   locks its sender out. */
#ifndef TROCAR_SEQUENCE_H
#define TROCAR_SEQUENCE_H

#include <stdbool.h>
#include <stdint.h>

enum { SEQUENCE_RUN = 3 };       /* consecutive messages in order that start a new count */

typedef struct {
    int64_t newest;              /* last one accepted */
    int64_t refused;             /* last one refused, */
    int run;                     /* number of refused messages in order before it; 0: none */
} sequence;

/* Starts with this number. */
void sequence_begin(sequence *s, int64_t number);

/* Number of missing messages before `number`, 0 or more; -1 if it repeats, goes back, or jumps farther than any sender does. */
int64_t sequence_gap(const sequence *s, int64_t number);

/* True if this message may be used: it is in order, or it is the last of SEQUENCE_RUN that are in order among themselves, because the sender has
   started a new count or another one sent a message with a false number. If it is used, call sequence_begin next. */
bool sequence_accepts(sequence *s, int64_t number);

#endif
