/* Handing data from one thread to another without a lock: the newest value (three slots), or every value in order (a
   ring). One writer, one reader each; neither ever waits. Memory is allocated, touched and zero at creation. */
#ifndef TROCAR_HANDOVER_H
#define TROCAR_HANDOVER_H

#include <stdalign.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "report.h"

enum { CACHE_LINE = 64 };

/* Newest value wins. The writer fills its slot and swaps it with the middle one; the reader swaps the middle one with
   its own if it is fresh. A slot belongs to exactly one side at any time, so that what is read never changes. */
typedef struct {
    size_t size;                               /* bytes of a slot */
    unsigned char *slots;                      /* 3 slots */
    alignas(CACHE_LINE) atomic_uint middle;    /* index of the slot in between, | FRESH when not read yet */
    alignas(CACHE_LINE) unsigned back;         /* writer's slot */
    alignas(CACHE_LINE) unsigned front;        /* reader's slot */
} newest_value;

trocar_status newest_create(newest_value *n, size_t size, report *why);
void newest_free(newest_value *n);

/* The slot to fill next; holds an older value until then. Writer only. RT */
void *newest_slot(newest_value *n);
/* Hands over what the slot holds. Writer only. RT */
void newest_publish(newest_value *n);
/* The newest value, valid until the next call; all zero before the first. `fresh` (may be NULL) tells whether it is
   new since the last call. Reader only. RT */
const void *newest_read(newest_value *n, bool *fresh);

/* Every value in order. */
typedef struct {
    size_t size, capacity;                     /* bytes of an element; number of elements, a power of two */
    unsigned char *elements;
    alignas(CACHE_LINE) atomic_size_t written; /* by the writer, ever */
    alignas(CACHE_LINE) atomic_size_t taken;   /* by the reader, ever */
} spsc_ring;

/* `capacity` is rounded up to a power of two. */
trocar_status ring_create(spsc_ring *r, size_t size, size_t capacity, report *why);
void ring_free(spsc_ring *r);

/* False, and nothing changed, when the ring is full. Writer only. RT */
bool ring_push(spsc_ring *r, const void *element);
/* False when the ring is empty. Reader only. RT */
bool ring_pop(spsc_ring *r, void *element);

#endif
