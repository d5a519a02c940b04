/* Reports progress to the host, and asks it whether to cancel (trocar_watch). Do not use it in functions marked RT. */
#ifndef TROCAR_HOST_WATCH_H
#define TROCAR_HOST_WATCH_H

#include <stdbool.h>

#include "trocar.h"

/* Returns how many of the `total` ticks to complete before calling the watch's functions again: up to 64 more than `done`. */
static inline int watch_next_look(int done, int total) {
    enum { TICKS_BETWEEN_LOOKS = 64 };
    return total - done < TICKS_BETWEEN_LOOKS ? total : done + TICKS_BETWEEN_LOOKS;
}

/* `watch` may be NULL. */
static inline void watch_report(const trocar_watch *watch, const char *what, double fraction) {
    if (watch && watch->progress) watch->progress(what, fraction, watch->context);
}

static inline bool watch_cancels(const trocar_watch *watch) { return watch && watch->cancelled && watch->cancelled(watch->context); }

#endif
