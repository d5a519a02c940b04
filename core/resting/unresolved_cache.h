/* Keeps, from one response to the next, how a resting needle moves under forces on a held needle's shaft beyond what the mesh resolves: among many needles,
   computing it would take most of the worker's time, and a shaft's pieces seldom change except at the tip. It is valid for one resting needle and as long as
   the moduli stay the same. */
#ifndef TROCAR_UNRESOLVED_CACHE_H
#define TROCAR_UNRESOLVED_CACHE_H

#include "resting/resting_needle.h"

/* Of one resting and one held needle; all zero at first. */
typedef struct {
    int count;
    struct known_piece {
        shaft_piece piece;
        bool known;
        mat3 *lacks;         /* as resting_lacks computes it; NULL if the piece does not move the resting needle */
    } *pieces;               /* [count], in the order of the held needle's loads */
} unresolved_cache;

void unresolved_cache_free(unresolved_cache *c); /* leaves it as it was at first */

/* Returns resting_lacks of the held needle's piece number `index` in *lacks, or NULL if the piece does not move the resting needle. Allocates. */
trocar_status unresolved_cache_find(unresolved_cache *c, needle_pairs *pairs, const resting_needle *r, int index, const shaft_piece *piece, const mat3 **lacks,
                                    trocar_error *why);

#endif
