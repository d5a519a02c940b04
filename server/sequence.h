/* Order of one session's messages by their sequence numbers, after RFC 3550, A.1: a number that repeats, goes back or jumps is refused, but
   never locks its sender out. */
#ifndef TROCAR_SEQUENCE_H
#define TROCAR_SEQUENCE_H

#include <stdbool.h>
#include <stdint.h>

enum { SEQUENCE_RUN = 3 };       /* messages in order among themselves that start a new count */

typedef struct {
    int64_t newest;              /* last one accepted */
    int64_t refused;             /* last one refused, */
    int run;                     /* and how many before it, in a row, were refused and in order; 0: none */
} sequence;

/* Starts with this number. */
void sequence_begin(sequence *s, int64_t number);

/* How many numbers are missing before `number`, 0 or more; -1: it repeats, goes back, or jumps farther than any sender's does. */
int64_t sequence_gap(const sequence *s, int64_t number);

/* Whether this message may be used: it is in order, or it is the last of SEQUENCE_RUN that are in order among themselves: the sender numbers its
   messages anew, or another one sent a message with a false number. If it is used, sequence_begin comes next. */
bool sequence_accepts(sequence *s, int64_t number);

#endif
