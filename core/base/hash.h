/* A checksum that detects damage and mix-ups. It does not protect against deliberate changes. */
#ifndef TROCAR_HASH_H
#define TROCAR_HASH_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

static const uint64_t HASH_BASIS = UINT64_C(0xcbf29ce484222325);

/* Continues the hash `h` with these bytes and returns the result; start with HASH_BASIS. A variant of the Fowler-Noll-Vo hash (FNV-1a) that processes eight
   bytes at a time, and the remaining bytes one by one. RT */
static inline uint64_t hash_bytes(uint64_t h, const void *data, size_t bytes) {
    static const uint64_t PRIME = UINT64_C(0x100000001b3);
    const unsigned char *at = data;
    for (; bytes >= 8; bytes -= 8, at += 8) {
        uint64_t word;
        memcpy(&word, at, 8);
        h = (h ^ word) * PRIME;
        h ^= h >> 32;            /* mixes the high bits into the low bits, which multiplication alone does not do */
    }
    for (; bytes > 0; bytes--, at++) h = (h ^ *at) * PRIME;
    return h;
}

#endif
