/* The kernel of between_kernels.c, compiled for processors with AVX-512 (x86-64-v4; CMakeLists.txt). */
#include "linalg/between_kernels.h" /* ISO C forbids empty files */

#ifdef __AVX512F__
#define BETWEEN_KERNEL between_avx512
#include "linalg/between_kernels.c"
#endif
