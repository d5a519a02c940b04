/* A virtual operator who performs a planned implant. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_OPERATOR_H
#define TROCAR_PUBLIC_OPERATOR_H

#include "trocar/model.h"
#include "trocar/seeds.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The operator first inserts the stabilising needles and leaves them in the tissue, then does the same with the others. Next, the operator takes each needle
   in turn, drops its seeds while withdrawing it, and pulls it out, the stabilising needles last. The operator only decides what to do next: call
   trocar_operator_next in a loop, and carry out each action in a simulation or over a network. An operator with strands drops each run of equally spaced seeds
   at once, and the next run when the needle has been drawn back by the planned distance from the first seed, without correction. */
typedef struct trocar_operator trocar_operator;

/* A planned needle. Depths (m) are those of the tip, measured from `entry` along the needle's axis. */
typedef struct trocar_operator_needle {
    trocar_pose entry;       /* position: where the needle's axis meets the front face of the guide; orientation: local +z along the axis */
    double depth;            /* depth of the tip at full insertion */
    const double *seeds;     /* [seed_count]: tip depth at which to drop each seed if the tissue is at rest; at most `depth`, deepest first */
    int32_t seed_count;      /* 0 for a stabilising needle */
    int32_t guide;           /* guide whose hole limits the needle's tilt; -1: no guide, so the needle tilts about `entry` without limit */
} trocar_operator_needle;

typedef struct trocar_operator_options {
    int32_t follows_image;   /* 0: reads the depth off the needle's marks at the guide. 1: moves the tip to where the image shows the planned position */
    int32_t strands;         /* 0: loose seeds, each brought to its own place. 1: only the first seed of a needle is; the others follow at the planned distances */
    uint64_t seed;           /* random seed; the random numbers for a needle depend only on `seed` and the needle's index */
    double image_error;      /* m, standard deviation of the image error along the needle; the error is drawn once per needle */
    double splay;            /* rad, standard deviation of the needle's tilt about each axis perpendicular to it; the hole's clearance limits the tilt */
    double speed;            /* m/s, mean speed of the hand's strokes. Strokes are minimum-jerk motions, so they peak at 1.875 times this speed */
    double speed_spread;     /* standard deviation of the logarithm of a needle's speed; peak speeds are clamped to 40 to 280 mm/s */
} trocar_operator_options;

/* Returns the defaults. If `follows_image` is 0: an operator who reads the marks and makes no errors, at 65 mm/s. Otherwise: one who follows the image with
   the published errors and speeds (docs/seeds.md), and seed 1. [any, RT] */
TROCAR_API trocar_operator_options trocar_default_operator_options(int follows_image);

/* Creates an operator. `options` may be NULL for the defaults without an image. The model is used only during this call; mesh_only is enough. BAD_INPUT if
   there are no needles or more than the model has, if an option or depth is out of range, or if a planned seed is outside the tissue; NO_MEMORY.
   [any, allocates] */
TROCAR_API trocar_status trocar_operator_create(const trocar_model *model, const trocar_operator_needle *needles, int count,
                                                const trocar_operator_options *options, trocar_operator **op, trocar_error *error);
TROCAR_API void trocar_operator_free(trocar_operator *op); /* [alone] */

/* What to do next. */
typedef enum trocar_operator_act {
    TROCAR_OPERATOR_START,   /* hold the needle outside the tissue, with its tip at `depth` (negative) */
    TROCAR_OPERATOR_MOVE,    /* move the tip to `depth` in a minimum-jerk motion lasting `duration`, then hold it still for `pause` */
    TROCAR_OPERATOR_LEAVE,   /* let go of the needle, so that it rests in the tissue */
    TROCAR_OPERATOR_TAKE,    /* take hold of the needle again */
    TROCAR_OPERATOR_DROP,    /* drop `seeds` seeds whose centres are `spacing` apart, the first one's distal end at the tip */
    TROCAR_OPERATOR_FINISHED
} trocar_operator_act;

typedef struct trocar_operator_action {
    int32_t act;             /* trocar_operator_act */
    int32_t needle;
    double depth;            /* m, depth of the tip */
    double duration, pause;  /* s */
    double spacing;          /* m; 0 for a single seed */
    int32_t seeds;           /* number of seeds to drop */
} trocar_operator_action;

/* What the operator sees after an action. */
typedef struct trocar_operator_sight {
    double depth;            /* m, length of the needle beyond `entry`, read from its marks */
    const double *displacements; /* m, [node_count][3], displacements of the mesh's nodes in the newest image; NULL if the tissue is at rest */
    int32_t refused;         /* nonzero if the seeds could not be dropped because earlier ones were still in the needle */
} trocar_operator_sight;

/* Chooses the next action, given what the operator sees after the last one; `sight` is not read for the first action. SYSTEM if a seed could not be dropped
   even after drawing the needle back several times. [one, RT] */
TROCAR_API trocar_status trocar_operator_next(trocar_operator *op, const trocar_operator_sight *sight, trocar_operator_action *action, trocar_error *error);

/* Returns the base pose at which this needle, tilted but straight, would have its tip at this depth (m). [one, RT] */
TROCAR_API trocar_pose trocar_operator_base(const trocar_operator *op, int needle, double depth);

/* Returns the depth (m) that the marks of a straight needle show when its base is at this pose. [one, RT] */
TROCAR_API double trocar_operator_depth(const trocar_operator *op, int needle, const trocar_pose *base);

/* A seed's placement error, split by cause into vectors (m) in the world frame. The error is the seed's offset from `planned` in the tissue at rest. The
   vectors do not add up to all of it: the remainder has other causes, such as needle bending, or tissue moving while the seed is dropped. */
typedef struct trocar_operator_seed {
    double planned[3];       /* m, planned centre in the tissue at rest */
    double tissue[3];        /* caused by tissue displacement when the seed was dropped, as far as the operator did not compensate for it */
    double image[3];         /* caused by the image error */
    double splay[3];         /* caused by the tilt of the needle */
    int32_t needle, number;  /* the needle's index, and the seed's number in the needle, counted from 0 for the distal seed */
} trocar_operator_seed;

/* Writes up to `room` of the seeds dropped so far, in the order they were dropped. Returns how many there are in total. [one, RT] */
TROCAR_API int trocar_operator_seeds(const trocar_operator *op, trocar_operator_seed *seeds, int room);

#ifdef __cplusplus
}
#endif
#endif
