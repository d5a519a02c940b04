#include "common/session.h"

#include <sys/random.h>

#include "common/timing.h"

int64_t session_new(void) {
    int64_t session;
    if (getrandom(&session, sizeof session, 0) != sizeof session) session = wall_us();
    return (session & INT64_MAX) | 1; /* positive: 0 means that nobody owns the needle */
}
