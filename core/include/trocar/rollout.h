/* Runs many insertions in parallel. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_ROLLOUT_H
#define TROCAR_PUBLIC_ROLLOUT_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct trocar_rollout_options {
    double dt;               /* s, duration of each tick */
    int threads;             /* number of insertions to run at the same time, 1 to 256; each thread allocates a simulation */
    trocar_watch watch;      /* called every 64 ticks */
    int needles;             /* N: each step drives needles 0 to N - 1, in that order; 0 means 1 */
    trocar_model *const *models; /* [batch], the model for each insertion; NULL: all insertions use the model passed to trocar_rollout. A thread allocates
                                    a new simulation whenever its next insertion uses a different model */
    const void *const *states;   /* [batch], saved states to continue from; if the array or an entry is NULL, the insertion starts with a reset */
    const size_t *state_sizes;   /* [batch], bytes */
} trocar_rollout_options;

/* Returns the defaults: 1 ms ticks, one thread, one needle, and no callbacks, models or states. [any, RT] */
TROCAR_API trocar_rollout_options trocar_default_rollout_options(void);

/* Runs `batch` insertions. Poses and outputs are [batch][steps][N]. An insertion without a saved state begins by resetting its needles at their first poses.
   Resting needles are not ticked, as in trocar_batch_step. `options` may be NULL; `model` may be NULL if the options give one for each insertion. If an
   insertion fails, its outputs are zero from the failed step on, and the others still run to the end; if several fail, the error of the lowest-numbered one
   is returned. If memory is too short for all threads, fewer are started. Errors as in trocar_sim_step and trocar_sim_restore; also BAD_INPUT if an option
   is out of range or a model has fewer than N needles, NO_MEMORY, CANCELLED. [any, allocates] */
TROCAR_API trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, const trocar_rollout_options *options,
                                        trocar_output *outputs, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
