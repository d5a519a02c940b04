/* The kernel once more, for processors with AVX-512: compiled for x86-64-v4 (CMakeLists.txt). */
#include "insertion/elimination.h" /* ISO C has no empty files */

#ifdef __AVX512F__
#define ELIMINATION_KERNEL elimination_avx512
#include "insertion/elimination_kernels.c"
#endif
