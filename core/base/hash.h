/* A checksum against damage and mix-ups; not secure against an attacker. */
#ifndef TROCAR_HASH_H
#define TROCAR_HASH_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

static const uint64_t HASH_BASIS = UINT64_C(0xcbf29ce484222325);

/* Continues the hash `h`, which begins as HASH_BASIS, with these bytes. Fowler-Noll-Vo hash (FNV-1a) over eight bytes at a time; the remaining bytes are
   hashed one by one. RT */
static inline uint64_t hash_bytes(uint64_t h, const void *data, size_t bytes) {
    static const uint64_t PRIME = UINT64_C(0x100000001b3);
    const unsigned char *at = data;
    for (; bytes >= 8; bytes -= 8, at += 8) {
        uint64_t word;
        memcpy(&word, at, 8);
        h = (h ^ word) * PRIME;
        h ^= h >> 32;            /* mixes high bits of a word into the low bits of the hash */
    }
    for (; bytes > 0; bytes--, at++) h = (h ^ *at) * PRIME;
    return h;
}

#endif
