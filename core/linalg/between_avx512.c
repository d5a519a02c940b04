/* The kernel of between_kernels.c, compiled for processors with AVX-512 (x86-64-v4; CMakeLists.txt). */
#include "linalg/between_kernels.h" /* an empty file would not be valid ISO C */

#ifdef __AVX512F__
#define BETWEEN_KERNEL between_avx512
#include "linalg/between_kernels.c"
#endif
