#include "base/spsc_ring.h"

trocar_status spsc_ring_create(spsc_ring *r, size_t size, size_t capacity, trocar_error *why) {
    r->size = size;
    r->capacity = 1;
    while (r->capacity < capacity) r->capacity *= 2;
    atomic_init(&r->written, 0);
    atomic_init(&r->taken, 0);
    return allocate_shared(r->size * r->capacity, &r->elements, why);
}

void spsc_ring_free(spsc_ring *r) {
    free(r->elements);
    r->elements = NULL;
}

static unsigned char *element_at(const spsc_ring *r, size_t count) {
    return r->elements + (count & (r->capacity - 1)) * r->size;
}

bool spsc_ring_has_room(const spsc_ring *r) {
    size_t taken = atomic_load_explicit(&r->taken, memory_order_acquire); /* acquire: the reader is done with the element that push will overwrite */
    return atomic_load_explicit(&r->written, memory_order_relaxed) - taken < r->capacity;
}

bool spsc_ring_push(spsc_ring *r, const void *element) {
    if (!spsc_ring_has_room(r)) return false;
    size_t written = atomic_load_explicit(&r->written, memory_order_relaxed);
    memcpy(element_at(r, written), element, r->size);
    atomic_store_explicit(&r->written, written + 1, memory_order_release);
    return true;
}

bool spsc_ring_pop(spsc_ring *r, void *element) {
    size_t taken = atomic_load_explicit(&r->taken, memory_order_relaxed);
    size_t written = atomic_load_explicit(&r->written, memory_order_acquire);
    if (written == taken) return false;
    memcpy(element, element_at(r, taken), r->size);
    atomic_store_explicit(&r->taken, taken + 1, memory_order_release);
    return true;
}
