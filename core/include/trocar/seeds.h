/* Brachytherapy seeds: markers that needles leave in the tissue. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_SEEDS_H
#define TROCAR_PUBLIC_SEEDS_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TROCAR_MAX_SEEDS = 256, TROCAR_MAX_STRAND = 16 };

/* A seed: a material point of the tissue with a direction. It neither stiffens the tissue nor is dragged along by needles. */
typedef struct trocar_seed {
    double position[3];      /* m, its centre in the tissue at rest */
    double direction[3];     /* unit vector from its proximal to its distal end, in the tissue at rest */
    double weights[4];       /* barycentric, of its centre in the tetrahedron `tet` */
    int32_t tet;             /* of the model's mesh */
    int32_t needle;          /* that left it */
    int32_t guide, hole;     /* the needle was in this hole, column + columns * row, of this guide; -1: in none */
    int32_t strand;          /* number in its strand, 0: the distal one */
    int32_t reserved;        /* 0 */
} trocar_seed;

/* The scene's keys "seeds.", m. */
typedef struct trocar_seed_size {
    double length, diameter;
    double spacing;          /* between the centres of neighbouring seeds of a strand */
} trocar_seed_size;
TROCAR_API trocar_seed_size trocar_model_seed_size(const trocar_model *model); /* [any, RT] */

/* Drops `count` seeds, 1 to TROCAR_MAX_STRAND, `spacing` m apart from centre to centre (0: the scene's), the first with its distal end at the tip. Each
   is left on the needle's track once the tip has been drawn back past its proximal end. BAD_INPUT, without effect, if it cannot be: a bad count or
   spacing, seeds pending, the tip outside the tissue or not deep enough, no room. [tick, RT] */
TROCAR_API trocar_status trocar_sim_drop_seeds(trocar_sim *sim, int needle, int count, double spacing, trocar_error *error);

/* Takes back the pending seeds of the needle's last drop, or, if there are none, removes the seed that it left last. BAD_INPUT if there is none, and if
   the needle is out of range. [tick, RT] */
TROCAR_API trocar_status trocar_sim_undo_seed(trocar_sim *sim, int needle, trocar_error *error);

/* Centre (m) and direction of a seed in displaced tissue; `displacements` as from trocar_view_displacements. Returns 1, or 0 if the seed is in no
   tetrahedron of the model. [any, RT] */
TROCAR_API int trocar_model_displace_seed(const trocar_model *model, const double *displacements, const trocar_seed *seed, double position[3],
                                          double direction[3]);

#ifdef __cplusplus
}
#endif
#endif
