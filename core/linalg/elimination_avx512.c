/* The kernel once more, for processors with AVX-512: compiled for x86-64-v4 (CMakeLists.txt). */
#include "linalg/elimination.h" /* ISO C has no empty files */

#ifdef __AVX512F__
#define ELIMINATION_KERNEL elimination_avx512
#include "linalg/elimination_kernels.c"
#endif
