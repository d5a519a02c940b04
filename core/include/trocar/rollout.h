/* Runs many insertions in parallel. Included by trocar.h. */
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
    trocar_model *const *models; /* [batch], the model of each insertion; NULL: all insertions use the model passed to trocar_rollout. When a thread goes on to
                                    an insertion with another model, it allocates a new simulation */
    const void *const *states;   /* [batch], saved states from which the insertions continue; if the array or an entry is NULL, the insertion starts with a
                                    reset */
    const size_t *state_sizes;   /* [batch], bytes */
} trocar_rollout_options;

/* Returns the defaults: 1 ms ticks, one thread, one needle, and no callbacks, models or states. [any, RT] */
TROCAR_API trocar_rollout_options trocar_default_rollout_options(void);

/* Runs `batch` insertions. Poses and outputs are [batch][steps][N]. An insertion without a saved state starts with a reset of its needles at their first poses.
   A needle that rests is not ticked, as in trocar_batch_step. `options` may be NULL; `model` may be NULL if the options give one for each insertion. If an
   insertion fails, its outputs are zero from the failed step on, and the other insertions are finished; if several fail, the error of the one with the lowest
   index is returned. If there is not enough memory for all threads, fewer are started. Errors as in trocar_sim_step and trocar_sim_restore; also BAD_INPUT for
   options out of range or a model with fewer than N needles, NO_MEMORY, CANCELLED. [any, allocates] */
TROCAR_API trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, const trocar_rollout_options *options,
                                        trocar_output *outputs, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
