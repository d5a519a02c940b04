/* Memory shared by two threads, aligned to cache lines to avoid false sharing. */
#ifndef TROCAR_CACHE_LINE_H
#define TROCAR_CACHE_LINE_H

#include <stdlib.h>
#include <string.h>

#include "base/report.h"

enum { CACHE_LINE = 64 };

/* Allocates zeroed memory and touches it, so that later accesses cause no page faults. Release with free(). */
static inline trocar_status allocate_shared(size_t bytes, unsigned char **memory, report *why) {
    size_t rounded = (bytes + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    *memory = aligned_alloc(CACHE_LINE, rounded);
    if (*memory == NULL) return fail(why, TROCAR_NO_MEMORY, "cannot allocate %zu bytes of memory shared by two threads", rounded);
    memset(*memory, 0, rounded);
    return TROCAR_OK;
}

/* Allocates a zeroed struct with cache-line-aligned members: malloc() aligns to 16 bytes only, and the compiler may rely on more. NULL if there is no memory.
   Release with free(). */
static inline void *allocate_on_cache_lines(size_t bytes) {
    report ignored;
    unsigned char *memory;
    return allocate_shared(bytes, &memory, &ignored) == TROCAR_OK ? memory : NULL;
}

/* Allocates zeros that start on a cache line, for large arrays of one thread. Pages that are never accessed are never touched. NULL if there is no memory.
   Release `*memory` with free(), not the returned pointer. */
static inline void *zeros_on_cache_lines(size_t bytes, void **memory) {
    unsigned char *from = *memory = calloc(1, bytes + CACHE_LINE);
    return from ? from + (CACHE_LINE - (size_t)from % CACHE_LINE) % CACHE_LINE : NULL;
}

#endif
