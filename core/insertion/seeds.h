/* Brachytherapy seeds: the points of the tissue where a needle has deposited one. Plain data. See docs/mechanics.md, "Seeds". */
#ifndef TROCAR_SEEDS_H
#define TROCAR_SEEDS_H

#include <string.h>

#include "insertion/model/insertion_model.h"
#include "insertion/state/insertion_state.h"
#include "snapshot/snapshot.h"

enum { MAX_SEEDS = 256, MAX_STRAND = 16 };

typedef struct {
    double length, diameter;     /* m */
    double spacing;              /* m, centre-to-centre spacing of the seeds in a strand */
} seed_size;

/* A seed in the tissue, or the planned place of a seed that is still in the needle. */
typedef struct {
    int tet;                     /* nominal element that contains its centre */
    double weights[4];           /* barycentric weights of its centre in this element */
    vec3 at;                     /* m, nominal position of its centre */
    vec3 direction;              /* unit vector from its proximal to its distal end, in the undeformed tissue */
    int needle;                  /* index of the needle that deposited it */
    int guide, hole;             /* guide and hole that the needle was in, or NO_HOLE */
    int strand;                  /* number of the seed in its strand, counted from 0 at the distal end */
} seed;

/* The seeds of one drop. Those from index `placed` on are still in the needle. */
typedef struct {
    int count, placed;
    seed seeds[MAX_STRAND];      /* seeds, distal one first */
    double uncovered[MAX_STRAND]; /* m, depth of the tip at which each seed leaves the needle, which is the depth of its proximal end */
} seed_drop;

/* All seeds in a simulation. They stay in the tissue when needles are reset or removed. */
typedef struct {
    int count;
    seed seeds[MAX_SEEDS];       /* seeds in the order in which they were placed */
    seed_drop drops[MAX_NEEDLES]; /* each needle's most recent drop */
} seed_list;

/* Copies only the entries in use, because the arrays are large. RT */
static inline void seeds_copy(const seed_list *from, int needle_count, seed_list *to) {
    to->count = from->count;
    memcpy(to->seeds, from->seeds, (size_t)from->count * sizeof *from->seeds);
    memcpy(to->drops, from->drops, (size_t)needle_count * sizeof *from->drops);
}

/* Reasons why seeds cannot be dropped or taken back. */
typedef enum {
    SEEDS_ACCEPTED, SEEDS_BAD_COUNT, SEEDS_BAD_SPACING, SEEDS_TOO_THICK, SEEDS_PENDING, SEEDS_FULL, SEEDS_OUTSIDE, SEEDS_TOO_LONG, SEEDS_NONE
} seed_refusal;

/* Drops `count` seeds with this spacing (m; 0 selects the scene's). The distal end of the first seed is at the tip. A seed leaves the needle once the needle
   has been drawn back over the seed's length. RT */
seed_refusal seeds_drop(const insertion_model *model, const seed_size *size, const insertion_state *state, int needle, int count, double spacing, seed_list *list);

/* Returns the length (m) of a strand of `count` seeds from end to end. RT */
double seeds_strand_length(const seed_size *size, int count, double spacing);

/* Deposits the seeds that the needle has been drawn back over. Call this after each of the needle's ticks. RT */
void seeds_follow(const insertion_state *state, int needle, seed_list *list);

/* Cancels the rest of the drop: seeds that the needle has not been drawn back over stay in it. RT */
void seeds_keep(int needle, seed_list *list);

/* Returns how many seeds of the needle's last drop are still in it. RT */
static inline int seeds_pending(int needle, const seed_list *list) { return list->drops[needle].count - list->drops[needle].placed; }

/* Cancels the seeds of the needle's last drop that are still in it. If there are none, removes the seed it deposited last. RT */
seed_refusal seeds_undo(int needle, seed_list *list);

/* Removes all seeds that the needle has deposited, and cancels the rest of its drop. RT */
void seeds_clear(int needle, seed_list *list);

/* Computes the centre (m) and direction (unit vector) of a seed when the tissue's nodes are displaced by `displacement` (node_count, m). RT */
void seed_displaced(const mesh *m, const seed *s, const vec3 *displacement, vec3 *at, vec3 *direction);

#endif
