/* Steps many simulations together, using several threads. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_BATCH_H
#define TROCAR_PUBLIC_BATCH_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A set of simulations, called rows, of one or more models. Each row runs in lockstep and gives exactly the same results as trocar_sim_step, regardless of
   the number of threads and of the other rows. In the array shapes below, R is the number of rows, S the number of steps in a call, and N the number of
   needles driven in each row. A mask has R entries, nonzero for the rows to process; NULL means all rows. */
typedef struct trocar_batch trocar_batch;

typedef struct trocar_batch_options {
    int threads;             /* number of threads, including the caller's, 1 to 256; 0: one per processor available to the process */
    int needles;             /* N: each step drives needles 0 to N - 1 of each row, in that order */
} trocar_batch_options;

/* Returns the defaults: one thread per processor, one needle. [any, RT] */
TROCAR_API trocar_batch_options trocar_default_batch_options(void);

/* Creates `rows` simulations. Row i simulates models[i]; rows may share a model. Until a row is reset, its needles are straight with their bases at the
   origin. `options` may be NULL for the defaults. A row takes 5 to 7 MB (docs/library.md). If memory is too short for all threads, fewer are started.
   BAD_INPUT if an option is out of range, or if a model has fewer than N needles or was created with mesh_only; NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_batch_create(trocar_model *const *models, int rows, const trocar_batch_options *options, trocar_batch **batch,
                                             trocar_error *error);
TROCAR_API void trocar_batch_free(trocar_batch *batch); /* [alone] */

TROCAR_API int trocar_batch_rows(const trocar_batch *batch);    /* R. [any, RT] */
TROCAR_API int trocar_batch_needles(const trocar_batch *batch); /* N. [any, RT] */
TROCAR_API int trocar_batch_threads(const trocar_batch *batch); /* number of threads that were started, including the caller's. [any, RT] */

/* Returns a row's simulation, or NULL if `row` is out of range. Between calls to the functions in this header, use it like any other lockstep simulation:
   for views, seeds, leaving and taking needles, the probe, and saving. It belongs to the batch, and is valid until trocar_batch_set_model replaces it or the
   batch is freed. It cannot have a worker thread, and only one thread at a time may use the batch and its rows. [one] */
TROCAR_API trocar_sim *trocar_batch_sim(trocar_batch *batch, int row);

/* Replaces a row's simulation with a new simulation of `model`, for example a derived model. On error, the row is unchanged. BAD_INPUT as in
   trocar_batch_create, or if `row` is out of range; NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_batch_set_model(trocar_batch *batch, int row, trocar_model *model, trocar_error *error);

/* ---- starting and continuing ---- */

/* Resets the masked rows to their initial state (time 0; no seeds, tracks or resting needles), and places their driven needles, straight, at `poses`,
   [R][N]. Poses of other rows are not read. An error in one row does not stop the others; if several rows fail, the error of the lowest-numbered row is
   returned: BAD_INPUT as in trocar_sim_reset, or NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_batch_reset(trocar_batch *batch, const trocar_pose *poses, const uint8_t *mask, trocar_error *error);

/* Save or restore each masked row, like trocar_sim_save and trocar_sim_restore. To save, states[row] must point to `size` bytes; to restore, to sizes[row]
   bytes. Several rows may be restored from the same state. Entries of other rows are not read. An error in one row does not stop the others; if several
   rows fail, the error of the lowest-numbered row is returned. [one, allocates] */
TROCAR_API trocar_status trocar_batch_save(trocar_batch *batch, void *const *states, size_t size, const uint8_t *mask, trocar_error *error);
TROCAR_API trocar_status trocar_batch_restore(trocar_batch *batch, const void *const *states, const size_t *sizes, const uint8_t *mask, trocar_error *error);

/* ---- stepping ---- */

/* Arrays, supplied by the caller, for the results of a call. NULL if a result is not wanted. Units and meanings are as in trocar_output. */
typedef struct trocar_batch_outputs {
    double *force;           /* [R][S][N][3], N */
    double *torque;          /* [R][S][N][3], N m */
    double *depth;           /* [R][S][N], m */
    trocar_pose *tip;        /* [R][S][N], pose of the needle's tip: position (m), and orientation, with +z along the needle and +y toward the bevel's face */
    int32_t *contacts;       /* [R][S][N] */
    uint32_t *events;        /* [R][S][N] */
    int32_t *membrane;       /* [R][S][N] */
    int32_t *passes;         /* [R][S][N] */
    int32_t *switches;       /* [R][S][N] */
    int32_t *seeds;          /* [R][S], number of seeds in the tissue after the step */
    int32_t *status;         /* [R], trocar_status of the row */
    int32_t *done;           /* [R], number of completed steps */
} trocar_batch_outputs;

/* Computes `steps` ticks of `dt` seconds for the masked rows, with the needles' bases at `poses`, [R][S][N]. Taking many steps in one call is faster than
   calling once per step, because each row's data stay in the processor's cache. A resting needle is not ticked: its pose is not read, and its force, torque
   and events are 0. Entries of rows outside the mask are neither read nor written.
   If a step fails, its row stops there, possibly halfway through the step, and the row's outputs are zero from that step on. The other rows complete all
   steps. If several rows fail, the error of the lowest-numbered row is returned; the message names the row and the step. `watch` may be NULL; its functions
   are called in the calling thread, at least once per 64 steps of a row. After a cancelled call, rows may have completed different numbers of steps; see
   `done`. BAD_INPUT as in trocar_sim_step, and, before anything is computed, for steps < 0 or dt outside (0, 1]; NUMERIC, NO_MEMORY, CANCELLED.
   [one, allocates] */
TROCAR_API trocar_status trocar_batch_step(trocar_batch *batch, const trocar_pose *poses, int steps, double dt, const uint8_t *mask,
                                           const trocar_watch *watch, const trocar_batch_outputs *outputs, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
