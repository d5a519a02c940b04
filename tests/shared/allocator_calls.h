/* Counts the calls a thread makes to the C library's allocator, so that a test can show that a loop makes none. Because the counter replaces the allocator's
   functions, it is only linked into tests or preloaded into trocar-server (liballocator_calls.so), never installed. Under sanitizers, which bring their own
   allocator, the count stays 0. */
#ifndef TROCAR_ALLOCATOR_CALLS_H
#define TROCAR_ALLOCATOR_CALLS_H

#include <stdint.h>

#ifndef __has_feature /* gcc lacks __has_feature and defines __SANITIZE_* macros instead */
#define __has_feature(feature) 0
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__) || __has_feature(address_sanitizer)
#define ALLOCATIONS_ARE_COUNTED 0
#else
#define ALLOCATIONS_ARE_COUNTED 1
#endif

/* Returns how many allocations, reallocations and frees the calling thread has made since it started. RT */
int64_t allocator_calls(void);

#endif
