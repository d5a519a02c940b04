#include "allocator_calls.h"

#include <errno.h>
#include <stddef.h>

/* With the initial-exec TLS model, accessing the variable never allocates, not even in a shared library. */
static _Thread_local int64_t calls __attribute__((tls_model("initial-exec")));

int64_t allocator_calls(void) { return calls; }

#if ALLOCATIONS_ARE_COUNTED
/* These functions replace the C library's in the whole process, shared libraries included. */
void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *__libc_realloc(void *, size_t);
void *__libc_memalign(size_t, size_t);
void __libc_free(void *);

void *malloc(size_t size) { return calls++, __libc_malloc(size); }
void *calloc(size_t count, size_t size) { return calls++, __libc_calloc(count, size); }
void *realloc(void *p, size_t size) { return calls++, __libc_realloc(p, size); }
void *memalign(size_t alignment, size_t size) { return calls++, __libc_memalign(alignment, size); }
void *aligned_alloc(size_t alignment, size_t size) { return memalign(alignment, size); }
int posix_memalign(void **p, size_t alignment, size_t size) {
    *p = memalign(alignment, size);
    return *p == NULL ? ENOMEM : 0;
}
void free(void *p) { calls++, __libc_free(p); }
#endif
