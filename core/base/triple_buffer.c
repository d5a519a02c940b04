#include "base/triple_buffer.h"

#include "base/sparse_memory.h"

enum { FRESH = 4u, INDEX = 3u };

trocar_status triple_buffer_create_sparse(triple_buffer *n, size_t size, trocar_error *why) {
    n->size = (size + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
    n->back = 0;
    n->front = 1;
    atomic_init(&n->middle, 2u);
    n->slots = sparse_zeros(3 * n->size);
    if (!n->slots) return fail(why, TROCAR_NO_MEMORY, "cannot allocate %zu bytes of memory shared by two threads", 3 * n->size);
    return TROCAR_OK;
}

trocar_status triple_buffer_create(triple_buffer *n, size_t size, trocar_error *why) {
    trocar_status status = triple_buffer_create_sparse(n, size, why);
    if (status == TROCAR_OK) memset(n->slots, 0, 3 * n->size);
    return status;
}

void triple_buffer_free(triple_buffer *n) {
    sparse_free(n->slots, 3 * n->size);
    n->slots = NULL;
}

void *triple_buffer_slot(triple_buffer *n) { return n->slots + n->back * n->size; }

void triple_buffer_publish(triple_buffer *n) {
    /* release: the value is written before the swap. acquire: the reader is done with the slot that comes back */
    n->back = atomic_exchange_explicit(&n->middle, n->back | FRESH, memory_order_acq_rel) & INDEX;
}

bool triple_buffer_waits(triple_buffer *n) { return atomic_load_explicit(&n->middle, memory_order_relaxed) & FRESH; }

const void *triple_buffer_read(triple_buffer *n, bool *fresh) {
    bool waiting = triple_buffer_waits(n);
    if (waiting) n->front = atomic_exchange_explicit(&n->middle, n->front, memory_order_acq_rel) & INDEX;
    if (fresh != NULL) *fresh = waiting;
    return n->slots + n->front * n->size;
}
