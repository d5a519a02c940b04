/* Many insertions side by side. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_ROLLOUT_H
#define TROCAR_PUBLIC_ROLLOUT_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct trocar_rollout_options {
    double dt;               /* s, of each tick */
    int threads;             /* insertions that run at a time, 1 to 256; each thread allocates a simulation */
    trocar_watch watch;      /* called every 64 ticks */
} trocar_rollout_options;

/* Ticks of 1 ms in one thread, without callbacks. [any, RT] */
TROCAR_API trocar_rollout_options trocar_default_rollout_options(void);

/* Runs `batch` insertions of needle 0, each reset at its first pose; poses and outputs are [batch][steps]. `options` may be NULL. After an error that
   insertion's outputs are zero from there on, the others are finished, and the first message is returned. Errors as in trocar_sim_step, and BAD_INPUT
   for options out of range, NO_MEMORY, CANCELLED. [any, allocates] */
TROCAR_API trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, const trocar_rollout_options *options,
                                        trocar_output *outputs, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
