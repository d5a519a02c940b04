#include "remesh/contact_surplus.h"

#include <string.h>

#include "remesh/refined_field.h"

static void forget_slot(contact_surplus *s, const refinement *refined, int slot) {
    s->coupled[slot] = 0;
    for (int i = 0; i < refined->count; i++) s->coupled[refined->order[i]] &= ~(UINT64_C(1) << slot);
}

static void add_block(contact_surplus *s, int slot, int other, double weight, const mat3 *block) {
    mat3 *sum = &s->blocks[surplus_place(slot, other)];
    if (!surplus_couples(s, slot, other)) *sum = (mat3){{{0}}};
    s->coupled[slot] |= UINT64_C(1) << other;
    s->coupled[other] |= UINT64_C(1) << slot;
    m3_add_scaled(sum, weight, block);
}

/* The node moves with its leaf's corners, some of which may be added nodes, too, */
static void follow_corners(contact_surplus *s, const refinement *refined, int slot) {
    const leaf_point *at = &refined->nodes[slot].at;
    for (int c = 0; c < 4; c++)
        for (int i = 0; i < refined->count && at->corners[c] < 0; i++) {
            int corner = -1 - at->corners[c], other = refined->order[i];
            if (surplus_couples(s, corner, other)) add_block(s, slot, other, at->weights[c], &s->blocks[surplus_place(corner, other)]);
        }
}

/* and they move with it. */
static void move_corners(contact_surplus *s, const refinement *refined, int slot) {
    const leaf_point *at = &refined->nodes[slot].at;
    for (int c = 0; c < 4; c++)
        if (at->corners[c] < 0) add_block(s, slot, slot, at->weights[c], &s->blocks[surplus_place(slot, -1 - at->corners[c])]);
}

void surplus_put(contact_surplus *s, int i, int j, const mat3 *block) {
    s->blocks[surplus_place(i, j)] = i >= j ? *block : m3_transposed(block);
    s->coupled[i] |= UINT64_C(1) << j;
    s->coupled[j] |= UINT64_C(1) << i;
}

void contact_surplus_add(contact_surplus *s, const tissue *t, const refinement *refined, int slot) {
    mat3 own = node_surplus(t, refined, refined->count);
    forget_slot(s, refined, slot);
    add_block(s, slot, slot, 1.0, &own);
    follow_corners(s, refined, slot);
    move_corners(s, refined, slot);
}

void contact_surplus_copy(const contact_surplus *from, int span, contact_surplus *to) {
    memcpy(to->coupled, from->coupled, sizeof to->coupled);
    memcpy(to->blocks, from->blocks, (size_t)surplus_place(span, 0) * sizeof *to->blocks);
}
