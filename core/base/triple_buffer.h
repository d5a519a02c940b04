/* The newest value of one thread for another, without a lock: three slots. One writer, one reader; neither ever waits. Memory is
   allocated, touched and zero at creation. */
#ifndef TROCAR_TRIPLE_BUFFER_H
#define TROCAR_TRIPLE_BUFFER_H

#include <stdalign.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "base/cache_line.h"

/* Newest value wins. The writer fills its slot and swaps it with the middle one; the reader swaps the middle one with
   its own if it is fresh. A slot belongs to exactly one side at any time, so that what is read never changes. */
typedef struct {
    size_t size;                               /* bytes of a slot */
    unsigned char *slots;                      /* 3 slots */
    alignas(CACHE_LINE) atomic_uint middle;    /* index of the slot in between, | FRESH when not read yet */
    alignas(CACHE_LINE) unsigned back;         /* writer's slot */
    alignas(CACHE_LINE) unsigned front;        /* reader's slot */
} triple_buffer;

trocar_status triple_buffer_create(triple_buffer *n, size_t size, report *why);
void triple_buffer_free(triple_buffer *n);

/* The slot to fill next; holds an older value until then. Writer only. RT */
void *triple_buffer_slot(triple_buffer *n);
/* Hands over what the slot holds. Writer only. RT */
void triple_buffer_publish(triple_buffer *n);
/* The newest value, valid until the next call; all zero before the first. `fresh` (may be NULL) tells whether it is
   new since the last call. Reader only. RT */
const void *triple_buffer_read(triple_buffer *n, bool *fresh);

#endif
