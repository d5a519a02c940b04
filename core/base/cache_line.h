/* Memory shared by two threads, aligned so that neither slows the other. */
#ifndef TROCAR_CACHE_LINE_H
#define TROCAR_CACHE_LINE_H

#include <stdlib.h>
#include <string.h>

#include "base/report.h"

enum { CACHE_LINE = 64 };

/* Zeroed and touched, so that no page faults later; free() releases it. */
static inline trocar_status allocate_shared(size_t bytes, unsigned char **memory, report *why) {
    size_t rounded = (bytes + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    *memory = aligned_alloc(CACHE_LINE, rounded);
    if (*memory == NULL) return fail(why, TROCAR_NO_MEMORY, "cannot allocate %zu bytes to be shared by two threads", rounded);
    memset(*memory, 0, rounded);
    return TROCAR_OK;
}

#endif
