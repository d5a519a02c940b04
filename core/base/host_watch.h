/* Progress to the host, and cancellation by it (trocar_watch). Not to be used in functions marked RT. */
#ifndef TROCAR_HOST_WATCH_H
#define TROCAR_HOST_WATCH_H

#include <stdbool.h>

#include "trocar.h"

enum { TICKS_BETWEEN_LOOKS = 64 }; /* ticks: maximum number of ticks of a simulation between two calls of the watch's functions */

/* `watch` may be NULL. */
static inline void watch_report(const trocar_watch *watch, const char *what, double fraction) {
    if (watch && watch->progress) watch->progress(what, fraction, watch->context);
}

static inline bool watch_cancels(const trocar_watch *watch) { return watch && watch->cancelled && watch->cancelled(watch->context); }

#endif
