/* The kernel of elimination_kernels.c, compiled for processors with AVX-512 (x86-64-v4; CMakeLists.txt). */
#include "linalg/elimination.h" /* an empty file would not be valid ISO C */

#ifdef __AVX512F__
#define ELIMINATION_KERNEL elimination_avx512
#include "linalg/elimination_kernels.c"
#endif
