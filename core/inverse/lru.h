/* Which of many keys have one of a few slots; a new key takes the slot that was used least recently. */
#ifndef TROCAR_LRU_H
#define TROCAR_LRU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    int slot_count;
    int *slot;               /* of each key, or -1 */
    int *key;                /* in each slot, or -1 */
    uint64_t *used;          /* slot_count: time of last use */
    uint64_t time;
} lru;

bool lru_create(lru *c, size_t key_count, size_t slot_count); /* false without memory; free it then, too */
void lru_free(lru *c);

/* Marks a key as the one used last; false if it has no slot. */
bool lru_touch(lru *c, int key);

/* Gives a key that has no slot the one used least recently, and returns it. */
int lru_claim(lru *c, int key);

#endif
