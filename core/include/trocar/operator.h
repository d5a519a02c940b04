/* A virtual operator who carries out a planned implant. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_OPERATOR_H
#define TROCAR_PUBLIC_OPERATOR_H

#include "trocar/model.h"
#include "trocar/seeds.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The operator first inserts and leaves the stabilising needles, then all others. After that, the operator takes each needle again, drops its seeds while
   withdrawing it, and pulls it out; the stabilising needles come last. The operator only decides what to do next. The caller does it, in a simulation or over
   a network, in a loop around trocar_operator_next. */
typedef struct trocar_operator trocar_operator;

/* A planned needle. Depths (m) are depths of the tip, measured from `entry` along the needle's axis. */
typedef struct trocar_operator_needle {
    trocar_pose entry;       /* position: where the needle's axis meets the front face of the guide; orientation: local +z along the axis */
    double depth;            /* depth of the tip at full insertion */
    const double *seeds;     /* [seed_count]: depth of the tip at which each seed is dropped if the tissue is at rest; deepest first, at most `depth` */
    int32_t seed_count;      /* 0 for a stabilising needle */
    int32_t guide;           /* guide whose hole limits the needle's tilt; -1 if none: the tilt is then unlimited, and about `entry` */
} trocar_operator_needle;

typedef struct trocar_operator_options {
    int32_t follows_image;   /* 0: reads the depth from the needle's marks at the guide. 1: moves the tip to where the image shows the planned position */
    uint64_t seed;           /* seed of the random numbers; those of a needle depend only on `seed` and the needle's index */
    double image_error;      /* m, standard deviation of the image error along the needle; the error is drawn once for each needle */
    double splay;            /* rad, standard deviation of the needle's tilt about each axis perpendicular to it; the tilt is limited by the hole's clearance */
    double speed;            /* m/s, mean speed of the hand's strokes, which are minimum-jerk motions: they peak at 1.875 times this speed */
    double speed_spread;     /* standard deviation of the logarithm of a needle's speed; peak speeds are limited to 40 to 280 mm/s */
} trocar_operator_options;

/* Returns the defaults: an operator who reads the marks, without errors, at 65 mm/s; or, if `follows_image` is nonzero, one who follows the image with
   the published errors and speeds (docs/seeds.md), and seed 1. [any, RT] */
TROCAR_API trocar_operator_options trocar_default_operator_options(int follows_image);

/* Creates an operator. `options`: NULL for the defaults without image. The model may have been created with mesh_only; it is used only in this call. BAD_INPUT
   if there are no needles or more than the model has, if options or depths are out of range, or if a planned seed is outside the tissue; NO_MEMORY.
   [any, allocates] */
TROCAR_API trocar_status trocar_operator_create(const trocar_model *model, const trocar_operator_needle *needles, int count,
                                                const trocar_operator_options *options, trocar_operator **op, trocar_error *error);
TROCAR_API void trocar_operator_free(trocar_operator *op); /* [alone] */

/* What to do next. */
typedef enum trocar_operator_act {
    TROCAR_OPERATOR_START,   /* hold the needle outside the tissue, with its tip at `depth`, which is negative */
    TROCAR_OPERATOR_MOVE,    /* move the tip to `depth` in a minimum-jerk motion of length `duration`, then hold it still for `pause` */
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

/* What the operator sees after an action has been carried out. */
typedef struct trocar_operator_sight {
    double depth;            /* m, length of the needle beyond `entry`, read from its marks */
    const double *displacements; /* m, [node_count][3], displacements of the mesh's nodes in the newest image; NULL if the tissue is at rest */
    int32_t refused;         /* nonzero if the seed could not be dropped because the previous one is still in the needle */
} trocar_operator_sight;

/* Chooses the next action, given what the operator sees after the last one. For the first action, `sight` is not read. SYSTEM if a seed could not be dropped
   although the needle was drawn back several times. [one, RT] */
TROCAR_API trocar_status trocar_operator_next(trocar_operator *op, const trocar_operator_sight *sight, trocar_operator_action *action, trocar_error *error);

/* Returns the pose of a needle's base that brings a straight needle's tip to this depth (m), with the needle's tilt. [one, RT] */
TROCAR_API trocar_pose trocar_operator_base(const trocar_operator *op, int needle, double depth);

/* Returns the depth (m) of a straight needle with this base, as read from its marks. [one, RT] */
TROCAR_API double trocar_operator_depth(const trocar_operator *op, int needle, const trocar_pose *base);

/* The components of a seed's placement error, by cause: vectors (m) in the world frame. The error is the seed's offset from `planned` in the tissue at rest.
   The part that these components do not add up to has other causes, such as bending of the needle, or tissue that moves while the seed is dropped. */
typedef struct trocar_operator_seed {
    double planned[3];       /* m, planned centre in the tissue at rest */
    double tissue[3];        /* caused by the displacement of the tissue when the seed was dropped, to the extent that the operator did not follow it */
    double image[3];         /* caused by the image error */
    double splay[3];         /* caused by the tilt of the needle */
    int32_t needle, number;  /* the needle's index, and the seed's number in the needle, counted from 0 for the distal seed */
} trocar_operator_seed;

/* Writes the seeds dropped so far, in the order of dropping, at most `room` of them. Returns their total number. [one, RT] */
TROCAR_API int trocar_operator_seeds(const trocar_operator *op, trocar_operator_seed *seeds, int room);

#ifdef __cplusplus
}
#endif
#endif
