#include "handover.h"

#include <stdlib.h>
#include <string.h>

enum { FRESH = 4u, INDEX = 3u };

/* Zeroed and touched, so that no page faults later. */
static trocar_status allocate(size_t bytes, unsigned char **memory, report *why) {
    size_t rounded = (bytes + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    *memory = aligned_alloc(CACHE_LINE, rounded);
    if (*memory == NULL) return fail(why, TROCAR_NO_MEMORY, "cannot allocate %zu bytes for a hand-over buffer", rounded);
    memset(*memory, 0, rounded);
    return TROCAR_OK;
}

trocar_status newest_create(newest_value *n, size_t size, report *why) {
    n->size = (size + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    n->back = 0;
    n->front = 1;
    atomic_init(&n->middle, 2u);
    return allocate(3 * n->size, &n->slots, why);
}

void newest_free(newest_value *n) {
    free(n->slots);
    n->slots = NULL;
}

void *newest_slot(newest_value *n) { return n->slots + n->back * n->size; }

void newest_publish(newest_value *n) {
    /* Release: the value before the swap; acquire: the reader is done with the slot that comes back. */
    n->back = atomic_exchange_explicit(&n->middle, n->back | FRESH, memory_order_acq_rel) & INDEX;
}

const void *newest_read(newest_value *n, bool *fresh) {
    bool waiting = atomic_load_explicit(&n->middle, memory_order_relaxed) & FRESH;
    if (waiting) n->front = atomic_exchange_explicit(&n->middle, n->front, memory_order_acq_rel) & INDEX;
    if (fresh != NULL) *fresh = waiting;
    return n->slots + n->front * n->size;
}

trocar_status ring_create(spsc_ring *r, size_t size, size_t capacity, report *why) {
    r->size = size;
    r->capacity = 1;
    while (r->capacity < capacity) r->capacity *= 2;
    atomic_init(&r->written, 0);
    atomic_init(&r->taken, 0);
    return allocate(r->size * r->capacity, &r->elements, why);
}

void ring_free(spsc_ring *r) {
    free(r->elements);
    r->elements = NULL;
}

static unsigned char *element_at(const spsc_ring *r, size_t count) {
    return r->elements + (count & (r->capacity - 1)) * r->size;
}

bool ring_push(spsc_ring *r, const void *element) {
    size_t written = atomic_load_explicit(&r->written, memory_order_relaxed);
    size_t taken = atomic_load_explicit(&r->taken, memory_order_acquire); /* the reader has copied what we overwrite */
    if (written - taken == r->capacity) return false;
    memcpy(element_at(r, written), element, r->size);
    atomic_store_explicit(&r->written, written + 1, memory_order_release);
    return true;
}

bool ring_pop(spsc_ring *r, void *element) {
    size_t taken = atomic_load_explicit(&r->taken, memory_order_relaxed);
    size_t written = atomic_load_explicit(&r->written, memory_order_acquire);
    if (written == taken) return false;
    memcpy(element, element_at(r, taken), r->size);
    atomic_store_explicit(&r->taken, taken + 1, memory_order_release);
    return true;
}
