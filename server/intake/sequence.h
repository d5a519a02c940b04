/* Order of one session's messages by their sequence numbers, after RFC 3550, A.1: a number that repeats, goes back or jumps is refused, but never
   locks its sender out. */
#ifndef TROCAR_SEQUENCE_H
#define TROCAR_SEQUENCE_H

#include <stdbool.h>
#include <stdint.h>

enum { SEQUENCE_RUN = 3 };       /* consecutive messages in order that start a new count */

typedef struct {
    int64_t newest;              /* last number accepted */
    int64_t refused;             /* last number refused */
    int run;                     /* number of consecutive refused messages in order before `refused`; 0 if there is none */
} sequence;

/* Starts the count at this number. */
void sequence_begin(sequence *s, int64_t number);

/* Returns how many messages are missing before `number`; -1 if the number repeats, goes back, or jumps farther than any sender does. */
int64_t sequence_gap(const sequence *s, int64_t number);

/* True if this message may be used: either it is in order, or it is the last of SEQUENCE_RUN refused messages that are in order among
   themselves. Such a run means that the sender has started a new count, or that the count followed a message with a false number. If the message
   is used, call sequence_begin next. */
bool sequence_accepts(sequence *s, int64_t number);

#endif
