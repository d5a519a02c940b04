/* Many insertions in parallel. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_ROLLOUT_H
#define TROCAR_PUBLIC_ROLLOUT_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct trocar_rollout_options {
    double dt;               /* s, duration of each tick */
    int threads;             /* number of insertions that run at the same time, 1 to 256; each thread allocates a simulation */
    trocar_watch watch;      /* called every 64 ticks */
} trocar_rollout_options;

/* Returns the defaults: ticks of 1 ms, one thread, no callbacks. [any, RT] */
TROCAR_API trocar_rollout_options trocar_default_rollout_options(void);

/* Runs `batch` insertions of needle 0, each starting with a reset at its first pose. Poses and outputs are [batch][steps]. `options` may be NULL. After an
   error, the outputs of that insertion are zero from the failed step on, the other insertions are finished, and the first message is returned. Errors as
   in trocar_sim_step; also BAD_INPUT for options out of range, NO_MEMORY, CANCELLED. [any, allocates] */
TROCAR_API trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, const trocar_rollout_options *options,
                                        trocar_output *outputs, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
