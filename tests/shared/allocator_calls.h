/* Counts the calls that the calling thread makes to the C library's allocator, so that a test can show that a loop makes none. The counter replaces the allocator's
   functions, so it is linked into tests, or preloaded into trocar-server (liballocator_calls.so), but is part of no installed program. In a build with
   sanitizers, which bring their own allocator, the count stays 0. */
#ifndef TROCAR_ALLOCATOR_CALLS_H
#define TROCAR_ALLOCATOR_CALLS_H

#include <stdint.h>

#ifndef __has_feature /* gcc has no __has_feature; it defines __SANITIZE_* macros instead */
#define __has_feature(feature) 0
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__) || __has_feature(address_sanitizer)
#define ALLOCATIONS_ARE_COUNTED 0
#else
#define ALLOCATIONS_ARE_COUNTED 1
#endif

/* Number of allocations, reallocations and frees by the calling thread since it started. RT */
int64_t allocator_calls(void);

#endif
