/* A lock-free ring buffer that passes every value, in order, from one writer thread to one reader thread. Neither ever waits. Memory is allocated, zeroed and
   touched at creation. */
#ifndef TROCAR_SPSC_RING_H
#define TROCAR_SPSC_RING_H

#include <stdalign.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "base/cache_line.h"

typedef struct {
    size_t size, capacity;                     /* size: bytes per element; capacity: number of elements, a power of two */
    unsigned char *elements;
    alignas(CACHE_LINE) atomic_size_t written; /* number of elements written since creation */
    alignas(CACHE_LINE) atomic_size_t taken;   /* number of elements read since creation */
} spsc_ring;

/* Creates a ring; `capacity` is rounded up to a power of two. */
trocar_status spsc_ring_create(spsc_ring *r, size_t size, size_t capacity, trocar_error *why);
void spsc_ring_free(spsc_ring *r);

/* Appends an element. If the ring is full, does nothing and returns false. Writer only. RT */
bool spsc_ring_push(spsc_ring *r, const void *element);
/* True if there is room for one more element. Writer only. RT */
bool spsc_ring_has_room(const spsc_ring *r);
/* Removes the oldest element. Returns false if the ring is empty. Reader only. RT */
bool spsc_ring_pop(spsc_ring *r, void *element);

#endif
