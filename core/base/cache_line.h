/* Allocates memory shared by two threads, aligned to cache lines to prevent false sharing. */
#ifndef TROCAR_CACHE_LINE_H
#define TROCAR_CACHE_LINE_H

#include <stdlib.h>
#include <string.h>

#include "base/error.h"

enum { CACHE_LINE = 64 };

/* Allocates zeroed memory, touching every page so that later accesses do not fault. Release it with free(). */
static inline trocar_status allocate_shared(size_t bytes, unsigned char **memory, trocar_error *why) {
    size_t rounded = (bytes + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    *memory = aligned_alloc(CACHE_LINE, rounded);
    if (*memory == NULL) return fail(why, TROCAR_NO_MEMORY, "cannot allocate %zu bytes of memory shared by two threads", rounded);
    memset(*memory, 0, rounded);
    return TROCAR_OK;
}

/* Allocates a zeroed struct that has cache-line-aligned members. malloc() would not do: it aligns only to 16 bytes, but the compiler may rely on the members'
   alignment. Returns NULL if out of memory. Release it with free(). */
static inline void *allocate_on_cache_lines(size_t bytes) {
    trocar_error ignored;
    unsigned char *memory;
    return allocate_shared(bytes, &memory, &ignored) == TROCAR_OK ? memory : NULL;
}

#endif
