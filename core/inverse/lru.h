/* Assigns a limited number of slots to keys; a new key gets the least recently used slot. */
#ifndef TROCAR_LRU_H
#define TROCAR_LRU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    int slot_count;
    int *slot;               /* slot of each key, or -1 */
    int *key;                /* key in each slot, or -1 */
    uint64_t *used;          /* [slot_count]: time of last use */
    uint64_t time;
} lru;

bool lru_create(lru *c, size_t key_count, size_t slot_count); /* returns false if out of memory; call lru_free in either case */
void lru_free(lru *c);

/* Marks a key as most recently used. Returns false if it has no slot. */
bool lru_touch(lru *c, int key);

/* Assigns the least recently used slot to a key without a slot, and returns the slot. */
int lru_claim(lru *c, int key);

#endif
