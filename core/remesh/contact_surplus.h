/* What the mesh yields more because contact nodes were added, between them, m/N. Taken off the inverse, it leaves what the nominal mesh
   yields where they are. See README.md, "Local compliance". */
#ifndef TROCAR_CONTACT_SURPLUS_H
#define TROCAR_CONTACT_SURPLUS_H

#include "remesh/refinement.h"
#include "tissue/tissue.h"

typedef struct {
    uint64_t coupled[MAX_CONTACTS]; /* bit j of slot i: the block between them is not zero; bit i always */
    mat3 blocks[MAX_CONTACTS * (MAX_CONTACTS + 1) / 2]; /* between the higher slot and the lower one */
} contact_surplus;

/* Where the block between two slots is. RT */
static inline int surplus_place(int i, int j) { return i > j ? i * (i + 1) / 2 + j : j * (j + 1) / 2 + i; }

/* RT */
static inline bool surplus_couples(const contact_surplus *s, int i, int j) { return s->coupled[i] >> j & 1; }

/* Of two slots that are coupled. RT */
static inline mat3 surplus_between(const contact_surplus *s, int i, int j) {
    const mat3 *block = &s->blocks[surplus_place(i, j)];
    return i >= j ? *block : m3_transposed(block);
}

void surplus_put(contact_surplus *s, int i, int j, const mat3 *block);

/* For the node in `slot`, which comes next in the order, with those before it: all of them inside elements. Blocks are symmetric then. */
void contact_surplus_add(contact_surplus *s, const tissue *t, const refinement *refined, int slot);

/* The part in use, where `span` is one more than the highest slot in use. */
void contact_surplus_copy(const contact_surplus *from, int span, contact_surplus *to);

#endif
