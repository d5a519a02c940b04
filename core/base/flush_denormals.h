/* Denormals count as zero while the mechanics compute, in every thread alike: some processors take a hundred times longer for
   them, and results would depend on the mode that the host happens to run in. */
#ifndef TROCAR_FLUSH_DENORMALS_H
#define TROCAR_FLUSH_DENORMALS_H

#include <stdint.h>
#if defined(__SSE2__)
#include <immintrin.h>
#endif

typedef uint64_t floating_mode;

/* Returns the mode to go back to. RT */
static inline floating_mode flush_denormals(void) {
    floating_mode before = 0;
#if defined(__SSE2__)
    enum { FLUSH_TO_ZERO = 0x8000, DENORMALS_ARE_ZERO = 0x0040 };
    before = _mm_getcsr();
    _mm_setcsr((unsigned)before | FLUSH_TO_ZERO | DENORMALS_ARE_ZERO);
#elif defined(__aarch64__)
    __asm__ volatile("mrs %0, fpcr" : "=r"(before));
    __asm__ volatile("msr fpcr, %0" : : "r"(before | (1u << 24)));
#endif
    return before;
}

/* RT */
static inline void restore_floating_mode(floating_mode before) {
#if defined(__SSE2__)
    _mm_setcsr((unsigned)before);
#elif defined(__aarch64__)
    __asm__ volatile("msr fpcr, %0" : : "r"(before));
#else
    (void)before;
#endif
}

#endif
