/* Allocates large zeroed arrays of which only parts are used: a page takes up physical memory only once it is written to. calloc() does not guarantee this,
   because it clears memory that it reuses. */
#ifndef TROCAR_SPARSE_MEMORY_H
#define TROCAR_SPARSE_MEMORY_H

#include <stddef.h>
#include <sys/mman.h>

/* Returns zeroed, page-aligned memory, or NULL if out of memory. Release it with sparse_free() and the same size. */
static inline void *sparse_zeros(size_t bytes) {
    void *memory = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    return memory == MAP_FAILED ? NULL : memory;
}

/* `memory` may be NULL. */
static inline void sparse_free(void *memory, size_t bytes) {
    if (memory) munmap(memory, bytes);
}

#endif
