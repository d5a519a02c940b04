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
    int needles;             /* N: needles 0 to N - 1 are driven, one after another in each step; 0 stands for 1 */
    trocar_model *const *models; /* [batch], the model of each insertion; NULL: all insertions have the model of the call. A thread whose insertions change from
                                    one model to another allocates a new simulation */
    const void *const *states;   /* [batch], saved states from which insertions continue; if it or an entry is NULL, the insertion starts with a reset */
    const size_t *state_sizes;   /* [batch], bytes */
} trocar_rollout_options;

/* Returns the defaults: ticks of 1 ms, one thread, one needle, no callbacks, models or states. [any, RT] */
TROCAR_API trocar_rollout_options trocar_default_rollout_options(void);

/* Runs `batch` insertions. Poses and outputs are [batch][steps][N]. An insertion without a saved state starts with a reset of its needles at their first poses.
   A needle that rests is not ticked, as in trocar_batch_step. `options` may be NULL; `model` may be NULL if the options name one for each insertion. After an
   error, the outputs of that insertion are zero from the failed step on, and the other insertions are finished; if several insertions fail, the error of the one
   with the lowest index is returned. If memory does not suffice for all threads, fewer are started. Errors as in trocar_sim_step and trocar_sim_restore; also
   BAD_INPUT for options out of range or a model with fewer than N needles, NO_MEMORY, CANCELLED. [any, allocates] */
TROCAR_API trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, const trocar_rollout_options *options,
                                        trocar_output *outputs, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
