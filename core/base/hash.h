/* A checksum that detects damaged data and mix-ups. It is not cryptographic, so it does not protect against tampering. */
#ifndef TROCAR_HASH_H
#define TROCAR_HASH_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

static const uint64_t HASH_BASIS = UINT64_C(0xcbf29ce484222325);

/* Adds these bytes to the hash `h` and returns the new hash; start with HASH_BASIS. A variant of FNV-1a that processes eight bytes at a time, and the
   remaining ones singly. RT */
static inline uint64_t hash_bytes(uint64_t h, const void *data, size_t bytes) {
    static const uint64_t PRIME = UINT64_C(0x100000001b3);
    const unsigned char *at = data;
    for (; bytes >= 8; bytes -= 8, at += 8) {
        uint64_t word;
        memcpy(&word, at, 8);
        h = (h ^ word) * PRIME;
        h ^= h >> 32;            /* mixes high bits into low bits, which multiplication alone does not do */
    }
    for (; bytes > 0; bytes--, at++) h = (h ^ *at) * PRIME;
    return h;
}

#endif
