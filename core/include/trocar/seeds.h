/* Brachytherapy seeds: markers that needles deposit in the tissue. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_SEEDS_H
#define TROCAR_PUBLIC_SEEDS_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TROCAR_MAX_SEEDS = 256, TROCAR_MAX_STRAND = 16 };

/* A seed: a material point of the tissue with a direction. Seeds neither stiffen the tissue nor are dragged along by needles. */
typedef struct trocar_seed {
    double position[3];      /* m, centre of the seed in the tissue at rest */
    double direction[3];     /* unit vector from the seed's proximal to its distal end, in the tissue at rest */
    double weights[4];       /* barycentric coordinates of its centre in the tetrahedron `tet` */
    int32_t tet;             /* tetrahedron of the model's mesh */
    int32_t needle;          /* index of the needle that deposited the seed */
    int32_t guide, hole;     /* the guide and hole (column + columns * row) that the needle passed through; -1 if none */
    int32_t strand;          /* position of the seed in its strand; 0 is the distal seed */
    int32_t reserved;        /* 0 */
} trocar_seed;

/* Seed dimensions in m, from the scene's "seeds." keys. */
typedef struct trocar_seed_size {
    double length, diameter;
    double spacing;          /* centre-to-centre spacing of the seeds in a strand */
} trocar_seed_size;
TROCAR_API trocar_seed_size trocar_model_seed_size(const trocar_model *model); /* [any, RT] */

/* Drops `count` (1 to TROCAR_MAX_STRAND) seeds with `spacing` (m) between their centres; 0 selects the scene's spacing. The first seed's distal end is at
   the tip. Each seed is deposited on the needle's track once the tip has been withdrawn past the seed's proximal end. BAD_INPUT, changing nothing, if the
   count or spacing is invalid, if earlier seeds of this needle are still pending, if the tip is outside the tissue or not deep enough, if the needle is
   resting, or if there is no room for more seeds. [tick, RT] */
TROCAR_API trocar_status trocar_sim_drop_seeds(trocar_sim *sim, int needle, int count, double spacing, trocar_error *error);

/* Cancels the needle's pending seeds or, if there are none, removes the seed that it deposited last. BAD_INPUT if there is nothing to undo, or if `needle`
   is out of range. [tick, RT] */
TROCAR_API trocar_status trocar_sim_undo_seed(trocar_sim *sim, int needle, trocar_error *error);

/* Removes all seeds that the needle has deposited, and cancels its pending ones. BAD_INPUT if `needle` is out of range. [tick, RT] */
TROCAR_API trocar_status trocar_sim_clear_seeds(trocar_sim *sim, int needle, trocar_error *error);

/* Computes the centre (m) and direction of a seed in displaced tissue. `displacements` come from trocar_view_displacements. Returns 1, or 0 if the seed's
   `tet` is not a tetrahedron of the model. [any, RT] */
TROCAR_API int trocar_model_displace_seed(const trocar_model *model, const double *displacements, const trocar_seed *seed, double position[3],
                                          double direction[3]);

#ifdef __cplusplus
}
#endif
#endif
