/* Caches how far a resting needle is displaced per unit force on each piece of a held needle's shaft, counting only what the mesh does not resolve. With many
   needles, recomputing this for each response would take most of the worker's time, although the pieces of a shaft seldom change except at the tip. Free the
   cache when the resting needle or the moduli change. */
#ifndef TROCAR_UNRESOLVED_CACHE_H
#define TROCAR_UNRESOLVED_CACHE_H

#include "resting/resting_needle.h"

/* The cache for one resting and one held needle. Initialise with zeros. */
typedef struct {
    int count;
    struct known_piece {
        shaft_piece piece;
        bool known;
        mat3 *lacks;         /* from resting_lacks; NULL if the piece does not displace the resting needle */
    } *pieces;               /* [count], in the order of the held needle's loads */
} unresolved_cache;

void unresolved_cache_free(unresolved_cache *c); /* leaves an empty, usable cache */

/* Sets *lacks to what resting_lacks returns for piece `index` of the held needle, or to NULL if the piece does not displace the resting needle. Allocates. */
trocar_status unresolved_cache_find(unresolved_cache *c, needle_pairs *pairs, const resting_needle *r, int index, const shaft_piece *piece, const mat3 **lacks,
                                    trocar_error *why);

#endif
