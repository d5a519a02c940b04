/* Flushes denormals to zero while the simulation computes. On some processors, arithmetic with denormals is a hundred times slower; and results must not
   depend on the host program's floating-point mode. */
#ifndef TROCAR_FLUSH_DENORMALS_H
#define TROCAR_FLUSH_DENORMALS_H

#include <stdint.h>
#if defined(__SSE2__)
#include <immintrin.h>
#endif

typedef uint64_t floating_mode;

/* Turns flushing on in the calling thread. Returns the previous mode, for restore_floating_mode. RT */
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
