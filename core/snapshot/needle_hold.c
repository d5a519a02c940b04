#include "snapshot/needle_hold.h"

#include <string.h>

void needle_hold_copy(const needle_hold *from, needle_hold *to) {
    size_t count = (size_t)from->count;
    to->count = from->count;
    to->unstable = from->unstable;
    memcpy(to->rows, from->rows, count * sizeof *from->rows);
    memcpy(to->compliance, from->compliance, count * (count + 1) / 2 * sizeof *from->compliance);
}
