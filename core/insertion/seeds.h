/* Brachytherapy seeds: material points of the tissue that a needle has left there. Plain data. See docs/mechanics.md, "Seeds". */
#ifndef TROCAR_SEEDS_H
#define TROCAR_SEEDS_H

#include <string.h>

#include "insertion/state/insertion_model.h"
#include "insertion/state/insertion_state.h"
#include "snapshot/snapshot.h"

enum { MAX_SEEDS = 256, MAX_STRAND = 16 };

typedef struct {
    double length, diameter;     /* m */
    double spacing;              /* m, between the centres of neighbouring seeds of a strand */
} seed_size;

/* A seed in the tissue, or the place where one will be left. */
typedef struct {
    int tet;                     /* nominal element of its centre, */
    double weights[4];           /* and barycentric weights of its centre in that */
    vec3 at;                     /* m, nominal: its centre */
    vec3 direction;              /* unit vector from its proximal end to its distal one, in the undeformed tissue */
    int needle;                  /* that left it, */
    int guide, hole;             /* which was in this hole of this guide; NO_HOLE: in none */
    int strand;                  /* number in its strand, 0: the distal one */
} seed;

/* The seeds of one drop: those from `placed` on are still in the needle. */
typedef struct {
    int count, placed;
    seed seeds[MAX_STRAND];      /* from the distal one on */
    double uncovered[MAX_STRAND]; /* m, depth of the tip at which each is left: that of its proximal end */
} seed_drop;

/* All seeds of a simulation: they stay when needles are reset or gone. */
typedef struct {
    int count;
    seed seeds[MAX_SEEDS];       /* in the order in which they were placed */
    seed_drop drops[MAX_NEEDLES]; /* of each needle, the last one */
} seed_list;

/* Only those in use: there is room for many. RT */
static inline void seeds_copy(const seed_list *from, int needle_count, seed_list *to) {
    to->count = from->count;
    memcpy(to->seeds, from->seeds, (size_t)from->count * sizeof *from->seeds);
    memcpy(to->drops, from->drops, (size_t)needle_count * sizeof *from->drops);
}

/* Why a seed cannot be dropped, or taken back. */
typedef enum {
    SEEDS_ACCEPTED, SEEDS_BAD_COUNT, SEEDS_BAD_SPACING, SEEDS_TOO_THICK, SEEDS_PENDING, SEEDS_FULL, SEEDS_OUTSIDE, SEEDS_TOO_LONG, SEEDS_NONE
} seed_refusal;

/* The tip marks the distal end of the first of `count` seeds, `spacing` apart (m; 0: the scene's). Each is left in the tissue when the needle
   has been drawn back over its length. RT */
seed_refusal seeds_drop(const insertion_model *model, const seed_size *size, const insertion_state *state, int needle, int count, double spacing, seed_list *list);

/* m, length of such a strand from end to end. RT */
double seeds_strand_length(const seed_size *size, int count, double spacing);

/* Leaves in the tissue what the needle has been drawn back over. After each of its ticks. RT */
void seeds_follow(const insertion_state *state, int needle, seed_list *list);

/* The needle keeps the seeds that it has not been drawn back over. RT */
void seeds_keep(int needle, seed_list *list);

/* Seeds of the last drop that are still in the needle. RT */
static inline int seeds_pending(int needle, const seed_list *list) { return list->drops[needle].count - list->drops[needle].placed; }

/* Takes back what is pending of the needle's last drop; if nothing is, the seed that it placed last. RT */
seed_refusal seeds_undo(int needle, seed_list *list);

/* m and unit vector: centre and direction in the tissue displaced by `displacement` (node_count, m). RT */
void seed_displaced(const mesh *m, const seed *s, const vec3 *displacement, vec3 *at, vec3 *direction);

#endif
