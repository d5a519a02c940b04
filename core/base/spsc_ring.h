/* Every value, in order, from one thread to another without a lock: a ring. One writer, one reader; neither ever waits. Memory
   is allocated, touched and zero at creation. */
#ifndef TROCAR_SPSC_RING_H
#define TROCAR_SPSC_RING_H

#include <stdalign.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "base/cache_line.h"

typedef struct {
    size_t size, capacity;                     /* bytes of an element; number of elements, a power of two */
    unsigned char *elements;
    alignas(CACHE_LINE) atomic_size_t written; /* by the writer, ever */
    alignas(CACHE_LINE) atomic_size_t taken;   /* by the reader, ever */
} spsc_ring;

/* `capacity` is rounded up to a power of two. */
trocar_status spsc_ring_create(spsc_ring *r, size_t size, size_t capacity, report *why);
void spsc_ring_free(spsc_ring *r);

/* False, and nothing changed, when the ring is full. Writer only. RT */
bool spsc_ring_push(spsc_ring *r, const void *element);
/* False when the ring is empty. Reader only. RT */
bool spsc_ring_pop(spsc_ring *r, void *element);

#endif
