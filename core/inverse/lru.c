#include "inverse/lru.h"

#include <stdlib.h>

bool lru_create(lru *c, size_t key_count, size_t slot_count) {
    *c = (lru){.slot_count = (int)slot_count,
               .slot = malloc(key_count * sizeof *c->slot),
               .key = malloc(slot_count * sizeof *c->key),
               .used = calloc(slot_count, sizeof *c->used)};
    if (!c->slot || !c->key || !c->used) return false;
    for (size_t i = 0; i < key_count; i++) c->slot[i] = -1;
    for (size_t i = 0; i < slot_count; i++) c->key[i] = -1;
    return true;
}

void lru_free(lru *c) {
    free(c->slot);
    free(c->key);
    free(c->used);
}

bool lru_touch(lru *c, int key) {
    if (c->slot[key] < 0) return false;
    c->used[c->slot[key]] = ++c->time;
    return true;
}

int lru_claim(lru *c, int key) {
    int oldest = 0;
    for (int i = 1; i < c->slot_count; i++)
        if (c->used[i] < c->used[oldest]) oldest = i;
    if (c->key[oldest] >= 0) c->slot[c->key[oldest]] = -1;
    c->key[oldest] = key;
    c->slot[key] = oldest;
    c->used[oldest] = ++c->time;
    return oldest;
}
