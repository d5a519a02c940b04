#include "intake/sequence.h"

static const uint64_t LONGEST_GAP = 100000000; /* largest gap accepted: 0.1 s if the sender uses nanoseconds as sequence numbers */

/* Returns how many sequence numbers lie between `newest` and `number`, allowing for wraparound; -1 if `number` is not after `newest` or is too far ahead. */
static int64_t gap_after(int64_t newest, int64_t number) {
    uint64_t gap = (uint64_t)number - (uint64_t)newest - 1;
    return gap < LONGEST_GAP ? (int64_t)gap : -1;
}

void sequence_begin(sequence *s, int64_t number) { *s = (sequence){.newest = number}; }

int64_t sequence_gap(const sequence *s, int64_t number) { return gap_after(s->newest, number); }

bool sequence_accepts(sequence *s, int64_t number) {
    if (sequence_gap(s, number) >= 0) return true;
    s->run = s->run > 0 && gap_after(s->refused, number) >= 0 ? s->run + 1 : 1;
    s->refused = number;
    return s->run >= SEQUENCE_RUN;
}
