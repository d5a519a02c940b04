/* Requests large pages for arrays that are traversed as a whole. With 4 KB pages, a pass over such an array takes a third longer, and page faults add as much
   again. */
#ifndef TROCAR_LARGE_PAGES_H
#define TROCAR_LARGE_PAGES_H

#include <stdint.h>
#include <sys/mman.h>
#include <unistd.h>

/* Calls madvise() on the array. Pass MADV_HUGEPAGE after allocating it, and MADV_NOHUGEPAGE before freeing it, because the heap may reuse its pages for other
   data. Failures are ignored; arrays under 4 MB are skipped. */
static inline void advise_pages(const void *array, size_t bytes, int advice) {
    static const size_t LEAST = (size_t)1 << 22;
    uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE);
    uintptr_t from = ((uintptr_t)array + page - 1) / page * page, end = ((uintptr_t)array + bytes) / page * page;
    if (array && bytes >= LEAST) madvise((void *)from, end - from, advice);
}

#endif
