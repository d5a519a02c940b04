/* A lock-free triple buffer that passes the newest value from one writer thread to one reader thread. Neither ever waits. Memory is allocated and zeroed at
   creation. */
#ifndef TROCAR_TRIPLE_BUFFER_H
#define TROCAR_TRIPLE_BUFFER_H

#include <stdalign.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "base/cache_line.h"

/* To publish, the writer fills its slot and swaps it with the middle slot. To read, the reader swaps its slot with the middle slot if that holds a new value.
   Each slot belongs to one side at a time, so a value never changes while it is being read. */
typedef struct {
    size_t size;                               /* bytes per slot */
    unsigned char *slots;                      /* 3 slots */
    alignas(CACHE_LINE) atomic_uint middle;    /* index of the middle slot, with the bit FRESH set if it has not been read yet */
    alignas(CACHE_LINE) unsigned back;         /* writer's slot */
    alignas(CACHE_LINE) unsigned front;        /* reader's slot */
} triple_buffer;

/* triple_buffer_create touches all its memory, so that later accesses do not fault. triple_buffer_create_sparse does not, so pages never written to take up
   no memory. */
trocar_status triple_buffer_create(triple_buffer *n, size_t size, trocar_error *why);
trocar_status triple_buffer_create_sparse(triple_buffer *n, size_t size, trocar_error *why);
void triple_buffer_free(triple_buffer *n);

/* Returns the slot to fill next, which still contains an old value. Writer only. RT */
void *triple_buffer_slot(triple_buffer *n);
/* Publishes the filled slot. Writer only. RT */
void triple_buffer_publish(triple_buffer *n);
/* Returns the newest value, or zeros if nothing has been published yet; valid until the next call. Sets *fresh, unless `fresh` is NULL, to whether the value
   is new since the last call. Reader only. RT */
const void *triple_buffer_read(triple_buffer *n, bool *fresh);
/* True if there is an unread value. Reader only. RT */
bool triple_buffer_waits(triple_buffer *n);

#endif
