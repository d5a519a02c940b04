/* A virtual operator who carries out a planned implant. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_OPERATOR_H
#define TROCAR_PUBLIC_OPERATOR_H

#include "trocar/model.h"
#include "trocar/seeds.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The operator inserts the stabilising needles and leaves them, then all others. After that, the operator takes each needle again, drops its seeds while
   drawing it back, and pulls it out; the stabilising needles come last. An operator decides what to do next, and the caller does it, in a simulation or over a
   network: a loop around trocar_operator_next. */
typedef struct trocar_operator trocar_operator;

/* A planned needle. Depths (m) are those of the tip, measured from `entry` along its axis. */
typedef struct trocar_operator_needle {
    trocar_pose entry;       /* where the needle's axis meets the front face of the guide; the axis is the local +z */
    double depth;            /* depth of the tip at full insertion */
    const double *seeds;     /* [seed_count]: depth of the tip at which each seed is dropped if the tissue is at rest; deepest first, at most `depth` */
    int32_t seed_count;      /* 0 for a stabilising needle */
    int32_t guide;           /* guide in whose hole the needle can tilt; -1 if none: the tilt is then unlimited, about `entry` */
} trocar_operator_needle;

typedef struct trocar_operator_options {
    int32_t follows_image;   /* 0: reads the depth from the needle's marks at the guide. 1: moves the tip to where the image shows the planned place */
    uint64_t seed;           /* seed of the random numbers; those of a needle depend only on `seed` and the needle's index */
    double image_error;      /* m, standard deviation of the image's error along the needle, which is drawn once for each needle */
    double splay;            /* rad, standard deviation of the needle's tilt about each axis across it; limited by the hole's clearance */
    double speed;            /* m/s, mean speed of the hand's strokes, which have minimum jerk: they peak at 1.875 times this speed */
    double speed_spread;     /* standard deviation of the logarithm of a needle's speed; peak speeds are limited to 40 to 280 mm/s */
} trocar_operator_options;

/* Returns the defaults: an operator who reads the marks, without errors, at 65 mm/s; or, with `follows_image`, an operator who follows the image with the
   published errors and speeds (docs/seeds.md), and seed 1. [any, RT] */
TROCAR_API trocar_operator_options trocar_default_operator_options(int follows_image);

/* Creates an operator. `options`: NULL for the defaults without image. The model may have been created with mesh_only; it is used only in this call. BAD_INPUT if
   there are no needles, or more than the model has, for options or depths out of range, and for a planned place outside the tissue; NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_operator_create(const trocar_model *model, const trocar_operator_needle *needles, int count,
                                                const trocar_operator_options *options, trocar_operator **op, trocar_error *error);
TROCAR_API void trocar_operator_free(trocar_operator *op); /* [alone] */

/* What to do next. */
typedef enum trocar_operator_act {
    TROCAR_OPERATOR_START,   /* hold the needle outside the tissue, with its tip at `depth`, which is negative */
    TROCAR_OPERATOR_MOVE,    /* move the tip to `depth` within `duration` with minimum jerk, then rest for `pause` */
    TROCAR_OPERATOR_LEAVE,   /* let the needle rest in the tissue */
    TROCAR_OPERATOR_TAKE,    /* hold the needle again */
    TROCAR_OPERATOR_DROP,    /* drop a seed */
    TROCAR_OPERATOR_FINISHED
} trocar_operator_act;

typedef struct trocar_operator_action {
    int32_t act;             /* trocar_operator_act */
    int32_t needle;
    double depth;            /* m, depth of the tip */
    double duration, pause;  /* s */
} trocar_operator_action;

/* What the operator sees after an action. */
typedef struct trocar_operator_sight {
    double depth;            /* m, length of the needle beyond `entry`, read from its marks */
    const double *displacements; /* m, [node_count][3], displacements of the mesh's nodes in the newest image; NULL if the tissue is at rest */
    int32_t refused;         /* nonzero if the seed could not be dropped, because the one before is still in the needle */
} trocar_operator_sight;

/* Chooses the next action, given what the operator sees after the last one; for the first action, `sight` is not read. SYSTEM if a seed could not be dropped
   although the needle was drawn back several times. [one, RT] */
TROCAR_API trocar_status trocar_operator_next(trocar_operator *op, const trocar_operator_sight *sight, trocar_operator_action *action, trocar_error *error);

/* Returns the pose of a needle's base that brings a straight needle's tip to this depth (m), with the needle's tilt. [one, RT] */
TROCAR_API trocar_pose trocar_operator_base(const trocar_operator *op, int needle, double depth);

/* Returns the depth (m) of a straight needle with this base, as read from its marks. [one, RT] */
TROCAR_API double trocar_operator_depth(const trocar_operator *op, int needle, const trocar_pose *base);

/* The parts of a seed's misplacement: vectors (m) in the world frame. The rest, caused for example by bending of the needle or by tissue that moves while the
   seed is dropped, is the difference between the seed's offset from `planned` in the tissue at rest and their sum. */
typedef struct trocar_operator_seed {
    double planned[3];       /* m, planned centre in the tissue at rest */
    double tissue[3];        /* caused by displacement of the tissue when the seed was dropped, as far as the operator did not follow it */
    double image[3];         /* caused by the image error */
    double splay[3];         /* caused by the tilt of the needle */
    int32_t needle, number;  /* the needle, and the seed's number in it, from 0 for the distal seed */
} trocar_operator_seed;

/* Writes the seeds dropped so far, in that order; at most `room`. Returns their total number. [one, RT] */
TROCAR_API int trocar_operator_seeds(const trocar_operator *op, trocar_operator_seed *seeds, int room);

#ifdef __cplusplus
}
#endif
#endif
