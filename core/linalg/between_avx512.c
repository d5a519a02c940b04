/* The kernel once more, for processors with AVX-512: compiled for x86-64-v4 (CMakeLists.txt). */
#include "linalg/between_kernels.h" /* ISO C has no empty files */

#ifdef __AVX512F__
#define BETWEEN_KERNEL between_avx512
#include "linalg/between_kernels.c"
#endif
