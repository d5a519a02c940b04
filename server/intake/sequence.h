/* Checks the order of one session's messages by their sequence numbers, following RFC 3550, A.1. A number that repeats, goes back or jumps too far is
   refused, but a sender is never locked out permanently. */
#ifndef TROCAR_SEQUENCE_H
#define TROCAR_SEQUENCE_H

#include <stdbool.h>
#include <stdint.h>

enum { SEQUENCE_RUN = 3 };       /* number of consecutive messages in order that start a new sequence */

typedef struct {
    int64_t newest;              /* last number accepted */
    int64_t refused;             /* last number refused */
    int run;                     /* length of the run of refused messages in order that ends with `refused`; 0 if there is none */
} sequence;

/* Starts the sequence at this number. */
void sequence_begin(sequence *s, int64_t number);

/* Returns how many messages are missing before `number`; -1 if the number repeats, goes back, or jumps farther than any real sender would. */
int64_t sequence_gap(const sequence *s, int64_t number);

/* True if this message may be used: either it is in order, or it is the last of SEQUENCE_RUN refused messages that are in order among
   themselves. Such a run means that the sender has started a new sequence, or that a message with a wrong number had been accepted before. If the
   message is used, call sequence_begin next. */
bool sequence_accepts(sequence *s, int64_t number);

#endif
