/* A cache of a resting needle's displacements per unit force on each piece of a held needle's shaft, as far as the mesh does not resolve them. With many
   needles, computing them for each response would take most of the worker's time, and pieces of a shaft seldom change except at the tip. To be freed when the
   resting needle or the moduli change. */
#ifndef TROCAR_UNRESOLVED_CACHE_H
#define TROCAR_UNRESOLVED_CACHE_H

#include "resting/resting_needle.h"

/* The cache for one resting and one held needle; to be initialised with zeros. */
typedef struct {
    int count;
    struct known_piece {
        shaft_piece piece;
        bool known;
        mat3 *lacks;         /* result of resting_lacks; NULL if the piece does not move the resting needle */
    } *pieces;               /* [count], in the order of the held needle's loads */
} unresolved_cache;

void unresolved_cache_free(unresolved_cache *c); /* leaves the cache empty, ready for use */

/* Sets *lacks to the result of resting_lacks for the held needle's piece `index`, or to NULL if the piece does not move the resting needle. Allocates. */
trocar_status unresolved_cache_find(unresolved_cache *c, needle_pairs *pairs, const resting_needle *r, int index, const shaft_piece *piece, const mat3 **lacks,
                                    trocar_error *why);

#endif
