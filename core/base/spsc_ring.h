/* Lock-free ring buffer: passes every value, in order, from one thread to another. It has one writer and one reader, and neither ever waits. Memory is
   allocated, zeroed and touched at creation. */
#ifndef TROCAR_SPSC_RING_H
#define TROCAR_SPSC_RING_H

#include <stdalign.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "base/cache_line.h"

typedef struct {
    size_t size, capacity;                     /* bytes per element; number of elements, a power of two */
    unsigned char *elements;
    alignas(CACHE_LINE) atomic_size_t written; /* elements written since creation */
    alignas(CACHE_LINE) atomic_size_t taken;   /* elements read since creation */
} spsc_ring;

/* `capacity` is rounded up to a power of two. */
trocar_status spsc_ring_create(spsc_ring *r, size_t size, size_t capacity, report *why);
void spsc_ring_free(spsc_ring *r);

/* Returns false, without effect, if the ring is full. Writer only. RT */
bool spsc_ring_push(spsc_ring *r, const void *element);
/* True if there is room for one more element. Writer only. RT */
bool spsc_ring_has_room(const spsc_ring *r);
/* Returns false if the ring is empty. Reader only. RT */
bool spsc_ring_pop(spsc_ring *r, void *element);

#endif
