/* Checks the order of a session's messages by their sequence numbers, following RFC 3550, A.1. Refuses numbers that repeat, go back or jump too far, but never
   locks a sender out for good. */
#ifndef TROCAR_SEQUENCE_H
#define TROCAR_SEQUENCE_H

#include <stdbool.h>
#include <stdint.h>

enum { SEQUENCE_RUN = 3 };       /* this many messages in order start a new sequence */

typedef struct {
    int64_t newest;              /* last number accepted */
    int64_t refused;             /* last number refused */
    int run;                     /* how many refused messages in a row, up to `refused`, were in order among themselves; 0 if none */
} sequence;

/* Starts the sequence at this number. */
void sequence_begin(sequence *s, int64_t number);

/* Returns how many messages are missing before `number`; -1 if the number repeats, goes back, or jumps further than a real sender's would. */
int64_t sequence_gap(const sequence *s, int64_t number);

/* Returns whether this message may be used. It may if it is in order, or if it completes a run of SEQUENCE_RUN refused messages that are in order among
   themselves. Such a run means that the sender has started a new sequence, or that a wrong number had been accepted before. Call sequence_begin next if you use
   the message. */
bool sequence_accepts(sequence *s, int64_t number);

#endif
